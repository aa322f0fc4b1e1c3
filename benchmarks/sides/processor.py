"""``processor LENGTH ROBOT PORT LOG``: measure the processor time of a robot's processes.

LENGTH is ``short`` or ``long`` (2 or 20 s for each case). ROBOT is the name of the robot, PORT the port of the
simulated robot, and LOG the file of the frames that it has read, which is not needed.

There are two cases. The robot is ``rest``: armed, and without a command. Or it is ``stream``: this process sends 50
setpoints per second. The figures are percent of one core, for the robot's processes together, and at rest for each
role. This process counts only while it streams, since at rest it has nothing to do. The memory is the proportional
set size of the robot's processes, without this process.
"""

from __future__ import annotations

import json
import os
import sys
import time
from collections.abc import Callable
from typing import Any

from benchmarks.house import Figures
from benchmarks.stage import at_home
from strands_actors import Robot

from .telemetry import memory_mb
from .wire import processor_s

SECONDS = {"short": 2.0, "long": 20.0}
SETTLE_S = 3.0
"""Time after the start until the processes only do what they do all the time."""
PERIOD_S = 0.02
ROLES = ("root", "wire", "standby")


def shares_pct(pids: dict[str, int], seconds: float, do: Callable[[float], None]) -> dict[str, float]:
    """Return the processor time of each process in percent of a core, while ``do(seconds)`` runs."""
    before_s = {role: processor_s(pid) for role, pid in pids.items()}
    began_s = time.monotonic()
    do(seconds)
    took_s = time.monotonic() - began_s
    return {role: 100 * (processor_s(pid) - before_s[role]) / took_s for role, pid in pids.items()}


def stream(robot: Any, seconds: float) -> None:
    """Send 50 setpoints per second that keep the robot where it is.

    Raises:
        RuntimeError: A setpoint is refused.
    """
    still = dict(robot.get_observation())
    next_s = time.monotonic()
    until_s = next_s + seconds
    while next_s < until_s:
        answer = robot.send_action(still)
        if answer["status"] != "success":
            raise RuntimeError(f"a setpoint is refused: {answer}")
        next_s += PERIOD_S
        time.sleep(max(0.0, next_s - time.monotonic()))


def main(length: str, name: str, port: str, log_path: str) -> None:
    at_home()
    seconds = SECONDS[length]
    with Robot(name, mode="real", port=port) as robot:
        entries = (robot.tree() or {})["processes"]
        pids = {entry["role"]: entry["pid"] for entry in entries if entry["pid"] != os.getpid()}
        time.sleep(SETTLE_S)
        at_rest = shares_pct(pids, seconds, time.sleep)
        figures: Figures = {f"rest_{role}_pct": at_rest[role] for role in ROLES if role in at_rest}
        figures["rest_pct"] = sum(at_rest.values())
        if not robot.driver.BEFORE_MOTION:
            with_us = pids | {"caller": os.getpid()}
            streaming = shares_pct(with_us, seconds, lambda seconds: stream(robot, seconds))
            figures["stream_caller_pct"] = streaming.pop("caller")
            figures["stream_pct"] = sum(streaming.values())
        figures["memory_mb"] = memory_mb(list(pids.values()))
    print(json.dumps(figures), flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
