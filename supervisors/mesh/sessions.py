"""The sessions of callers on other hosts: which caller has read the robot's clock, and which leases it
holds. No clock, no I/O."""

from __future__ import annotations

import secrets

import msgspec

from strands_actors.kernel.clock import NS
from strands_actors.kernel.messages import Refused
from strands_actors.kernel.refusals import Code
from strands_actors.supervisors.gate.lease import refuse_by_deadline

CLOCK_TTL_S = 30.0
"""How long a reading of the clock is valid. Two quartzes drift apart by 0.1 ms a second at worst."""

_MAX_SESSIONS = 64
_MAX_LEASES = 8
"""Leases kept for each session. Two are in use: the session's own and that of a rollout under it.
Earlier ones are no longer valid."""


class MeshSession(msgspec.Struct):
    who: str  # the caller that owns it, by the key on which it asks
    expires_ns: int  # when its reading of the clock expires
    leases: list[int] = []  # acquired in this session


class Sessions:
    """All sessions, by name. Only the owner of a session learns its name, and only the owner may use it."""

    def __init__(self) -> None:
        self._sessions: dict[str, MeshSession] = {}

    def sync(self, name: str, who: str, now_ns: int) -> str:
        """Start or renew the session of the caller ``who``, which has just read the clock. Return its name.
        A new session begins if ``name`` is not a valid session of this caller."""
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
        """Return a refusal for a command without a valid session, or with a deadline that has passed or
        lies too far ahead. The caller ``who`` must own the session. Both times are of the robot's clock."""
        session = self._sessions.get(name)
        if session is None or session.who != who or session.expires_ns <= now_ns:
            why = f"you have not read this robot's clock in the last {CLOCK_TTL_S:g} s"
            return Refused(Code.CLOCK, why, "send Sync first")
        return refuse_by_deadline(deadline_ns, now_ns)

    def refuse_lease(self, name: str, lease: int) -> Refused | None:
        """Return a refusal for a lease that was not acquired in this session."""
        session = self._sessions.get(name)
        if session is None or lease not in session.leases:
            return Refused(Code.LEASE, "you hold no lease of that number", "acquire it first")
        return None

    def grant(self, name: str, lease: int) -> None:
        """Note that a session has acquired a lease."""
        session = self._sessions.get(name)
        if session is not None:
            session.leases = [*session.leases[1 - _MAX_LEASES :], lease]
