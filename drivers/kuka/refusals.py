"""Refusals of the KUKA driver: its own codes, and one function for each text."""

from __future__ import annotations

from strands_actors.kernel.messages import Refused
from strands_actors.kernel.refusals import Code, RefusalCode


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


def no_message(age_ms: float, limit_ms: float) -> Refused:
    age = f"{age_ms:.0f} ms"
    remedy = "check the controller, its FRI session and the network"
    return Refused(Code.STALE, f"no FRI message for {age}", remedy, age, f"{limit_ms:.0f} ms")


def safety_stop(level: int) -> Refused:
    return Refused(KukaCode.SAFETY, f"safety stop, level {level}", "clear it on the pendant", f"{level}", "0")


# -- drives


def drives_not_reported() -> Refused:
    remedy = "check the FRI version of the controller, and look at its drives on the pendant"
    return Refused(KukaCode.DRIVES, "the controller does not report its drives", remedy, "", "ACTIVE")


def drive_not_active(key: str, state: str) -> Refused:
    remedy = "switch the drives on at the pendant"
    return Refused(KukaCode.DRIVES, f"drive of {key} is {state}", remedy, state, "ACTIVE")


# -- the FRI session


def wrong_session_state(state: str, required: str) -> Refused:
    return Refused(
        KukaCode.FRI_STATE, f"FRI session is {state}", "start the motion on the pendant", state, required
    )


def wrong_client_mode(mode: str, required: str) -> Refused:
    remedy = "let the robot program command positions: ClientCommandMode.POSITION"
    return Refused(KukaCode.CLIENT_MODE, f"FRI client command mode is {mode}", remedy, mode, required)


def wrong_control_mode(mode: str, required: str) -> Refused:
    remedy = "use PositionControlMode in the robot program"
    return Refused(KukaCode.CONTROL_MODE, f"control mode is {mode}", remedy, mode, required)


def overlay_ended() -> Refused:
    remedy = "start the robot program's motion again, with the FRI overlay"
    return Refused(KukaCode.OVERLAY, "the controller has ended the FRI overlay", remedy, "NO_OVERLAY", "JOINT")


def poor_quality(quality: str) -> Refused:
    remedy = "check the network and the load of this computer, and wait until the quality is GOOD"
    return Refused(KukaCode.QUALITY, f"FRI connection quality is {quality}", remedy, quality, "GOOD")
