"""Stop a fleet: two arms on their twins, one e-stop, a report on each: python examples/estop.py

It stops every robot of this user on this host, also those of other scripts. An e-stop locks a robot
by its name until somebody resumes it, a real one of that name too, and also when the script has
ended: so the example resumes its own two.
"""

from __future__ import annotations

import contextlib

from strands_actors import Robot, estop, resume


def main() -> None:
    with contextlib.ExitStack() as stack:
        arms = [stack.enter_context(Robot(kind, mode="real", transport="twin")) for kind in ("so101", "koch")]
        for arm in arms:
            arm.send_action({"shoulder_pan": 20.0})

        for outcome in estop(by="the example"):
            print(f"{outcome.robot}: {outcome.outcome}, {outcome.safe_state}, {len(outcome.motors)} motors")

        for arm in arms:
            print(arm.send_action({"shoulder_pan": 0.0})["content"][0]["text"])
        for arm in arms:
            resume(arm.name)
            print(f"{arm.name}, after a resume: {arm.send_action({'shoulder_pan': 0.0})['status']}")


if __name__ == "__main__":
    main()
