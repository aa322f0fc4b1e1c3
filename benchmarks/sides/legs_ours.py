"""``legs_ours LENGTH PORT LOG``: command a Unitree G1 at 500 Hz with this package, by a policy that keeps the
script's interpreter lock busy.

LENGTH is ``short`` or ``long`` (4 or 60 s). PORT is the port of the simulated robot, and LOG the file of the
frames that it has read.
"""

from __future__ import annotations

import itertools
import json
import sys
import time
from collections.abc import Mapping
from typing import Any

from benchmarks.stage import at_home
from strands_actors import Robot

from .wire import Log, percentile, processor_s

SECONDS = {"short": 4.0, "long": 60.0}
GAP_MS = 4.0
SPIN_S = 0.03
CHUNK = 25
"""Actions per inference: 50 ms of actions, computed in 30 ms."""


class Spinner:
    """A policy that commands the first observed pose, and computes without releasing the interpreter's lock."""

    def __init__(self) -> None:
        self._action: dict[str, Any] = {}

    def get_actions_sync(self, observation: Mapping[str, float], instruction: str) -> list[dict[str, Any]]:
        if not self._action:
            self._action = {joint: {"q": rad, "kp": 200.0, "kd": 6.0} for joint, rad in observation.items()}
        until_s = time.perf_counter() + SPIN_S
        while time.perf_counter() < until_s:
            pass
        return [self._action] * CHUNK


def gaps(times_ns: list[int]) -> dict[str, float]:
    gaps_ms = [(after - before) / 1e6 for before, after in itertools.pairwise(times_ns)]
    return {
        "lowcmd_hz": len(gaps_ms) / (sum(gaps_ms) / 1e3),
        "gap_p99_ms": percentile(gaps_ms, 0.99),
        "gap_worst_ms": max(gaps_ms),
        "above_4_ms_pct": 100 * sum(gap > GAP_MS for gap in gaps_ms) / len(gaps_ms),
    }


def main(length: str, port: str, log_path: str) -> None:
    at_home()
    seconds = SECONDS[length]
    log = Log(log_path)
    with Robot("g1", mode="real", port=port) as robot:
        tree = robot.tree()
        assert tree is not None
        pids = {process["role"]: process["pid"] for process in tree["processes"]}
        robot.run_policy(Spinner(), duration=seconds + 2.0)
        time.sleep(1.0)
        before = {role: processor_s(pid) for role, pid in pids.items()}
        began_ns = time.monotonic_ns()
        time.sleep(seconds)
        until_ns = time.monotonic_ns()
        used = {role: processor_s(pid) - before[role] for role, pid in pids.items()}
        task = robot.get_task_status()["content"][0]["json"]
        if not task["running"]:
            raise RuntimeError(f"the policy ended during the measurement: {task}")
    took_s = (until_ns - began_ns) / 1e9
    times_ns = [frame.t_ns for frame in log.setpoints() if began_ns <= frame.t_ns <= until_ns]
    figures = gaps(times_ns) | {"process_pct": 100 * used["wire"] / took_s, "root_pct": 100 * used["root"] / took_s}
    print(json.dumps(figures), flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
