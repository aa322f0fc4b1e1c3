"""Shorten a failing plan: leave out every event without which it still fails in the same way."""

from __future__ import annotations

from collections.abc import Iterator

import msgspec

from .plan import Plan
from .search import run_apart


def fails(plan: Plan, invariant: str) -> bool:
    (result,) = run_apart([plan])
    return any(violation.invariant == invariant for violation in result.violations)


def shrink(plan: Plan, invariant: str) -> Plan:
    """Return a plan that breaks the same invariant, and from which no single event can be removed."""
    while True:
        shorter = next((each for each in _shorter(plan) if fails(each, invariant)), None)
        if shorter is None:
            return plan
        plan = shorter


def _shorter(plan: Plan) -> Iterator[Plan]:
    if plan.style != "rest":
        yield msgspec.structs.replace(plan, style="rest")
    for at in range(len(plan.events)):
        yield msgspec.structs.replace(plan, events=plan.events[:at] + plan.events[at + 1 :])
