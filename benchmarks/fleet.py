"""Many arms from one process: N SO-101 twins with their trees, each commanded at a steady rate.

``python benchmarks/fleet.py --robots 12 --hz 20 --seconds 60`` prints one JSON line. Exit code 1 when a robot
left ``armed``: its status said so, or its wire shows a safe frame after it was armed.
"""

from __future__ import annotations

import argparse
import itertools
import json
import math
import os
import statistics
import sys
import tempfile
import threading
import time
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from strands_actors import Robot
from strands_actors.robot import RealRobot
from strands_actors.testing import WireLog

LOOK_S = 0.25
SWING_DEG = 20.0
SWING_HZ = 0.25
TOLD = 10
"""How many of the events are printed."""


@dataclass
class Arm:
    """One robot, what was seen of it, and the thread that commands it."""

    robot: RealRobot
    log: WireLog
    events: list[str] = field(default_factory=list)
    answers_s: list[float] = field(default_factory=list)
    state: str = "armed"
    armed_ns: int = 0

    def command(self, hz: float, began_s: float, end: threading.Event) -> None:
        step = 0
        while not end.wait(max(0.0, began_s + step / hz - time.monotonic())):
            asked_s = time.monotonic()
            angle = SWING_DEG * math.sin(math.tau * SWING_HZ * (asked_s - began_s))
            answer = self.robot.send_action({"shoulder_pan": angle})
            self.answers_s.append(time.monotonic() - asked_s)
            if answer["status"] != "success":
                self.note(began_s, f"refused: {answer['content'][0]['text']}")
            step = max(step + 1, math.ceil((time.monotonic() - began_s) * hz))  # what was missed is not made up for

    def look(self, began_s: float) -> None:
        status = self.robot.get_status()["content"][0]["json"]  # type: ignore[index]
        state = status.get("state", "unreachable")
        if state != self.state:
            why = status.get("cause") or status["connect_error"] or ""
            self.note(began_s, f"{self.state} -> {state}: {why}")
        self.state = state

    def note(self, began_s: float, what: str) -> None:
        self.events.append(f"{time.monotonic() - began_s:.2f} s {self.robot.name}: {what}")


def start(number: int, directory: Path) -> Arm:
    log = directory / f"{number}.ndjson"
    os.environ["STRANDS_ACTORS_TWIN_LOG"] = str(log)
    robot = Robot("so101", mode="real", transport="twin", tool_name=f"arm{number:02}")
    arm = Arm(robot, WireLog(log))
    problem = robot.connect_eagerly()
    if problem is not None:
        robot.cleanup()
        raise SystemExit(f"{robot.name}: {problem}")
    arm.armed_ns = time.monotonic_ns()
    return arm


def drive(arms: list[Arm], hz: float, seconds: float) -> None:
    end = threading.Event()
    began_s = time.monotonic()
    threads = [
        # Spread over the period, as robots that know nothing of each other are.
        threading.Thread(target=arm.command, args=(hz, began_s + at / hz / len(arms), end))
        for at, arm in enumerate(arms)
    ]
    for thread in threads:
        thread.start()
    while time.monotonic() < began_s + seconds:
        for arm in arms:
            arm.look(began_s)
        time.sleep(LOOK_S)
    end.set()
    for thread in threads:
        thread.join()


def processes(arms: list[Arm]) -> dict[str, set[int]]:
    """Pids by role."""
    found: dict[str, set[int]] = {}
    for arm in arms:
        for process in (arm.robot.tree() or {"processes": ()})["processes"]:
            found.setdefault(process["role"], set()).add(process["pid"])
    return found


def restarts(arms: list[Arm]) -> int:
    trees = [arm.robot.tree() for arm in arms]
    return sum(process["restarts"] for tree in trees if tree for process in tree["processes"])


def cpu_s(pids: set[int]) -> float:
    ticks = 0
    for pid in pids:
        try:
            fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
        except FileNotFoundError:
            continue
        ticks += int(fields[11]) + int(fields[12])
    return ticks / os.sysconf("SC_CLK_TCK")


