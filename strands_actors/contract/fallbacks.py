"""Which reason leads to which safe state: a driver's table, as a type."""

from __future__ import annotations

from collections.abc import Mapping

from .driver import Reason
from .safe_state import SafeState


def check_fallbacks(robot: str, fallbacks: Mapping[Reason, str]) -> dict[Reason, SafeState]:
    """Return the table with its words as safe states. Raise ``ValueError`` that names what is missing
    or misspelt."""
    if missing := [str(reason) for reason in Reason if reason not in fallbacks]:
        raise ValueError(f"{robot}: no safe state is declared for {', '.join(missing)}")
    known = [str(state) for state in SafeState]
    if wrong := sorted({str(state) for state in fallbacks.values() if str(state) not in known}):
        raise ValueError(f"{robot}: {', '.join(wrong)} is no safe state. Use one of {', '.join(known)}")
    return {reason: SafeState(state) for reason, state in fallbacks.items()}
