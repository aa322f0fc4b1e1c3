"""A client of JSON-RPC over one connection. A message is sent at once, or the call raises. Each answer has a
deadline.

No message is queued, repeated, or kept for the next connection. A late answer is dropped. A line that cannot be
decoded is counted. After a line that is too long, the start of the next line is unknown. Then nothing more is read
from the connection, but a stop can still be written to it until it is replaced or closed.
"""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Mapping
from itertools import count
from typing import Any

from strands_actors.contract.wire import WireDown

from ..codecs.json_rpc import (
    Call,
    Failure,
    LineDecoder,
    Result,
    decode,
    encode_notification,
    encode_request,
)
from ..codecs.malformed import MalformedFrame
from .exchange import Exchange
from .shared_stream import SharedStream
from .tcp_port import OrderlyStream

OpenStream = Callable[[], Awaitable[OrderlyStream]]


class RequestFailed(Exception):
    """The service has answered a request with an error."""

    def __init__(self, code: int, message: str) -> None:
        super().__init__(message)
        self.code = code


class JsonRpcPort:
    """A connection to one JSON-RPC service. Every method raises ``WireDown`` once the connection is lost.

    Args:
        open_stream: Makes a connection.
        notice: Called with each notification that the service sends.
    """

    def __init__(self, open_stream: OpenStream, notice: Callable[[Call], None]) -> None:
        self._open_stream = open_stream
        self._notice = notice
        self._stream = SharedStream(self._forget_all)
        self._lines = LineDecoder()
        self._numbers = count(1)
        # For each request its method.
        self._exchange: Exchange[int, str, Result | Failure] = Exchange()
        self.malformed = 0

    @property
    def is_open(self) -> bool:
        return self._stream.connection is not None

    @property
    def takes_stops(self) -> bool:
        """True if a stop command can be written to the connection, even if received data could not be decoded."""
        return self._stream.is_connected

    async def open(self) -> None:
        """Open a new connection, and send nothing. A connection with malformed data is kept until the new one is
        open."""
        if self.is_open:
            self.close()
        self._stream.replace(await self._open_stream())

    def notify(self, method: str, params: Mapping[str, Any]) -> None:
        self._stream.write(encode_notification(method, params))

    def notify_stop(self, method: str, params: Mapping[str, Any]) -> None:
        """Send the robot's stop command as a notification. Malformed received data does not prevent this, since
        the command needs no answer."""
        self._stream.write_stop(encode_notification(method, params))

    def send_stop(self, method: str, params: Mapping[str, Any]) -> None:
        """Send the robot's stop command as a request, for a service that requires one. Its answer is dropped."""
        self._stream.write_stop(encode_request(next(self._numbers), method, params))

    def send(self, method: str, params: Mapping[str, Any]) -> int:
        """Send a request now and return its number. Its answer is kept until ``answer`` or ``forget`` is called."""
        number = next(self._numbers)
        self._stream.write(encode_request(number, method, params))
        self._exchange.sent(number, method, awaited=True)
        return number

    def forget(self, number: int) -> None:
        self._exchange.drop(number)

    async def answer(self, number: int, within_s: float) -> Any:
        """Wait for the answer to a request, and return its result.

        Args:
            number: The result of ``send``.
            within_s: Longest wait.

        Raises:
            RequestFailed: The service has answered with an error.
            WireDown: There is no answer in time. The connection stays open.
        """
        try:
            answer = await self._exchange.answer(number, within_s, self._hear)
        finally:
            self.forget(number)
        match answer:
            case Result(_, value):
                return value
            case Failure(_, code, message):
                raise RequestFailed(code, message)
        raise WireDown(f"no answer within {within_s * 1e3:.0f} ms. Check that the service is alive")

    async def ask(self, method: str, params: Mapping[str, Any], within_s: float) -> Any:
        return await self.answer(self.send(method, params), within_s)

    async def hear(self) -> None:
        """Receive messages until the connection is lost."""
        await self.until(lambda: False)

    async def until(self, is_so: Callable[[], bool]) -> None:
        """Receive messages until ``is_so()`` is true."""
        await self._exchange.until(is_so, self._hear)

    def close(self) -> None:
        """Reset the connection. A second call does nothing."""
        self._stream.close()

    def reset(self) -> None:
        """Reset the connection, and drop all messages that have not arrived, even a stop. Use it after a stop was
        confirmed on another connection."""
        self._stream.reset()

    def _forget_all(self) -> None:
        self._lines = LineDecoder()
        self._exchange.clear()

    async def _hear(self) -> None:
        """Receive data once. If another task receives already, wait for it."""
        data = await self._stream.read()
        try:
            for line in self._lines.feed(data):
                self._take(line)
        except MalformedFrame as malformed:
            self._stream.deafen(str(malformed))
            raise WireDown(f"{malformed}. Check which service runs there") from None

    def _take(self, line: bytes) -> None:
        try:
            message = decode(line)
        except MalformedFrame:
            self.malformed += 1
            return
        if isinstance(message, Call):
            self._notice(message)
        elif isinstance(message.id, int):
            self._exchange.take(message.id, message)
