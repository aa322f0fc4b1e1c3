"""Stop a fleet: two arms on their twins, one e-stop, a report on each: python examples/estop.py"""

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
        resume("so101")
        print(f"after a resume: {arms[0].send_action({'shoulder_pan': 0.0})['status']}")


if __name__ == "__main__":
    main()
