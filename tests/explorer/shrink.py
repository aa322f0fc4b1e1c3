"""Makes a failing plan shorter: what can be left out while it still fails in the same way is left
out."""

from __future__ import annotations

from collections.abc import Iterator

import msgspec

from .plan import Plan
from .search import run_apart


def fails(plan: Plan, invariant: str) -> bool:
    (result,) = run_apart([plan])
    return any(violation.invariant == invariant for violation in result.violations)


def shrink(plan: Plan, invariant: str) -> Plan:
    """Return the shortest plan that was found which breaks the same invariant."""
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
