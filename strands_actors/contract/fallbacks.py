"""Check the table of a driver that maps reasons and conditions to safe states."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

import msgspec

from .driver import HOLDING_REASONS, Condition, Reason
from .safe_state import SafeState


def fallbacks_for(*, late: SafeState, otherwise: SafeState) -> dict[Reason, SafeState]:
    """Return the usual table.

    Args:
        late: The safe state when the writer is late or lost.
        otherwise: The safe state for every other reason.
    """
    return {reason: late if reason in HOLDING_REASONS else otherwise for reason in Reason}


def check_fallbacks(robot: str, fallbacks: Mapping[Reason, str]) -> dict[Reason, SafeState]:
    """Return a table with its words as safe states.

    Raises:
        ValueError: A reason is missing, or a word is no safe state. The text names it.
    """
    if missing := [str(reason) for reason in Reason if reason not in fallbacks]:
        raise ValueError(f"{robot}: no safe state is declared for {', '.join(missing)}")
    _check_words(robot, fallbacks.values())
    return {reason: SafeState(state) for reason, state in fallbacks.items()}


def check_conditions(robot: str, conditions: Sequence[Condition]) -> tuple[Condition, ...]:
    """Return conditions with their words as safe states.

    Raises:
        ValueError: A word is no safe state. The text names it.
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
