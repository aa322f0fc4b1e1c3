"""Refusals of the Franka driver: its own codes, and one function for each text."""

from __future__ import annotations

from collections.abc import Mapping

from strands_actors.kernel.messages import Refused
from strands_actors.kernel.refusals import Code, RefusalCode

from .protocol import RobotMode, mode_name


class FrankaCode(RefusalCode):
    """See ``docs/refusals.md``."""

    MOTION_ENDED = "motion_ended", "the controller ended the motion", "resume()"
    SUCCESS_RATE = (
        "success_rate",
        "too few commands reach the controller in time",
        "see what else the computer and the network do",
    )
    NOT_ALL_JOINTS = "not_all_joints", "an arm is moved by all its joints", "name all of them"
    NOT_HOMED = "not_homed", "the hand could not measure its stroke", "look for an object between the fingers"
    NOT_RECOVERED = (
        "not_recovered",
        "the controller refuses to recover",
        "release the stop button, or clear the error in Desk",
    )


_MODE_REMEDIES: Mapping[int, str] = {
    RobotMode.REFLEX: "recover() first",
    RobotMode.USER_STOPPED: "release the stop button",
    RobotMode.GUIDING: "let go of the guiding button",
    RobotMode.RECOVERY: "wait until it has recovered",
}


# -- states of the controller


def wrong_mode(mode: int, errors: str) -> Refused:
    name = mode_name(mode)
    suffix = f" ({errors})" if errors else ""
    remedy = _MODE_REMEDIES.get(mode, "unlock the joints and activate FCI in Desk")
    return Refused(Code.ROBOT_MODE, f"arm is in {name}{suffix}", remedy, name, "idle or move")


def motion_ended(reason: str) -> Refused:
    return Refused(FrankaCode.MOTION_ENDED, f"the controller ended the motion ({reason})", "call resume()", reason)


# -- new targets


def not_all_joints(missing: str, named: str, keys: str, joints: int) -> Refused:
    reason = f"the arm is moved by all its joints; {missing} missing"
    return Refused(FrankaCode.NOT_ALL_JOINTS, reason, f"send {keys}", named, f"{joints} joints")


def low_success_rate(rate: float, least: float) -> Refused:
    return Refused(
        FrankaCode.SUCCESS_RATE,
        f"{rate:.0%} of the commands reach the controller in time",
        "wait for the end of the motion, then reduce the load on this computer and its network",
        f"{rate:.2f}",
        f"at least {least:g}",
    )


def no_force(key: str, opening: object) -> Refused:
    """Return the refusal of a force for a motion to an opening. Only a closing to 0 % is a grasp."""
    return Refused(
        Code.UNKNOWN_KEY,
        f"a motion to {opening} % has no setting for {key}",
        f"leave {key} out, or close the hand to 0 %, which grasps with a force",
        key,
    )


# -- services


def not_homed(status: str) -> Refused:
    return Refused(
        FrankaCode.NOT_HOMED,
        f"the hand has not measured its stroke ({status})",
        "look for an object between its fingers, then try again",
    )


def not_recovered(status: int) -> Refused:
    return Refused(
        FrankaCode.NOT_RECOVERED,
        f"the controller refuses to recover (status {status})",
        "release the arm's stop button, or clear the error in Desk",
    )
