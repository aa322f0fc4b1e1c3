"""The sessions of the simulated base."""

from __future__ import annotations

import enum
from collections.abc import Callable

from strands_actors.drivers.kinova.protocol import Frame, Login, SubError

from .errors import ProtocolFailed
from .users import Users


class Second(enum.StrEnum):
    """How the simulated base reacts to a second session. The reaction of a real base is unknown."""

    ACCEPTED = "accepted"
    REFUSED = "refused"
    POWERLESS = "powerless"  # The session is accepted, but it may only read.


class BaseSession:
    """One client's session with the simulated base (the arm's controller). The base accepts its calls only on the
    connection that opened the session."""

    def __init__(self, number: int, connection: object, login: Login, now_s: float) -> None:
        self.number = number
        self.connection = connection
        self.lifetime_s = min(login.session_ms, login.connection_ms) / 1e3
        self.last_request_s = now_s


class Sessions:
    def __init__(
        self, users: Users, second: Second, now_s: Callable[[], float], ended: Callable[[int], None]
    ) -> None:
        """Args:
        users: The users of the base.
        second: The reaction to a second session.
        now_s: Returns the present time.
        ended: Called with the number of a session that has ended.
        """
        self.open: dict[int, BaseSession] = {}
        self._users = users
        self._second = second
        self._now_s = now_s
        self._ended = ended
        self._number = 0

    def create(self, connection: object, login: Login) -> int:
        """Open a session, and return its number. Raise ``ProtocolFailed``."""
        self._users.check(login)
        self._forget_silent()
        if self.open and self._second is Second.REFUSED:
            raise ProtocolFailed(SubError.METHOD_FAILED)
        self._number = self._number % 0xFFFF + 1
        self.open[self._number] = BaseSession(self._number, connection, login, self._now_s())
        return self._number

    def of(self, connection: object, request: Frame) -> BaseSession:
        """Return the session of a request. Raise ``ProtocolFailed`` without one."""
        self._forget_silent()
        session = self.open.get(request.session)
        if session is None or session.connection is not connection:
            raise ProtocolFailed(SubError.INVALID_SESSION)
        session.last_request_s = self._now_s()
        return session

    def close(self, number: int) -> None:
        if self.open.pop(number, None) is not None:
            self._ended(number)

    def may_command(self, session: BaseSession) -> bool:
        """Return False for a session that may only read."""
        return self._second is not Second.POWERLESS or min(self.open) == session.number

    def _forget_silent(self) -> None:
        now_s = self._now_s()
        for number, session in list(self.open.items()):
            if now_s - session.last_request_s > session.lifetime_s:
                self.close(number)
