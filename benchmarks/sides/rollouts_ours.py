"""``rollouts_ours LENGTH ROBOT PORT LOG``: run policies on the joints of a robot with legs, one after the other.

LENGTH is ``short`` or ``long`` (1 rollout of 2 s, or 10 of 10 s). ROBOT is the name of the robot, PORT the port of
the simulated robot, and LOG the file of the frames that it has read, which is not needed.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Mapping
from typing import Any

from benchmarks.stage import at_home
from strands_actors import Robot
from strands_actors.caller.handle.real_robot import RealRobot

ROLLOUTS = {"short": (1, 2.0), "long": (10, 10.0)}
"""Number of rollouts, and the duration of each (s)."""
COMPUTES_S = 0.0002
ENDS_WITHIN_S = 30.0


class OneAtATime:
    """A policy that computes for 0.2 ms and returns one action: each joint stays in its first position."""

    def __init__(self) -> None:
        self._action: dict[str, Any] = {}

    def get_actions_sync(self, observation: Mapping[str, float], instruction: str) -> list[dict[str, Any]]:
        if not self._action:
            self._action = {joint: {"q": rad, "kp": 200.0, "kd": 6.0} for joint, rad in observation.items()}
        until_s = time.perf_counter() + COMPUTES_S
        while time.perf_counter() < until_s:
            pass
        return [self._action]


def make_ready(robot: RealRobot) -> None:
    """Arm the robot, and release its onboard controller, if it has one that moves the joints."""
    robot.resume()
    service = robot.driver.BEFORE_MOTION
    if service and (answer := robot.service(service))["status"] != "success":
        raise RuntimeError(f"{service}: {answer}")


def rollout(robot: RealRobot, duration_s: float) -> tuple[float, str]:
    """Run one policy. Return its steps per second, and why it ended too early; an empty text if it did not."""
    began_s = time.monotonic()
    answer = robot.run_policy(OneAtATime(), duration=duration_s)
    if answer["status"] != "success":
        raise RuntimeError(f"the policy was not started: {answer}")
    while (task := robot.get_task_status()["content"][0]["json"])["running"]:
        if time.monotonic() - began_s > duration_s + ENDS_WITHIN_S:
            raise RuntimeError(f"the policy does not end: {task}")
        time.sleep(0.1)
    ended = "" if task["exit_reason"] == "duration" else f"{task['exit_reason']}: {task['exit_detail']}"
    return task["hz"], ended


def main(length: str, name: str, port: str, log_path: str) -> None:
    at_home()
    rollouts, duration_s = ROLLOUTS[length]
    rates_hz: list[float] = []
    early: list[str] = []
    with Robot(name, mode="real", port=port) as robot:
        for _ in range(rollouts):
            make_ready(robot)
            rate_hz, ended = rollout(robot, duration_s)
            rates_hz.append(rate_hz)
            if ended:
                print(f"{name}: {ended}", file=sys.stderr)
                early.append(ended)
    print(json.dumps({"steps_per_s": min(rates_hz), "ended_early": len(early)}), flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
