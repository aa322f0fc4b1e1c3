"""SIGKILL of ``lerobot-teleoperate`` at random moments, by hand, in one of the environments:

    python -m tests.lerobot.kills 50            our robot
    python -m tests.lerobot.kills 50 theirs     LeRobot's own class of it, on the same twin
    python -m tests.lerobot.kills 50 --leader   our robot, led by LeRobot's own leader on ``on_rustypot.py``

``--robot koch`` takes a Koch in place of an SO-101. LeRobot is imported once; each trial is a fork of that process
which runs LeRobot's own ``main``.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import random
import shutil
import signal
import statistics
import sys
import tempfile
import time
import traceback
from collections import Counter
from collections.abc import Callable, Iterator
from importlib.metadata import version
from pathlib import Path
from typing import NamedTuple

from strands_actors.testing import Twin
from strands_actors.testing import twin as twin_module
from strands_actors.testing.trials import subject

from .calibration import MOTORS, NAME, write
from .rustypot_registers import Registers

STARTS_S, STARTS = 180.0, 5
LATEST_S = 2.0
"""After the first setpoint."""
LOOK_S = 2.0
"""How long after the kill the torque is looked at."""
ASKED = 10
MODELS = {
    "so101": ("sts3215",) * 6,
    "koch": ("xl430-w250",) * 2 + ("xl330-m288",) * 4,
}


class Kill(NamedTuple):
    """One trial: milliseconds to the frame that takes the torque (None: there is no such frame), setpoints after
    it or else after the kill, and the number of servos that have torque ``LOOK_S`` later."""

    safe_ms: float | None
    setpoints_after: int
    with_torque: int


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m tests.lerobot.kills")
    parser.add_argument("repeats", type=int)
    parser.add_argument("whose", choices=("ours", "theirs"), nargs="?", default="ours")
    parser.add_argument("--robot", choices=tuple(MODELS), default="so101")
    parser.add_argument("--leader", action="store_true")
    given = parser.parse_args()
    found, loads = [], []
    for one in kills(given.robot, given.repeats, given.whose == "theirs", given.leader):
        found.append(one)
        loads.append(os.getloadavg()[0])
        print(*one, flush=True)
    times = sorted(one.safe_ms for one in found if one.safe_ms is not None)
    led = ", led by LeRobot's leader on rustypot" if given.leader else ""
    print(f"{given.robot} ({given.whose}){led}, {given.repeats} kills, lerobot {version('lerobot')}")
    print("; ".join(subject().values()), f"load {min(loads):.1f} to {max(loads):.1f}", sep="; ")
    print(f"a frame that takes the torque: {len(times)}")
    if times:
        print(f"after {statistics.median(times):.1f} ms (median), {times[-1]:.1f} ms (worst)")
    print(f"setpoints after it: {sum(one.setpoints_after for one in found)}")
    print(f"servos with torque {LOOK_S:g} s later: {Counter(one.with_torque for one in found)}")


def kills(robot: str, repeats: int, theirs: bool = False, leader: bool = False) -> Iterator[Kill]:
    """Yield the trials. The twins run through all of them.

    Args:
        robot: A robot of ``MODELS``.
        repeats: The number of trials.
        theirs: True for LeRobot's own class of the robot.
        leader: True for LeRobot's leader on rustypot, False for a sine.
    """
    home = Path(tempfile.mkdtemp(prefix="kills-"))
    os.environ |= {"HF_HOME": str(home), "HF_HUB_OFFLINE": "1", "STRANDS_ACTORS_RUN": str(home)}
    from lerobot.scripts import lerobot_teleoperate
    from lerobot.utils.import_utils import register_third_party_plugins

    register_third_party_plugins()  # its main does so, too: then it is done
    twin_module.PATIENCE_S = STARTS_S
    write(home)
    try:
        with contextlib.ExitStack() as twins:
            twin = twins.enter_context(Twin(robot, home))
            known = (f"--robot.type={robot}_follower", f"--robot.id={NAME}", f"--robot.calibration_dir={home}")
            kind = known if theirs else (f"--robot.type=strands_{robot}",)
            teleop = _leader(robot, home, twins) if leader else SINE
            sys.argv = ["lerobot-teleoperate", *kind, f"--robot.port={twin.port}", *teleop, "--fps=30"]
            for _ in range(repeats):
                yield _trial(twin, lerobot_teleoperate.main)
    finally:
        shutil.rmtree(home)


SINE = ("--teleop.discover_packages_path=tests.lerobot.sine", "--teleop.type=sine")


def _leader(robot: str, home: Path, twins: contextlib.ExitStack) -> tuple[str, ...]:
    (home / "leader").mkdir()
    leader = twins.enter_context(Twin(f"{robot}_leader", home / "leader"))
    return (
        "--teleop.discover_packages_path=tests.lerobot.on_rustypot",
        f"--teleop.type={robot}_leader",
        f"--teleop.port={leader.port}",
        f"--teleop.id={NAME}",
        f"--teleop.calibration_dir={home}",
    )


def _trial(twin: Twin, run: Callable[[], object], starts: int = STARTS) -> Kill:
    os.truncate(twin.log.path, 0)
    output = twin.log.path.with_name("output")
    pid = os.fork()
    if pid == 0:
        _child(run, output)
    deadline_s = time.monotonic() + STARTS_S
    while not twin.log.host("setpoint"):
        assert time.monotonic() < deadline_s, "it does not move"
        if os.waitpid(pid, os.WNOHANG) != (0, 0):  # it did not connect: no trial
            assert starts, f"it ends before it moves: {output.read_text()}"
            return _trial(twin, run, starts - 1)
        time.sleep(0.05)
    time.sleep(random.uniform(0.0, LATEST_S))
    killed_ns = time.monotonic_ns()
    os.kill(pid, signal.SIGKILL)
    os.waitpid(pid, 0)
    time.sleep(LOOK_S)
    safe = twin.log.first_safe(killed_ns)
    safe_ms = None if safe is None else (safe.t_ns - killed_ns) / 1e6
    after = len(twin.log.host("setpoint", killed_ns)) if safe is None else twin.log.setpoints_after_safe(killed_ns)
    return Kill(safe_ms, after, _with_torque(twin))


def _child(run: Callable[[], object], output: Path) -> None:
    written = os.open(output, os.O_RDWR | os.O_CREAT | os.O_TRUNC)
    os.dup2(written, 1)
    os.dup2(written, 2)
    try:
        run()
    except BaseException:
        traceback.print_exc()
    os._exit(1)


def _with_torque(twin: Twin) -> int:
    """Ask the servos, when nobody else has the port."""
    models = zip(MOTORS, enumerate(MODELS[twin.robot], start=1), strict=True)
    servos = Registers(twin.port, dict(models))
    servos.open()
    try:
        return sum(servos.sync_read("Torque_Enable", MOTORS, ASKED).values())
    finally:
        servos.close()


if __name__ == "__main__":
    main()
