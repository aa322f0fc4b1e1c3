"""Refusals that only the Spot driver uses: the codes, and one function for each text."""

from __future__ import annotations

from collections.abc import Sequence

from strands_actors.kernel.messages import Refused
from strands_actors.kernel.refusals import Code, RefusalCode


class SpotCode(RefusalCode):
    """See ``docs/refusals.md``."""

    LEASE_LOST = (
        "lease_lost",
        "another client has the body's lease",
        "let its owner return the lease, then resume()",
    )
    ESTOP_LOST = (
        "estop_lost",
        "our e-stop endpoint is no longer in force",
        "call resume(), which sets up the e-stop again",
    )
    ESTOPPED = "estopped", "the robot is E-stopped", "release the e-stop"
    NO_ARM = "no_arm", "the robot has no arm, or no claw", "move the robot's base"
    READ_ONLY = "read_only", "only the robot's own controller moves legs", "move the robot's base"
    NOT_STANDING = "not_standing", "the robot does not stand", "check the robot"
    NO_POWER = "no_power", "the motors are not powered on", "check the robot"


# -- the state of the robot


def lease_lost(loss: str) -> Refused:
    return Refused(SpotCode.LEASE_LOST, loss, "let its owner return the lease, then call resume()", loss)


def estop_lost(loss: str) -> Refused:
    return Refused(SpotCode.ESTOP_LOST, loss, "call resume(), which sets up the e-stop again", loss)


def estopped() -> Refused:
    return Refused(SpotCode.ESTOPPED, "the robot is E-stopped", "release it first", "E-stopped")


def motors_off(state: str) -> Refused:
    return Refused(Code.MOTORS_OFF, f"its motors are {state}", "call stand() first", state, "on")


# -- actions


def incomplete_arm(joints: Sequence[str]) -> Refused:
    """Return the refusal to move the arm because these joints have no target."""
    shown = ", ".join(joints)
    return Refused(
        Code.STALE,
        f"{shown} had no position when the robot was armed, and all arm joints are commanded together",
        f"give {shown}, too, or call stop() and resume() once its position is reported",
        shown,
        "all joints of the arm",
    )


def no_part(part: str, key: str, present_keys: Sequence[str]) -> Refused:
    keys = ", ".join(present_keys)
    return Refused(SpotCode.NO_ARM, f"this robot has no {part}", f"use {keys}", key, keys)


def read_only_leg(key: str, base_keys: Sequence[str], all_keys: Sequence[str]) -> Refused:
    reason = f"{key}: legs belong to the locomotion controller"
    return Refused(SpotCode.READ_ONLY, reason, f"walk with {', '.join(base_keys)}", key, ", ".join(all_keys))


# -- services


def lease_lost_in_service(loss: str) -> Refused:
    return Refused(SpotCode.LEASE_LOST, loss, "let its owner return the lease, then resume()")


def rejected_command(status: str) -> Refused:
    return Refused(Code.ROBOT, f"the robot refuses the command: {status}", "check the robot", status)


def not_standing(after_s: float) -> Refused:
    return Refused(SpotCode.NOT_STANDING, f"the robot does not stand after {after_s:g} s", "check the robot")


def no_power(state: str) -> Refused:
    return Refused(SpotCode.NO_POWER, f"the motors are not powered on: {state}", "check the robot", state)
