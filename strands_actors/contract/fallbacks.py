"""Check a driver's tables, which give the safe state for each reason of a stop and for each condition.

A condition must be true while the robot is commanded.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

import msgspec

from .driver import HOLDING_REASONS, Condition, Reason
from .safe_state import SafeState


def fallbacks_for(*, late: SafeState, otherwise: SafeState) -> dict[Reason, SafeState]:
    """Return the table of safe states that most drivers use.

    Args:
        late: The safe state if the program that commands is late, or has ended.
        otherwise: The safe state for every other reason.
    """
    return {reason: late if reason in HOLDING_REASONS else otherwise for reason in Reason}


def check_fallbacks(robot: str, fallbacks: Mapping[Reason, str]) -> dict[Reason, SafeState]:
    """Return a driver's safe state for each reason of a stop, with ``SafeState`` members in place of text.

    Raises:
        ValueError: A reason is missing, or a text is not the name of a safe state. The message names it.
    """
    if missing := [str(reason) for reason in Reason if reason not in fallbacks]:
        raise ValueError(f"{robot}: no safe state is declared for {', '.join(missing)}")
    _check_words(robot, fallbacks.values())
    return {reason: SafeState(state) for reason, state in fallbacks.items()}


def check_conditions(robot: str, conditions: Sequence[Condition]) -> tuple[Condition, ...]:
    """Return a driver's conditions, with ``SafeState`` members in place of text.

    A condition must be true while the robot is commanded.

    Raises:
        ValueError: A text is not the name of a safe state. The message names it.
    """
    _check_words(robot, (condition.safe_state for condition in conditions if condition.safe_state))
    return tuple(
        msgspec.structs.replace(
            condition, safe_state=SafeState(condition.safe_state) if condition.safe_state else None
        )
        for condition in conditions
    )


def _check_words(robot: str, states: Iterable[str]) -> None:
    accepted = [str(state) for state in SafeState]
    if wrong := sorted({str(state) for state in states if str(state) not in accepted}):
        raise ValueError(f"{robot}: {', '.join(wrong)} is no safe state. Use one of {', '.join(accepted)}")
