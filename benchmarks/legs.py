"""A G1 at 500 Hz for a minute, with a policy that keeps the interpreter's lock of its own process busy.

``python benchmarks/legs.py --seconds 60`` prints one JSON object: the gaps between LowCmds by the twin's log, the
processor time of each process, and how root and wire are run. On a machine that does nothing else.
"""

from __future__ import annotations

import argparse
import itertools
import json
import os
import tempfile
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from strands_actors import Robot
from strands_actors.testing import WireLog

GAP_MS = 4.0
SPIN_S = 0.03
CHUNK = 25
"""Actions an inference: 50 ms of them, worked out in 30."""


class Spinner:
    """Stands where it is first seen, and computes without letting go of the lock."""

    def __init__(self) -> None:
        self._action: dict[str, Any] = {}

    def get_actions_sync(self, observation: Mapping[str, float], instruction: str) -> list[dict[str, Any]]:
        if not self._action:
            self._action = {joint: {"q": rad, "kp": 200.0, "kd": 6.0} for joint, rad in observation.items()}
        until_s = time.perf_counter() + SPIN_S
        while time.perf_counter() < until_s:
            pass
        return [self._action] * CHUNK


def processor_s(pid: int) -> float:
    """User and system time of a process, all its threads."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def measure(seconds: float, directory: Path) -> dict[str, Any]:
    log = WireLog(directory / "wire.ndjson")
    os.environ["STRANDS_ACTORS_TWIN_LOG"] = str(log.path)
    with Robot("g1", mode="real", transport="twin") as robot:
        tree = robot.tree()
        assert tree is not None
        pids = {process["role"]: process["pid"] for process in tree["processes"]}
        status = robot.get_status()
        robot.run_policy(Spinner(), duration=seconds + 2.0)
        time.sleep(1.0)
        before = {role: processor_s(pid) for role, pid in pids.items()}
        began_s = time.monotonic()
        time.sleep(seconds)
        took_s = time.monotonic() - began_s
        cpu = {role: (processor_s(pid) - before[role]) / took_s for role, pid in pids.items()}
        task = robot.get_task_status()["content"][0]["json"]
    times_ns = [entry.t_ns for entry in log.host("setpoint")]
    gaps_ms = sorted((after - earlier) / 1e6 for earlier, after in itertools.pairwise(times_ns))
    return {
        "lowcmd_hz": round(len(gaps_ms) / (sum(gaps_ms) / 1e3), 1),
        "gap_ms_p50": round(gaps_ms[len(gaps_ms) // 2], 2),
        "gap_ms_p99": round(gaps_ms[len(gaps_ms) * 99 // 100], 2),
        "gap_ms_max": round(gaps_ms[-1], 2),
        "gaps_above_4_ms_pct": round(100 * sum(gap > GAP_MS for gap in gaps_ms) / len(gaps_ms), 3),
        "processor_pct": {role: round(100 * share, 1) for role, share in cpu.items()},
        "policy_hz": task["hz"],
        "still_running": task["running"],
        "fell": bool(fallen_before_the_end(log)),
        "scheduling": status["content"][0]["json"].get("scheduling"),  # type: ignore[index]
    }


def fallen_before_the_end(log: WireLog) -> list[int]:
    last = log.host("setpoint")[-1].t_ns
    return [entry.t_ns for entry in log.entries() if entry.kind == "fell" and entry.t_ns < last]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=60.0)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as directory:
        print(json.dumps(measure(options.seconds, Path(directory)), indent=2))


if __name__ == "__main__":
    main()
