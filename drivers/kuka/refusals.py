"""Refusal codes (the reasons for refusing a command) that only the KUKA driver uses."""

from __future__ import annotations

from strands_actors.kernel.refusals import RefusalCode


class KukaCode(RefusalCode):
    """See ``docs/refusals.md``."""

    DRIVES = "drives", "a drive is not active", "look at the pendant"
    SAFETY = "safety", "the robot is in a safety stop", "clear it on the pendant"
    OVERLAY = "overlay", "the controller has ended the FRI overlay", "start the robot program's motion again"
    QUALITY = "quality", "the FRI connection is poor", "check the network"
    FRI_STATE = "fri_state", "the FRI session takes no commands", "start the motion on the pendant"
    CONTROL_MODE = (
        "control_mode",
        "the arm is not in position control",
        "use PositionControlMode in the robot program",
    )
    CLIENT_MODE = (
        "client_mode",
        "the robot program does not let us command positions",
        "use ClientCommandMode.POSITION there",
    )