def rss_mb(pids: set[int]) -> list[float]:
    page = os.sysconf("SC_PAGE_SIZE")
    sizes = []
    for pid in pids:
        try:
            sizes.append(int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * page / 1e6)
        except FileNotFoundError:
            continue
    return sizes


def wire_summary(arm: Arm, until_ns: int) -> tuple[int, int, float]:
    """Setpoints, safe frames, and the longest pause between two setpoints in ms, from armed until then."""
    setpoints, safe = [], 0
    for entry in arm.log.entries(arm.armed_ns):
        if entry.sender != "host" or entry.t_ns > until_ns:
            continue
        safe += entry.kind == "safe"
        if entry.kind == "setpoint":
            setpoints.append(entry.t_ns)
    gaps = [later - earlier for earlier, later in itertools.pairwise(setpoints)]
    return len(setpoints), safe, max(gaps, default=0) / 1e6


def run(count: int, hz: float, seconds: float, directory: Path) -> dict[str, Any]:
    arms: list[Arm] = []
    try:
        for number in range(count):
            arms.append(start(number, directory))
        pids = processes(arms)
        before = {role: cpu_s(of_role) for role, of_role in pids.items()}
        began_s = time.monotonic()
        drive(arms, hz, seconds)
        driven_s = time.monotonic() - began_s
        until_ns = time.monotonic_ns()
        used = {role: cpu_s(of_role) - before[role] for role, of_role in pids.items()}
        sizes = {role: rss_mb(of_role) for role, of_role in pids.items()}
        restarted = restarts(arms)
    finally:
        for arm in arms:
            arm.robot.cleanup()
    wires = [wire_summary(arm, until_ns) for arm in arms]
    left = [arm for arm, wire in zip(arms, wires, strict=True) if arm.events or wire[1]]
    answers_s = sorted(second for arm in arms for second in arm.answers_s)
    return {
        "robots": count,
        "hz": hz,
        "seconds": seconds,
        "left_armed": len(left),
        "setpoints_per_robot_min": min(wire[0] for wire in wires),
        "commands_per_robot_min": min(len(arm.answers_s) for arm in arms),
        "setpoint_gap_worst_ms": round(max(wire[2] for wire in wires), 1),
        "safe_frames": sum(wire[1] for wire in wires),
        "restarts": restarted,
        "answer_ms": {
            "median": round(statistics.median(answers_s) * 1e3, 2),
            "p99": round(answers_s[int(len(answers_s) * 0.99)] * 1e3, 2),
            "worst": round(answers_s[-1] * 1e3, 2),
        },
        "rss_mb_max": {role: round(max(of_role, default=0.0), 1) for role, of_role in sizes.items()},
        "rss_mb_total": round(sum(sum(of_role) for of_role in sizes.values())),
        "cpu_percent_of_machine": {
            role: round(100 * seconds_used / driven_s / (os.cpu_count() or 1), 1)
            for role, seconds_used in used.items()
        },
        "cores": os.cpu_count(),
        "load_1min": round(os.getloadavg()[0], 2),
        "events": [event for arm in left for event in _shortened(arm.events)][:TOLD],
    }


def _shortened(events: list[str]) -> list[str]:
    """The first of each kind."""
    seen: Counter[str] = Counter()
    first = []
    for event in events:
        kind = event.partition(": ")[2]
        seen[kind] += 1
        if seen[kind] == 1:
            first.append(event)
    return first


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--robots", type=int, default=12)
    parser.add_argument("--hz", type=float, default=20.0)
    parser.add_argument("--seconds", type=float, default=60.0)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="sa-") as directory:
        os.environ["STRANDS_ACTORS_RUN"] = f"{directory}/run"
        told = run(options.robots, options.hz, options.seconds, Path(directory))
    print(json.dumps(told), flush=True)
    return 1 if told["left_armed"] else 0


if __name__ == "__main__":
    sys.exit(main())
