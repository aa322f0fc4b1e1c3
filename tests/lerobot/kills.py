"""SIGKILL of ``lerobot-teleoperate`` at random moments, by hand, in one of the environments:

    python -m tests.lerobot.kills 50            our robot
    python -m tests.lerobot.kills 50 theirs     LeRobot's own so101_follower, on the same twin

LeRobot is imported once; each trial is a fork of that process which runs LeRobot's own ``main``.
"""

from __future__ import annotations

import contextlib
import os
import random
import shutil
import signal
import statistics
import sys
import tempfile
import time
from collections import Counter
from importlib.metadata import version
from pathlib import Path

from strands_actors.testing import Twin
from strands_actors.testing import twin as twin_module
from strands_actors.testing.trials import subject

from .calibration import NAME, write

STARTS_S = 180.0
LATEST_S = 2.0
"""After the first setpoint."""
LOOK_S = 2.0
"""How long after the kill the torque is looked at."""
TORQUE_ENABLE = 40
ASKED = 10


def main() -> None:
    repeats, theirs = int(sys.argv[1]), sys.argv[2:] == ["theirs"]
    home = Path(tempfile.mkdtemp(prefix="kills-"))
    os.environ |= {"HF_HOME": str(home), "HF_HUB_OFFLINE": "1", "STRANDS_ACTORS_RUN": str(home)}
    from lerobot.scripts import lerobot_teleoperate
    from lerobot.utils.import_utils import register_third_party_plugins

    register_third_party_plugins()  # its main does so, too: then it is done
    twin_module.PATIENCE_S = STARTS_S
    with Twin("so101", home) as twin:
        ours = ["--robot.type=strands_so101"]
        robot = _calibrated(home) if theirs else ours
        sys.argv = ["lerobot-teleoperate", *robot, f"--robot.port={twin.port}"]
        sys.argv += ["--teleop.discover_packages_path=tests.lerobot.sine", "--teleop.type=sine", "--fps=30"]
        found, loads = [], []
        for _ in range(repeats):
            found.append(_trial(twin, lerobot_teleoperate.main))
            loads.append(os.getloadavg()[0])
            print(*found[-1], flush=True)
    times = sorted(safe_ms for safe_ms, _, _ in found if safe_ms is not None)
    print(f"{'their' if theirs else 'our'} so101, {repeats} kills, lerobot {version('lerobot')}")
    print("; ".join(subject().values()), f"load {min(loads):.1f} to {max(loads):.1f}", sep="; ")
    print(f"a frame that takes the torque: {len(times)}")
    if times:
        print(f"after {statistics.median(times):.1f} ms (median), {times[-1]:.1f} ms (worst)")
    print(f"setpoints after it: {sum(after for _, after, _ in found)}")
    print(f"servos with torque {LOOK_S:g} s later: {Counter(torque for _, _, torque in found)}")
    shutil.rmtree(home)


def _calibrated(home: Path) -> list[str]:
    write(home)
    return ["--robot.type=so101_follower", f"--robot.id={NAME}", f"--robot.calibration_dir={home}"]


def _trial(twin: Twin, run: object) -> tuple[float | None, int, int]:
    """Return milliseconds to the frame that takes the torque, setpoints after it (or after the
    kill), and how many servos have torque then."""
    os.truncate(twin.log.path, 0)
    pid = os.fork()
    if pid == 0:
        _child(run)
    deadline_s = time.monotonic() + STARTS_S
    while not twin.log.host("setpoint"):
        assert time.monotonic() < deadline_s, "it does not move"
        if os.waitpid(pid, os.WNOHANG) != (0, 0):  # it did not connect: no trial
            return _trial(twin, run)
        time.sleep(0.05)
    time.sleep(random.uniform(0.0, LATEST_S))
    killed_ns = time.monotonic_ns()
    os.kill(pid, signal.SIGKILL)
    os.waitpid(pid, 0)
    time.sleep(LOOK_S)
    safe = twin.log.first_safe(killed_ns)
    safe_ms = None if safe is None else (safe.t_ns - killed_ns) / 1e6
    after = len(twin.log.host("setpoint", killed_ns)) if safe is None else twin.log.setpoints_after_safe(killed_ns)
    return safe_ms, after, _with_torque(twin.port)


def _child(run: object) -> None:
    assert callable(run)
    with contextlib.suppress(BaseException):
        nowhere = os.open(os.devnull, os.O_RDWR)
        os.dup2(nowhere, 1)
        os.dup2(nowhere, 2)
        run()
    os._exit(1)


def _with_torque(port: str) -> int:
    """Ask the servos, when nobody else has the port."""
    import scservo_sdk as scs

    handler, packets = scs.PortHandler(port), scs.PacketHandler(0)
    assert handler.openPort() and handler.setBaudRate(1_000_000)
    energised = 0
    for motor in range(1, 7):
        for _ in range(ASKED):  # a busy machine reads too late
            value, failed, _ = packets.read1ByteTxRx(handler, motor, TORQUE_ENABLE)
            if not failed:
                break
        assert not failed, f"servo {motor} does not answer"
        energised += bool(value)
    handler.closePort()
    return energised


if __name__ == "__main__":
    main()
