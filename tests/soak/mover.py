"""Move several robots for a long time, as a user's program. Arguments: seconds, then names of robots.

It restarts a policy every 5 s, and stops and resumes each robot every 20 s. The answer of each verb is
one line of JSON on standard output.
"""

from __future__ import annotations

import json
import sys
import time
from typing import Any

from strands_actors import Robot

ROUND_S = 5.0
STOP_EVERY = 4
"""Rounds between two stops."""
POLICY = "tests.soak.edges:Edges"
HZ = 25.0
SHARE = 0.5
"""Largest step, as a share of the distance that a joint can move in one period."""
START_S = 60.0


def main(seconds: float, *names: str) -> None:
    robots = {name: Robot(name, transport="twin", mode="real", tool_name=f"soak_{name}") for name in names}
    try:
        for name, robot in robots.items():
            connect(name, robot)
        end_s = time.monotonic() + seconds
        number = 0
        while time.monotonic() < end_s:
            next_s = time.monotonic() + ROUND_S
            for name, robot in robots.items():
                play(name, robot, number)
            number += 1
            time.sleep(max(0.0, next_s - time.monotonic()))
    finally:
        for name, robot in robots.items():
            tell(name, "cleanup", robot.cleanup())


def connect(name: str, robot: Any) -> None:
    """Connect. On a busy machine a process may be late enough to count as frozen, so try again."""
    deadline_s = time.monotonic() + START_S
    while (problem := robot.connect_eagerly()) is not None:
        if time.monotonic() > deadline_s:
            raise SystemExit(f"{name}: {problem}")
        time.sleep(0.1)


def play(name: str, robot: Any, number: int) -> None:
    if number % STOP_EVERY == STOP_EVERY - 1:
        tell(name, "stop", robot.stop())
        tell(name, "resume", robot.resume())
    else:
        robot.stop_task()
    began = robot.start_task("to the limits", policy_provider=POLICY, control_frequency=HZ, **limits(robot))
    # The robot may have been stopped meanwhile, because of a fault or a busy machine.
    if began["status"] != "success":
        tell(name, "resume", robot.resume(), began)
        began = robot.start_task("again", policy_provider=POLICY, control_frequency=HZ, **limits(robot))
    tell(name, "start_task", began)


def limits(robot: Any) -> dict[str, Any]:
    """Return the options of the policy: first and last joint, with their limits and largest steps."""
    axes = (robot.driver.table[0], robot.driver.table[-1])
    return {
        "axes": [axis.key for axis in axes],
        "low": [axis.low for axis in axes],
        "high": [axis.high for axis in axes],
        "step": [SHARE * axis.speed / HZ for axis in axes],
    }


def tell(name: str, verb: str, answer: Any, after: Any = None) -> None:
    line = {"robot": name, "verb": verb, "ok": answer["status"] == "success", "answer": answer, "after": after}
    print(json.dumps(line), flush=True)


if __name__ == "__main__":
    main(float(sys.argv[1]), *sys.argv[2:])
