"""A wire that keeps everything between ``open`` and ``close`` in one object, its session."""

from __future__ import annotations

from typing import Generic, TypeVar

from strands_actors.contract.wire import Wire, WireDown

SessionT = TypeVar("SessionT")


class SessionWire(Wire, Generic[SessionT]):
    """A ``Wire`` with a session. A subclass sets ``session_or_none`` in ``open`` and clears it in
    ``close``."""

    session_or_none: SessionT | None = None
    """The session; None if the wire is not open."""

    @property
    def session(self) -> SessionT:
        """The session. Raises ``WireDown`` if the wire is not open."""
        if self.session_or_none is None:
            raise WireDown("wire: not connected. Open it first")
        return self.session_or_none


class PromptSessionWire(SessionWire[SessionT]):
    """A session of datagrams. While it is open, ``read`` takes waiting datagrams and ``write`` never
    waits."""

    @property
    def prompt(self) -> bool:
        return self.session_or_none is not None
