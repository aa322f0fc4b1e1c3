"""Make usable values of the arguments of a stop: its origin, and the time to wait for answers.

A wrong argument must not prevent a stop.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path

from strands_actors.contract.shown import harmless
from strands_actors.supervisors.mesh.schemas import ESTOP_ANSWER_S, MAX_TEXT


def signed(by: object) -> str:
    """Return the origin of a stop as a text that a robot accepts.

    Args:
        by: The origin of the stop. Empty or None stands for this program.
    """
    try:
        text = "" if by is None else str(by)
    except Exception:  # The ``__str__`` of an object may raise anything.
        text = type(by).__name__
    return harmless(text)[:MAX_TEXT] or program()


def program() -> str:
    """Return a name of this program that a person can read, for example "a program (pick.py, process 12)"."""
    script = Path(sys.argv[0] if sys.argv else "")
    name = script.parent.name if script.name == "__main__.py" else script.name
    if name in ("", "-", "-c", "-m"):
        name = "python"
    return harmless(f"a program ({name[:64]}, process {os.getpid()})")


def patience_s(within_s: object) -> float:
    """Return how long to wait for the results of an e-stop.

    The time is at least ``ESTOP_ANSWER_S``, in which every robot receives the stop. If a session were closed
    earlier, the stop could be lost.

    Args:
        within_s: The requested time. A value that is not a number counts as 0.
    """
    try:
        requested_s = float(within_s)  # type: ignore[arg-type]  # whatever it is
    except (TypeError, ValueError, OverflowError):
        return ESTOP_ANSWER_S
    return max(ESTOP_ANSWER_S, requested_s)  # ``max`` returns its first argument if the second is NaN.
