"""What an order says of who gives it, and how long its answers are waited for, whatever a program
has given for either: a slip there keeps no robot from being stopped."""

from __future__ import annotations

import os
import sys
from pathlib import Path

from strands_actors.contract.shown import harmless
from strands_actors.supervisors.mesh.schemas import ESTOP_ANSWER_S, MAX_TEXT


def signed(by: object) -> str:
    """Return who orders, as a robot reads it: text that can be sent, and no longer than it takes.
    Empty or None: this program."""
    try:
        text = "" if by is None else str(by)
    except Exception:  # an object that cannot even say what it is
        text = type(by).__name__
    return harmless(text)[:MAX_TEXT] or program()


def program() -> str:
    """Return what people know this program by: a name made of numbers reads like one of the robot's
    own processes."""
    script = Path(sys.argv[0] if sys.argv else "")
    name = script.parent.name if script.name == "__main__.py" else script.name
    if name in ("", "-", "-c", "-m"):
        name = "python"
    return harmless(f"a program ({name[:64]}, process {os.getpid()})")


def patience_s(within_s: object) -> float:
    """Return how long an e-stop is waited for. Never less than it may take until it is known that
    every robot has heard: a session that is closed before takes the order with it. What is no
    number counts as nothing."""
    try:
        wanted_s = float(within_s)  # type: ignore[arg-type]  # whatever it is
    except (TypeError, ValueError, OverflowError):
        return ESTOP_ANSWER_S
    return max(ESTOP_ANSWER_S, wanted_s)  # in this order: not a number is not greater
