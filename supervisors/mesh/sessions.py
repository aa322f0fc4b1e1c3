"""Who commands a robot from other hosts: who has read its clock, and whose leases are whose. No
clock, no I/O."""

from __future__ import annotations

import secrets

import msgspec

from strands_actors.kernel.clock import NS
from strands_actors.kernel.messages import Refused
from strands_actors.kernel.refusals import Code
from strands_actors.supervisors.gate.lease import refuse_by_deadline

CLOCK_TTL_S = 30.0
"""A clock that was read is good for this long: two quartzes drift apart by 0.1 ms a second at
worst."""

_MAX_SESSIONS = 64
_MAX_LEASES = 8
"""Kept of each session: its own, and that of a rollout under it; those before are no longer
good."""


class MeshSession(msgspec.Struct):
    who: str
    expires_ns: int
    leases: list[int] = []


class Sessions:
    """By a name that is told to its owner alone, and counts for that owner alone."""

    def __init__(self) -> None:
        self._sessions: dict[str, MeshSession] = {}

    def sync(self, name: str, who: str, now_ns: int) -> str:
        """``who`` has just read the clock, in the session ``name`` if that is one of its own. Its name."""
        session = self._sessions.get(name)
        if session is None or session.who != who or session.expires_ns <= now_ns:
            name, session = secrets.token_hex(16), MeshSession(who, 0)
        self._sessions.pop(name, None)
        if len(self._sessions) >= _MAX_SESSIONS:
            del self._sessions[next(iter(self._sessions))]
        session.expires_ns = now_ns + round(CLOCK_TTL_S * NS)
        self._sessions[name] = session
        return name

    def refuse(self, name: str, who: str, deadline_ns: int, now_ns: int) -> Refused | None:
        """None when it is dated by our clock, in a session of ``who`` asks, and its time has neither passed
        nor is far away."""
        session = self._sessions.get(name)
        if session is None or session.who != who or session.expires_ns <= now_ns:
            why = f"you have not read this robot's clock in the last {CLOCK_TTL_S:g} s"
            return Refused(Code.CLOCK, why, "send Sync first")
        return refuse_by_deadline(deadline_ns, now_ns)

    def refuse_lease(self, name: str, lease: int) -> Refused | None:
        session = self._sessions.get(name)
        if session is None or lease not in session.leases:
            return Refused(Code.LEASE, "you hold no lease of that number", "acquire it first")
        return None

    def grant(self, name: str, lease: int) -> None:
        session = self._sessions.get(name)
        if session is not None:
            session.leases = [*session.leases[1 - _MAX_LEASES :], lease]
