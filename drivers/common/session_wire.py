"""A wire of which everything that exists between ``open`` and ``close`` is one object, its session."""

from __future__ import annotations

from typing import Generic, TypeVar

from strands_actors.contract.wire import Wire, WireDown

SessionT = TypeVar("SessionT")


class SessionWire(Wire, Generic[SessionT]):
    session_or_none: SessionT | None = None
    """None: not open."""

    @property
    def session(self) -> SessionT:
        """Raise ``WireDown`` when the wire is not open."""
        if self.session_or_none is None:
            raise WireDown("wire: not connected. Open it first")
        return self.session_or_none


class PromptSessionWire(SessionWire[SessionT]):
    """Of datagrams: while it is open, ``read`` takes what has arrived and ``write`` waits for nothing."""

    @property
    def prompt(self) -> bool:
        return self.session_or_none is not None
