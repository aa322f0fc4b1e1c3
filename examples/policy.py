"""Run two policies on an arm: one in this process, one in a separate process.

python examples/policy.py                  a simulated arm, no robot needed
python examples/policy.py /dev/ttyACM0     a real SO-101

At the end the arm is stopped and its motors have no torque. A real arm then sinks, so support it.
"""

import math
import sys
import time

from strands_actors import Robot


class Wave:
    """A policy that moves one joint by two degrees to either side of its first position, at 0.5 Hz.

    It returns chunks of ten actions, for a rollout at 50 actions per second.
    """

    def __init__(self, joint: str) -> None:
        self.joint = joint
        self.steps = 0
        self.center: float | None = None

    def get_actions_sync(self, observation: dict[str, float], instruction: str) -> list[dict[str, float]]:
        if self.center is None:
            self.center = observation[self.joint]
        chunk = []
        for _ in range(10):
            self.steps += 1
            chunk.append({self.joint: self.center + 2.0 * math.sin(2.0 * math.pi * 0.5 * self.steps / 50)})
        return chunk


def wait(arm) -> dict:
    """Wait until the rollout has ended, and return its result."""
    while (task := arm.get_task_status()["content"][0]["json"])["running"]:
        time.sleep(0.05)
    return task


port = sys.argv[1] if len(sys.argv) > 1 else None
with Robot("so101", mode="real", port=port, transport=None if port else "twin") as arm:
    # A policy object runs in this process. ``run_policy`` returns at once.
    arm.run_policy(Wave("shoulder_pan"), "wave", duration=2.0, control_frequency=50)
    task = wait(arm)
    print(f"in this process: {task['steps']} steps, {task['hz']:.0f} Hz, ended by {task['exit_reason']}")

    # A policy that is given by name runs in a separate process.
    arm.start_task("wave", policy_provider="mock", duration=1.0)
    task = wait(arm)
    print(f"in its own:      {task['steps']} steps, {task['hz']:.0f} Hz, ended by {task['exit_reason']}")

    # A jump of 90 degrees is too fast. The robot's checks refuse it, and this ends the rollout.
    arm.run_policy(lambda observation: {"shoulder_pan": observation["shoulder_pan"] + 90.0})
    print("too fast:       ", wait(arm)["exit_detail"])

    stopped = arm.stop()["content"][0]["json"]
    print(f"stopped:         {stopped['safe_state']}, {len(stopped['motors'])} motors confirmed")
