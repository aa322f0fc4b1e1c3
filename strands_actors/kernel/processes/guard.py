"""What only an operator may let others do: the part of the operator gate that every process can decide.

``Driver.GUARDED`` names verbs, and keys of an action. The environment allows some without asking; whoever can ask a
person (``agents/approval.py``) asks for the rest; whoever cannot refuses.
"""

from __future__ import annotations

import os
from collections.abc import Collection, Iterable

from strands_actors.kernel.messages import Refused

ALLOW = "STRANDS_ACTORS_ALLOW"
"""Environment: guarded names that are allowed without asking, separated by commas."""


def allowed() -> frozenset[str]:
    return frozenset(name for part in os.environ.get(ALLOW, "").split(",") if (name := part.strip()))


def unapproved(guarded: Collection[str], names: Iterable[str]) -> tuple[str, ...]:
    """Those of ``names`` that somebody has to approve, sorted. A key is the same with ``.pos`` behind it."""
    plain = (str(name).removesuffix(".pos") for name in names)
    return tuple(sorted(frozenset(guarded).intersection(plain) - allowed()))


def not_approved(verb: str, names: Iterable[str], why: str) -> Refused:
    shown = ", ".join(names)
    reason = f"{verb}: {shown} needs an operator's approval: {why}"
    return Refused("not_approved", reason, f"pass approve= to the robot, or name it in {ALLOW}", shown, ALLOW)
