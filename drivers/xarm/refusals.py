"""Refusals of the xArm driver: its own codes, and one function for each text."""

from __future__ import annotations

from strands_actors.kernel.messages import Refused
from strands_actors.kernel.refusals import Code, RefusalCode

from .protocol import State, error_words


class XArmCode(RefusalCode):
    """See ``docs/refusals.md``."""

    ERROR = "error", "the controller holds an error", "clear it at the arm, then resume()"
    STATE = "state", "the arm is paused or stopped", "resume()"


_AGAIN = "remove the cause, then call resume()"


def controller_error(error: int | None) -> Refused:
    words = "an unknown error" if error is None else f"error {error_words(error)}"
    remedy = "clear the error at the arm, then call resume()"
    return Refused(XArmCode.ERROR, f"the controller reports {words}", remedy, words, "no error")


def not_running(state: int | None) -> Refused:
    word = "paused" if state == State.PAUSED else "stopped" if state == State.STOPPED else "not ready"
    return Refused(XArmCode.STATE, f"the arm is {word} (state {state})", _AGAIN, f"{state}", "1 or 2")


def wrong_mode(mode: int | None) -> Refused:
    return Refused(Code.MODE, f"the arm is in mode {mode}, not in servo mode (1)", _AGAIN, f"{mode}", "1")
