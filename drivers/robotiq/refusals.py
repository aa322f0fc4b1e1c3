"""Refusals of the Robotiq driver: its own codes, and one function for each text."""

from __future__ import annotations

from collections.abc import Sequence

from strands_actors.kernel.messages import Refused
from strands_actors.kernel.refusals import Code, RefusalCode

from .protocol import MAJOR, OVER_TEMPERATURE, RELEASING, Activation, fault_words


class RobotiqCode(RefusalCode):
    """See ``docs/refusals.md``."""

    NOT_ACTIVATED = "not_activated", "the gripper is not activated", "resume()"


# -- keys of an action


def unknown_key(key: str, robot: str, keys: str) -> Refused:
    return Refused(Code.UNKNOWN_JOINT, f"{key} is not a key of {robot}", f"use {keys}", key, keys)


def several_positions(given: Sequence[str], position_keys: str) -> Refused:
    both = " and ".join(given)
    reason = f"{both} are both given"
    return Refused(Code.BOTH_SPELLINGS, reason, "send only one of these keys", both, position_keys)


def no_position(given: str, position_keys: str) -> Refused:
    remedy = f"use one of {position_keys}"
    return Refused(Code.EMPTY, "the action has no position", remedy, given, position_keys)


# -- times of a motion


def speed_and_seconds() -> Refused:
    remedy = "leave speed out, because seconds determines it"
    return Refused(Code.BOTH, "speed and seconds are both given", remedy, "speed", "seconds")


def too_fast(distance_mm: float, time_s: float, least_s: float) -> Refused:
    reason = f"the fingers cannot move {distance_mm:.1f} mm within {time_s:g} s"
    return Refused(Code.TOO_FAST, reason, f"give seconds={least_s:g} or more", f"{time_s:g}", f"{least_s:g}")


# -- states of the gripper


def not_activated(activation: int) -> Refused:
    return Refused(
        RobotiqCode.NOT_ACTIVATED,
        f"the gripper is not activated (gSTA {activation})",
        "call stop(), then resume(), which moves the fingers through their whole stroke to activate the gripper",
        str(activation),
        str(int(Activation.ACTIVE)),
    )


def fault(number: int) -> Refused:
    return Refused(
        Code.FAULT, f"the gripper reports {fault_words(number)}", _fault_remedy(number), str(number), "0"
    )


def _fault_remedy(number: int) -> str:
    if number == RELEASING:
        return "wait until the release has ended, then call stop() and resume()"
    if number == OVER_TEMPERATURE:
        return "let the gripper cool"
    if number >= MAJOR:
        return "remove the cause, then call stop() and resume(), which moves the fingers through their whole stroke"
    return "call stop(), then resume()"
