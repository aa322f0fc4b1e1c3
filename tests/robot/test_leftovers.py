"""Files of killed programs and robots in the run directory are removed at the next look. Files of a
running robot are kept.
"""

from __future__ import annotations

import fcntl
import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

from strands_actors.caller.processes.leftovers import remove_leftovers
from strands_actors.caller.processes.run_directory import Name, is_running, notes

KILLED = """
import os, signal
from strands_actors import Robot
robot = Robot("so101", mode="real", transport="twin")
robot.connect_eagerly()
os.kill(os.getpid(), signal.SIGKILL)
"""
ENDED_S = 30.0


def files(directory: Path) -> set[str]:
    return {path.name for path in directory.iterdir() if path.is_file() or path.is_socket()}


def test_no_file_of_a_killed_script_is_left(run_dir: Path) -> None:
    done = subprocess.run([sys.executable, "-c", KILLED], capture_output=True, text=True)
    assert done.returncode == -signal.SIGKILL, done.stderr
    assert any(name.startswith("caller-") for name in files(run_dir))
    until_s = time.monotonic() + ENDED_S
    while is_running("so101") and time.monotonic() < until_s:
        time.sleep(0.01)
    while (left := files(run_dir)) and time.monotonic() < until_s:  # the standby may still be ending
        assert list(notes()) == []
        time.sleep(0.01)
    assert left == set()


def test_files_in_use_are_kept(tmp_path: Path) -> None:
    kept = {"so101.lock", "so101.json", "so101.wire.sock", "so101.wire.sock.lock", "ab.port", "so101.left.lock"}
    removed = {"koch.lock", "koch.json", "koch.root.sock", "koch.root.sock.lock", "cd.port", "koch.standby.life"}
    for name in kept | removed:
        (tmp_path / name).touch()
    locks = [os.open(tmp_path / name, os.O_RDWR) for name in ("so101.lock", "so101.left.lock", "ab.port")]
    for fd in locks:
        fcntl.flock(fd, fcntl.LOCK_EX)
    remove_leftovers(tmp_path)
    assert files(tmp_path) == kept
    for fd in locks:
        os.close(fd)


def test_a_name_that_is_taken_during_a_removal_is_held_by_its_path(run_dir: Path) -> None:
    """The holder of a name must hold the file at its path, although the file is removed many times."""
    over = threading.Event()

    def look() -> None:
        while not over.is_set():
            remove_leftovers(run_dir)

    looking = threading.Thread(target=look)
    looking.start()
    try:
        for _ in range(300):
            name = Name("so101")
            assert name.name == "so101"
            assert is_running("so101")
            name.release()
    finally:
        over.set()
        looking.join()
