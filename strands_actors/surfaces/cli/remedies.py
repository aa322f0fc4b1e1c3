"""Remedies of refusals that a user of the command line can follow.

The remedy of a refusal names a method of the robot's handle, such as ``resume()``. A command has options instead,
so it shows another remedy for some codes of refusals.
"""

from __future__ import annotations

from collections.abc import Mapping

import msgspec

from strands_actors.kernel.messages import Refused
from strands_actors.kernel.refusals import Code

_AGAIN = "give the command again"
_CHECK_LINK = "check the robot's cable and power"


def of_motion(robot: str, resumed: bool) -> Mapping[str, str]:
    """Return the remedies, by code, of a command that moves a running robot and has the option ``--resume``.

    Args:
        robot: The robot's name.
        resumed: True if ``--resume`` was given.
    """
    resume = _AGAIN if resumed else "give --resume, which energises the robot first"
    return {
        Code.DISARMED: resume,
        Code.NOT_ARMED: resume,
        Code.HOLDING: resume,
        Code.FAULTED: f"clear the fault, then {resume}",
        Code.LOCKED_OUT: f"`strands-actors resume {robot}` lifts the lockout",
        Code.STOPPED: _AGAIN,
        Code.STALE_EPOCH: _AGAIN,
        Code.LEASE: "let the program that has it call release(), or end that program",
        Code.NOT_CONNECTED: _CHECK_LINK,
    }


OF_RESUME: Mapping[str, str] = {
    Code.STOPPED: f"{_AGAIN} when the stop is confirmed",
    Code.BUSY: f"{_AGAIN} when the stop is confirmed",
    Code.UNCONFIRMED: f"check the robot, then {_AGAIN}",
    Code.NOT_CONNECTED: _CHECK_LINK,
}
"""The remedies, by code, of the command ``resume``."""


def with_remedy(refusal: Refused, remedies: Mapping[str, str]) -> Refused:
    """Return the refusal with the remedy of its code. Refusals with other codes are unchanged."""
    return msgspec.structs.replace(refusal, remedy=remedies.get(refusal.code, refusal.remedy))
