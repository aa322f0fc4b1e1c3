"""A client of JSON-RPC over one connection: what is said leaves at once or never, and each answer
is waited for with a deadline.

Nothing is queued, said again or kept for the next connection. Answers that come late belong to
nobody; a line that makes no sense is counted. A connection whose lines cannot be told apart any more
is not read from then on, but a stop can still be written to it until it is replaced or closed.
"""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Mapping
from typing import Any

import trio

from strands_actors.contract.wire import WireDown

from .json_rpc import (
    Call,
    Failure,
    LineDecoder,
    Result,
    decode,
    encode_notification,
    encode_request,
)
from .malformed import MalformedFrame
from .shared_stream import SharedStream
from .tcp_port import OrderlyStream

OpenStream = Callable[[], Awaitable[OrderlyStream]]

_GONE = object()


class SaidNo(Exception):
    """The service answered with an error."""

    def __init__(self, code: int, message: str) -> None:
        super().__init__(message)
        self.code = code


class JsonRpcPort:
    """``notice`` is called with each notification of the service, as it comes. Everything raises
    ``WireDown`` once the connection is gone."""

    def __init__(self, open_stream: OpenStream, notice: Callable[[Call], None]) -> None:
        self._open_stream = open_stream
        self._notice = notice
        self._stream = SharedStream(self._forget_all)
        self._lines = LineDecoder()
        self._number = 0
        self._waiting: dict[int, Result | Failure | None] = {}  # requests whose answer somebody wants
        self.malformed = 0

    @property
    def is_open(self) -> bool:
        return self._stream.connection is not None

    @property
    def takes_stops(self) -> bool:
        """Return whether there is a connection that a stop can be written to."""
        return self._stream.is_connected

    async def open(self) -> None:
        """Connect anew, and say nothing. One that is not understood is kept until then."""
        if self.is_open:
            self.close()
        self._stream.replace(await self._open_stream())

    def notify(self, method: str, params: Mapping[str, Any]) -> None:
        self._stream.write(encode_notification(method, params))

    def notify_stop(self, method: str, params: Mapping[str, Any]) -> None:
        """As ``notify``, on a connection that is not understood any more, too: a stop needs no
        answer."""
        self._stream.write_stop(encode_notification(method, params))

    def send_stop(self, method: str, params: Mapping[str, Any]) -> None:
        """As ``notify_stop``, of a method that is a request. Nobody waits for its answer."""
        self._number += 1
        self._stream.write_stop(encode_request(self._number, method, params))

    def send(self, method: str, params: Mapping[str, Any]) -> int:
        """Hand a request over now; return its number. Its answer is kept until ``answer`` or
        ``forget``."""
        self._number += 1
        self._stream.write(encode_request(self._number, method, params))
        self._waiting[self._number] = None
        return self._number

    def forget(self, number: int) -> None:
        self._waiting.pop(number, None)

    async def answer(self, number: int, within_s: float) -> Any:
        """Return the result of that request. Raise ``SaidNo``; ``WireDown`` when none comes in
        time: the connection stays as it is."""
        try:
            with trio.move_on_after(within_s):
                await self.until(lambda: self._waiting.get(number, _GONE) is not None)
            answer = self._waiting.get(number, _GONE)
        finally:
            self.forget(number)
        match answer:
            case Result(_, value):
                return value
            case Failure(_, code, message):
                raise SaidNo(code, message)
        if answer is _GONE:
            raise WireDown("the connection was lost before the answer. Reconnect")
        raise WireDown(f"no answer within {within_s * 1e3:.0f} ms. Check that the service is alive")

    async def ask(self, method: str, params: Mapping[str, Any], within_s: float) -> Any:
        return await self.answer(self.send(method, params), within_s)

    async def hear(self) -> None:
        """Take in what comes, until the connection is lost."""
        await self.until(lambda: False)

    async def until(self, is_so: Callable[[], bool]) -> None:
        """Take in what comes, until it is so."""
        while not is_so():
            await self._hear()

    def close(self) -> None:
        """Throw the connection away. Harmless when called again."""
        self._stream.close()

    def _forget_all(self) -> None:
        self._lines = LineDecoder()
        self._waiting.clear()

    async def _hear(self) -> None:
        """Take in what comes next, or wait until somebody else did."""
        data = await self._stream.read()
        try:
            for line in self._lines.feed(data):
                self._take(line)
        except MalformedFrame as malformed:
            self._stream.deafen(str(malformed))
            raise WireDown(f"{malformed}. Check what is served there") from None

    def _take(self, line: bytes) -> None:
        try:
            message = decode(line)
        except MalformedFrame:
            self.malformed += 1
            return
        if isinstance(message, Call):
            self._notice(message)
        elif isinstance(message.id, int) and message.id in self._waiting:
            self._waiting[message.id] = message
