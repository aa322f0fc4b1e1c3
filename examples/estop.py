"""Stop two simulated arms with one e-stop, and print a report of each.

python examples/estop.py

Caution: the e-stop stops every robot of this user on this host, also the robots of other scripts. It
locks each robot's name until ``resume(name)``. The lock outlives the script, and applies to a real robot
of that name, too. Therefore the example resumes its own two arms at the end.
"""

from __future__ import annotations

import contextlib

from strands_actors import Robot, estop, resume


def main() -> None:
    with contextlib.ExitStack() as stack:
        arms = [stack.enter_context(Robot(robot, mode="real", transport="twin")) for robot in ("so101", "koch")]
        for arm in arms:
            arm.send_action({"shoulder_pan": 20.0})

        # One call stops all robots. It returns what each robot has confirmed.
        for outcome in estop(by="the example"):
            print(f"{outcome.robot}: {outcome.outcome}, {outcome.safe_state}, {len(outcome.motors)} motors")

        # Each robot refuses to move until ``resume``.
        for arm in arms:
            print(arm.send_action({"shoulder_pan": 0.0})["content"][0]["text"])
        # ``resume`` lifts the lock and energises the arm. It starts no motion.
        for arm in arms:
            resume(arm.name)
            print(f"{arm.name}, after a resume: {arm.send_action({'shoulder_pan': 0.0})['status']}")


if __name__ == "__main__":
    main()
