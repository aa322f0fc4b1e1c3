"""The sessions of callers on other hosts. A session records that its caller has read the robot's clock, and which
leases it holds. No clock, no I/O."""

from __future__ import annotations

import secrets

import msgspec

from strands_actors.kernel.clock import NS
from strands_actors.kernel.messages import Refused
from strands_actors.supervisors.gate.lease import refuse_by_deadline

from . import refusals

CLOCK_TTL_S = 30.0
"""How long a reading of the clock is valid, in seconds. Two clocks drift apart by at most 0.1 ms per second."""

_MAX_SESSIONS = 64
_MAX_LEASES = 8
"""Leases kept for each session. Two are in use: the session's own and that of a rollout under it.
Earlier ones are no longer valid."""


class MeshSession(msgspec.Struct):
    owner: str  # name of the caller that owns the session, from the key of its queries
    expires_ns: int  # when the caller must have read the robot's clock again
    leases: list[int] = []  # numbers of the leases that were acquired in this session


class Sessions:
    """All sessions by name. The name is secret: only the caller that owns a session knows it, and only that caller
    may use it."""

    def __init__(self) -> None:
        self._sessions: dict[str, MeshSession] = {}

    def sync(self, name: str, owner: str, now_ns: int) -> str:
        """Start or renew the session of the caller ``owner``, which has just read the clock. Return the session's
        name. A new session begins if ``name`` is not a valid session of this caller."""
        session = self._sessions.get(name)
        if session is None or session.owner != owner or session.expires_ns <= now_ns:
            name, session = secrets.token_hex(16), MeshSession(owner, 0)
        self._sessions.pop(name, None)
        if len(self._sessions) >= _MAX_SESSIONS:
            del self._sessions[next(iter(self._sessions))]
        session.expires_ns = now_ns + round(CLOCK_TTL_S * NS)
        self._sessions[name] = session
        return name

    def refuse(self, name: str, owner: str, deadline_ns: int, now_ns: int) -> Refused | None:
        """Return a refusal for a command without a valid session of the caller ``owner``, or with a deadline
        that has passed or is too far ahead. Both times are of the robot's clock."""
        session = self._sessions.get(name)
        if session is None or session.owner != owner or session.expires_ns <= now_ns:
            return refusals.no_session(CLOCK_TTL_S)
        return refuse_by_deadline(deadline_ns, now_ns)

    def refuse_lease(self, name: str, lease: int) -> Refused | None:
        """Return a refusal if the lease was not acquired in this session; otherwise None."""
        session = self._sessions.get(name)
        if session is None or lease not in session.leases:
            return refusals.no_lease_in_session()
        return None

    def grant(self, name: str, lease: int) -> None:
        """Note that a session has acquired a lease."""
        session = self._sessions.get(name)
        if session is not None:
            session.leases = [*session.leases[1 - _MAX_LEASES :], lease]
