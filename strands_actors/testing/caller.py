"""The script of a caller that drives a twin, and then ends the way it is told on standard input.

``python -m strands_actors.testing.caller ROBOT loop FAR`` moves the robot's first joint itself at 50 Hz, up to
``FAR`` units away; ``ROBOT rollout FAR`` by a policy of this process, at the robot's own rate; ``ROBOT task FAR
TRIGGER`` has a policy process do so. It prints one JSON line when the robot moves, then obeys: exception, exit or
spin.
"""

from __future__ import annotations

import json
import math
import select
import sys
import time

from strands_actors import Robot


def main(robot: str, motion: str, far: str, trigger: str = "") -> None:
    arm = Robot(robot, mode="real", transport="twin")
    problem = arm.connect_eagerly()
    if problem is not None:
        raise SystemExit(problem)
    if motion == "task":
        arm.start_task(
            "wave",
            policy_provider="strands_actors.testing.policies:Faulty",
            control_frequency=50,
            trigger=trigger,
            amplitude=float(far),
        )
        while (task := arm.get_task_status()["content"][0]["json"])["steps"] < 10:
            if not task["running"]:
                raise SystemExit(f"the policy does not run: {task}")
            time.sleep(0.01)
    joint, here = next(iter(arm.get_observation().items()))
    began_s, told = time.monotonic(), False

    def wave(_: object) -> dict[str, float]:
        return {joint: here + float(far) * (1.0 - math.cos(time.monotonic() - began_s)) / 2}

    if motion == "rollout":
        # a twentieth of a second at a time: the machine may be busy
        arm.run_policy(lambda seen: [wave(seen)] * 25, duration=60.0)
    while True:
        if motion == "loop":
            arm.send_action(wave(None))
        if not told and time.monotonic() - began_s > 0.2:
            told = True
            if motion == "rollout" and not arm.get_task_status()["content"][0]["json"]["running"]:
                raise SystemExit("the rollout has ended by itself")
            print(json.dumps(arm.tree()), flush=True)
        if select.select([sys.stdin], [], [], 0.02)[0]:
            how = sys.stdin.readline().strip()
            print(json.dumps({"at_ns": time.monotonic_ns()}), flush=True)
            if how == "exception":
                raise RuntimeError("a fault was asked for")
            if how == "exit":
                sys.exit(3)
            while how == "spin":
                pass


if __name__ == "__main__":
    main(*sys.argv[1:])
