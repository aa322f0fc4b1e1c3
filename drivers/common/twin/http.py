"""Simulate a robot behind an HTTP service, without a web framework. Faults can damage or delay its responses."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import NamedTuple, Protocol

from strands_actors.drivers.common.codecs.http_messages import Request, ServerEnd, encode_response
from strands_actors.drivers.common.codecs.malformed import MalformedFrame

from .faults import Fault, Faults, Reply
from .server import Exchange
from .tcp import ClientGone, Handler, answering

MAX_REQUEST = 4 << 20
"""Largest body in bytes. Speech is uploaded as a WAV file."""


class Answer(NamedTuple):
    """A response of the simulated service. For the log, ``kind`` is the kind of the request, and ``safe_state``
    the safe state to which the request alone brings the robot; None if that is unknown."""

    status: int
    body: bytes
    kind: str = "read"
    safe_state: str | None = None


class Service(Protocol):
    """A simulated HTTP service. One object serves all clients."""

    faults: Faults

    def answer(self, request: Request) -> Answer:
        """Carry out a request, and return the response. Not called while the robot has no power (``Fault.OFF``)."""
        ...


class HttpSession:
    """The HTTP session of one client."""

    def __init__(self, service: Service) -> None:
        self._service = service
        self._end = ServerEnd(MAX_REQUEST)

    def receive(self, data: bytes, bits_per_s: int | None) -> Iterator[Exchange]:
        try:
            for request in self._end.feed(data):
                yield self._exchange(request)
        except MalformedFrame:
            # A real server also disconnects a client that sends a malformed request.
            raise ClientGone from None

    def _exchange(self, request: Request) -> Exchange:
        service = self._service
        if service.faults.of(None) is Fault.OFF:
            return Exchange("other", request.raw, ())
        answer = service.answer(request)
        reply = service.faults.apply(Reply(0.0, encode_response(answer.status, answer.body)))
        return Exchange(answer.kind, request.raw, () if reply is None else (reply,), answer.safe_state)


def serving(service: Service) -> Handler:
    """Return the handler for the port of an HTTP service."""
    new_session: Callable[[], HttpSession] = lambda: HttpSession(service)  # noqa: E731
    return answering(new_session)
