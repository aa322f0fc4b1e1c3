"""``fleet_estop LENGTH``: stop many simulated SO-101 arms by one e-stop. LENGTH is ``short`` or ``long``.

The times are from the press to the first safe frame of each arm on its wire, and to the results of all arms at
the program that pressed. ``not_safe`` counts the results that are not ``safe``, of all presses. ``--robots`` and
``--presses`` change the defaults.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from pathlib import Path

from benchmarks.stage import at_home
from strands_actors import estop_button

from .fleet import Arm, start
from .wire import percentile

SIZES = {"short": (2, 3), "long": (12, 20)}
"""Number of robots, and of presses."""
MOVES_S = 0.3
"""The arms move for so long before each press."""


def run(count: int, presses: int, directory: Path) -> dict[str, float]:
    arms: list[Arm] = []
    frames_ms: list[float] = []
    last_frames_ms: list[float] = []
    results_ms: list[float] = []
    not_safe = 0
    try:
        for number in range(count):
            arms.append(start(number, directory, on_exit="limp"))
        with estop_button(by="the benchmark") as press:
            for turn in range(presses):
                move(arms, 5.0 if turn % 2 else -5.0)
                pressed_ns = time.monotonic_ns()
                outcomes = press()
                results_ms.append((time.monotonic_ns() - pressed_ns) / 1e6)
                not_safe += sum(outcome.outcome != "safe" for outcome in outcomes) + count - len(outcomes)
                of_press = [first_safe_ms(arm, pressed_ns) for arm in arms]
                frames_ms += of_press
                last_frames_ms.append(max(of_press))
    finally:
        for arm in arms:
            arm.robot.cleanup()
    return {
        "not_safe": not_safe,
        "frame_p50_ms": percentile(frames_ms, 0.5),
        "last_frame_p50_ms": percentile(last_frames_ms, 0.5),
        "last_frame_worst_ms": max(last_frames_ms),
        "results_p50_ms": percentile(results_ms, 0.5),
        "results_worst_ms": max(results_ms),
    }


def move(arms: list[Arm], angle: float) -> None:
    """Resume all arms, and let them move."""
    for arm in arms:
        answer = arm.robot.resume()
        if answer["status"] == "success":
            answer = arm.robot.send_action({"shoulder_pan": angle})
        if answer["status"] != "success":
            raise SystemExit(f"{arm.robot.name}: {answer['content'][0]['text']}")
    time.sleep(MOVES_S)


def first_safe_ms(arm: Arm, pressed_ns: int) -> float:
    """Return the time from the press to the arm's first safe frame."""
    for entry in arm.log.entries(pressed_ns):
        if entry.sender == "host" and entry.kind == "safe":
            return (entry.t_ns - pressed_ns) / 1e6
    raise SystemExit(f"{arm.robot.name}: no safe frame after the e-stop")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("length", choices=SIZES)
    parser.add_argument("--robots", type=int)
    parser.add_argument("--presses", type=int)
    options = parser.parse_args()
    robots, presses = SIZES[options.length]
    with tempfile.TemporaryDirectory(prefix="sa-") as directory:
        at_home(f"{directory}/run")
        figures = run(options.robots or robots, options.presses or presses, Path(directory))
    print(json.dumps(figures), flush=True)


if __name__ == "__main__":
    main()
