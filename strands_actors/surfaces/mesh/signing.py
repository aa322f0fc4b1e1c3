"""Derive the origin of an order and the time to wait for its answers from any argument.

A wrong argument must not keep a robot from being stopped.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path

from strands_actors.contract.shown import harmless
from strands_actors.supervisors.mesh.schemas import ESTOP_ANSWER_S, MAX_TEXT


def signed(by: object) -> str:
    """Return the origin of an order as a text that can be sent and is no longer than a robot accepts.

    Args:
        by: The origin. Empty or None stands for this program.
    """
    try:
        text = "" if by is None else str(by)
    except Exception:  # An object may fail to give its text.
        text = type(by).__name__
    return harmless(text)[:MAX_TEXT] or program()


def program() -> str:
    """Return a readable name of this program. A name of numbers alone would look like one of the robot's
    own processes."""
    script = Path(sys.argv[0] if sys.argv else "")
    name = script.parent.name if script.name == "__main__.py" else script.name
    if name in ("", "-", "-c", "-m"):
        name = "python"
    return harmless(f"a program ({name[:64]}, process {os.getpid()})")


def patience_s(within_s: object) -> float:
    """Return how long to wait for the results of an e-stop.

    It is at least the time in which every robot has received the order: a session that is closed earlier
    loses it.

    Args:
        within_s: The requested time. A value that is not a number counts as 0.
    """
    try:
        requested_s = float(within_s)  # type: ignore[arg-type]  # whatever it is
    except (TypeError, ValueError, OverflowError):
        return ESTOP_ANSWER_S
    return max(ESTOP_ANSWER_S, requested_s)  # This order returns the first argument for NaN.
