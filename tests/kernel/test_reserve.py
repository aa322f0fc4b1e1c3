"""SAF-024: the resources that a process keeps in reserve for a stop, and its end when they are missing.
Limits apply to a whole process, so each test has its own.
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from strands_actors.kernel.processes.reserve import EXIT_SHORT, how_ended

BEGIN = '''
import errno, os, resource, socket, sys
from strands_actors.kernel.processes.reserve import FILES, RESERVE, raise_limits

def use_all_files():
    resource.setrlimit(resource.RLIMIT_NOFILE, (100, 200))
    while True:
        try:
            os.dup(0)
        except OSError:
            return

def use_all_memory():
    pages = int(open("/proc/self/statm").read().split()[0])
    resource.setrlimit(resource.RLIMIT_AS, (pages * resource.getpagesize(), resource.RLIM_INFINITY))

def whole_system_has_no_file():
    """What cannot be opened fails as if the table of the whole system were full."""
    real = os.open

    def opened(*arguments):
        try:
            return real(*arguments)
        except OSError as error:
            assert error.errno == errno.EMFILE
            raise OSError(errno.ENFILE, os.strerror(errno.ENFILE)) from None

    os.open = opened
    use_all_files()

'''


def run(script: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, "-c", BEGIN + script], capture_output=True, text=True, timeout=60)


def succeeds(script: str) -> str:
    done = run(script)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_saf_024_a_process_with_all_files_in_use_can_open_the_files_of_a_stop() -> None:
    assert succeeds("""
RESERVE.begin(lambda: True)
use_all_files()
with RESERVE.freed():
    opened = [socket.socket() for _ in range(FILES)]
for one in opened:
    one.close()
print(RESERVE.check())
""").startswith("no file can be opened")


def test_saf_024_a_process_without_memory_has_a_reserve_for_a_stop() -> None:
    succeeds("""
RESERVE.begin(lambda: True)
use_all_memory()
try:
    bytearray(6 << 20)
except MemoryError:
    pass
else:
    sys.exit("the limit does not bind")
with RESERVE.freed():
    bytearray(6 << 20)
""")


def test_saf_024_if_the_whole_system_has_no_free_file_the_reserve_is_kept_and_used() -> None:
    succeeds("""
RESERVE.begin(lambda: True)
whole_system_has_no_file()
assert RESERVE.check() == ""
with RESERVE.freed():
    opened = [os.open(os.devnull, os.O_RDONLY) for _ in range(FILES)]
    for fd in opened:
        os.close(fd)
RESERVE.end_if_short()
assert RESERVE.check() == ""
""")


def test_saf_024_a_process_that_lost_its_reserve_ends_if_another_process_acts() -> None:
    script = """
RESERVE.begin(lambda: {other})
whole_system_has_no_file()
with RESERVE.freed():
    use_all_files()  # another program is quicker
    try:
        os.open(os.devnull, os.O_RDONLY)
    except OSError as error:
        RESERVE.lacked(error)
RESERVE.end_if_short()
assert RESERVE.check() == "no file can be opened (Too many open files in system; sysctl fs.file-max)"
os._exit(0)
"""
    ended = run(script.format(other=True))
    assert ended.returncode == EXIT_SHORT, ended
    stays = run(script.format(other=False))
    assert stays.returncode == 0, stays.stderr


def test_saf_024_the_reserve_is_filled_again_after_a_stop() -> None:
    succeeds("""
RESERVE.begin(lambda: True)
before = len(os.listdir("/proc/self/fd"))
for _ in range(3):
    with RESERVE.freed():
        with RESERVE.freed():  # an attempt within a stop
            pass
        assert len(os.listdir("/proc/self/fd")) == before - FILES
    assert len(os.listdir("/proc/self/fd")) == before
assert RESERVE.check() == ""
""")


@pytest.mark.parametrize("limit", ["NOFILE", "AS"])
def test_saf_024_a_process_without_a_reserve_ends_if_another_process_acts(limit: str) -> None:
    done = run(f"""
RESERVE.begin(lambda: True)
resource.setrlimit(resource.RLIMIT_{limit}, (0, resource.RLIM_INFINITY if "{limit}" == "AS" else 200))
with RESERVE.freed():
    pass
RESERVE.end_if_short()
""")
    assert done.returncode == EXIT_SHORT, done
    assert "Another process of the robot makes it safe" in done.stderr


def test_saf_024_an_error_for_lack_of_files_ends_a_process_only_during_a_stop() -> None:
    script = """
RESERVE.begin(lambda: {other})
use_all_files()
resource.setrlimit(resource.RLIMIT_NOFILE, (0, 200))
try:
    socket.socket()
except OSError as error:
    RESERVE.lacked(error)
    with RESERVE.freed():
        RESERVE.lacked(ConnectionRefusedError(111, "refused"))
        RESERVE.lacked(error)
os._exit(0)
"""
    assert run(script.format(other=True)).returncode == EXIT_SHORT
    assert run(script.format(other=False)).returncode == 0, "the last process stays and tries again"


def test_saf_024_a_process_with_its_reserve_or_without_a_robot_continues() -> None:
    succeeds("""
RESERVE.end_if_short()
with RESERVE.freed():
    pass
assert RESERVE.check() == ""
RESERVE.begin(lambda: True)
RESERVE.end_if_short()
""")


def test_saf_024_soft_limits_are_raised() -> None:
    assert succeeds("""
resource.setrlimit(resource.RLIMIT_NOFILE, (64, 128))
resource.setrlimit(resource.RLIMIT_FSIZE, (1 << 20, 1 << 30))
raise_limits()
print(resource.getrlimit(resource.RLIMIT_NOFILE), resource.getrlimit(resource.RLIMIT_FSIZE)[0] == 1 << 30)
""").split() == ["(128,", "128)", "True"]


def test_saf_024_a_full_disk_does_not_prevent_the_lock_of_a_standby(tmp_path: Path) -> None:
    path = str(tmp_path / "so101.standby.life")
    assert succeeds(f"""
from pathlib import Path
from strands_actors.supervisors.standby.report import LifeLock, holder
resource.setrlimit(resource.RLIMIT_FSIZE, (0, 0))
lock = LifeLock(Path({path!r}), "")
print(holder(Path({path!r})) is not None)
""").split() == ["True"]


def test_the_end_of_a_process_is_described() -> None:
    assert how_ended(-9) == "signal 9"
    assert how_ended(4) == "code 4"
    assert how_ended(EXIT_SHORT).startswith(f"code {EXIT_SHORT}: it had no file")
