"""``fleet LENGTH``: command many simulated SO-101 arms from one process, at a steady rate. LENGTH is ``short`` or
``long``.

``--robots``, ``--hz`` and ``--seconds`` change the defaults. The figure ``left_armed`` counts the arms that did
not stay energised: the status was not always ``armed``, or the arm received a safe frame (a stop command). Their
events are printed on stderr.
"""

from __future__ import annotations

import argparse
import contextlib
import itertools
import json
import math
import os
import sys
import tempfile
import threading
import time
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from benchmarks.stage import at_home
from strands_actors import Robot
from strands_actors.caller.handle.robot import RealRobot
from strands_actors.testing import WireLog

from .wire import percentile, processor_s

SIZES = {"short": (2, 4.0), "long": (12, 20.0)}
"""Number of robots, and seconds."""

LOOK_S = 0.25
SWING_DEG = 20.0
SWING_HZ = 0.25
MAX_PRINTED = 10
"""Number of events that are printed."""


@dataclass
class Arm:
    """One robot with the log of its frames, its events, and the method that a thread runs to command it."""

    robot: RealRobot
    log: WireLog
    events: list[str] = field(default_factory=list)
    answers_s: list[float] = field(default_factory=list)
    state: str = "armed"
    armed_ns: int = 0

    def command(self, hz: float, began_s: float, end: threading.Event) -> None:
        step = 0
        while not end.wait(max(0.0, began_s + step / hz - time.monotonic())):
            sent_s = time.monotonic()
            angle = SWING_DEG * math.sin(math.tau * SWING_HZ * (sent_s - began_s))
            answer = self.robot.send_action({"shoulder_pan": angle})
            self.answers_s.append(time.monotonic() - sent_s)
            if answer["status"] != "success":
                self.note(began_s, f"refused: {answer['content'][0]['text']}")
            # If a command took longer than its period, continue with the next time that is still to come.
            step = max(step + 1, math.ceil((time.monotonic() - began_s) * hz))

    def look(self, began_s: float) -> None:
        status = self.robot.get_status()["content"][0]["json"]
        state = status.get("state", "unreachable")
        if state != self.state:
            cause = status.get("cause") or status["connect_error"] or ""
            self.note(began_s, f"{self.state} -> {state}: {cause}")
        self.state = state

    def note(self, began_s: float, event: str) -> None:
        self.events.append(f"{time.monotonic() - began_s:.2f} s {self.robot.name}: {event}")


def start(number: int, directory: Path, **options: Any) -> Arm:
    """Start one robot with its own log. ``options`` are those of its driver."""
    log = directory / f"{number}.ndjson"
    os.environ["STRANDS_ACTORS_TWIN_LOG"] = str(log)
    robot = Robot("so101", mode="real", transport="twin", tool_name=f"arm{number:02}", **options)
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
        # Each arm's thread begins at another time of the period, as independent robots would.
        threading.Thread(target=arm.command, args=(hz, began_s + index / hz / len(arms), end))
        for index, arm in enumerate(arms)
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
    """Return the process ids for each role (caller, root, wire and so on), of all arms together."""
    pids: dict[str, set[int]] = {}
    for arm in arms:
        for process in (arm.robot.tree() or {"processes": ()})["processes"]:
            pids.setdefault(process["role"], set()).add(process["pid"])
    return pids


def restarts(arms: list[Arm]) -> int:
    trees = [arm.robot.tree() for arm in arms]
    return sum(process["restarts"] for tree in trees if tree for process in tree["processes"])


def cpu_s(pids: set[int]) -> float:
    total = 0.0
    for pid in pids:
        with contextlib.suppress(FileNotFoundError):
            total += processor_s(pid)
    return total


def pss_mb(pids: set[int]) -> float:
    """Return the memory of these processes in MB. Memory that several of them share counts once (proportional set
    size).
    """
    total_kb = 0
    for pid in pids:
        with contextlib.suppress(FileNotFoundError):
            lines = Path(f"/proc/{pid}/smaps_rollup").read_text().splitlines()
            total_kb += sum(int(line.split()[1]) for line in lines if line.startswith("Pss:"))
    return total_kb / 1e3


def wire_summary(arm: Arm, until_ns: int) -> tuple[int, int, float]:
    """Return what one arm received from the energising of its motors until ``until_ns``: the number of
    setpoints, the number of safe frames (stop commands), and the longest pause between two setpoints in ms.
    """
    setpoints, safe = [], 0
    for entry in arm.log.entries(arm.armed_ns):
        if entry.sender != "host" or entry.t_ns > until_ns:
            continue
        safe += entry.kind == "safe"
        if entry.kind == "setpoint":
            setpoints.append(entry.t_ns)
    gaps = [later - earlier for earlier, later in itertools.pairwise(setpoints)]
    return len(setpoints), safe, max(gaps, default=0) / 1e6


def run(count: int, hz: float, seconds: float, directory: Path) -> dict[str, float]:
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
        sizes = {role: pss_mb(of_role) for role, of_role in pids.items()}
        restarted = restarts(arms)
    finally:
        for arm in arms:
            arm.robot.cleanup()
    wires = [wire_summary(arm, until_ns) for arm in arms]
    disturbed = [arm for arm, wire in zip(arms, wires, strict=True) if arm.events or wire[1]]
    for event in [event for arm in disturbed for event in _shortened(arm.events)][:MAX_PRINTED]:
        print(event, file=sys.stderr)
    answers_ms = [1e3 * second for arm in arms for second in arm.answers_s]
    return {
        "left_armed": len(disturbed),
        "restarts": restarted,
        "safe_frames": sum(wire[1] for wire in wires),
        "commands_hz": min(len(arm.answers_s) for arm in arms) / driven_s,
        "answer_p50_ms": percentile(answers_ms, 0.5),
        "answer_p99_ms": percentile(answers_ms, 0.99),
        "gap_worst_ms": max(wire[2] for wire in wires),
        **{f"{role}_cpu_pct": 100 * share / driven_s / count for role, share in used.items()},
        **{f"{role}_mb": size / count for role, size in sizes.items() if role != "caller"},
    }


def _shortened(events: list[str]) -> list[str]:
    """Return the first event of each kind. Events of one kind differ only in their times."""
    counts: Counter[str] = Counter()
    first = []
    for event in events:
        category = event.partition(": ")[2]
        counts[category] += 1
        if counts[category] == 1:
            first.append(event)
    return first


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("length", choices=SIZES)
    parser.add_argument("--robots", type=int)
    parser.add_argument("--hz", type=float, default=20.0)
    parser.add_argument("--seconds", type=float)
    options = parser.parse_args()
    robots, seconds = SIZES[options.length]
    with tempfile.TemporaryDirectory(prefix="sa-") as directory:
        at_home(f"{directory}/run")
        figures = run(options.robots or robots, options.hz, options.seconds or seconds, Path(directory))
    print(json.dumps(figures), flush=True)


if __name__ == "__main__":
    main()
