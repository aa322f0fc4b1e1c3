"""Base of the classes that talk to a robot and keep all state of one connection in one object, its session."""

from __future__ import annotations

from typing import Generic, TypeVar

from strands_actors.contract.wire import Wire, WireDown

SessionT = TypeVar("SessionT")


class SessionWire(Wire, Generic[SessionT]):
    """A ``Wire`` (the class that talks to a robot) that keeps the state of its open connection in one object, the
    session. A subclass sets ``session_or_none`` in ``open`` and clears it in ``close``."""

    session_or_none: SessionT | None = None
    """The session; None if the wire is not open."""

    @property
    def session(self) -> SessionT:
        """The session of the open connection. Raises ``WireDown`` if there is no connection."""
        if self.session_or_none is None:
            raise WireDown("wire: not connected to the robot. Open the connection first")
        return self.session_or_none


class PromptSessionWire(SessionWire[SessionT]):
    """A ``SessionWire`` over datagrams. While it is open, ``read`` takes the datagrams that have arrived, and
    ``write`` never waits."""

    @property
    def prompt(self) -> bool:
        return self.session_or_none is not None
