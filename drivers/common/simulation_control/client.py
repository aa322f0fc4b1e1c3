"""The client's end of the simulation control."""

from __future__ import annotations

import contextlib
import itertools
import socket
from collections import deque
from typing import TypeVar

import msgspec
import trio

from strands_actors.contract.wire import WireDown
from strands_actors.drivers.common.codecs.malformed import MalformedFrame
from strands_actors.kernel.processes.reserve import RESERVE

from . import protocol as p

T = TypeVar("T", bound=p.Frame)

_CHUNK = 1 << 18


class SimulationClient:
    """One connection, with one request at a time. Every method raises ``WireDown`` once the simulation is
    gone."""

    def __init__(self, path: str) -> None:
        try:
            self._socket = socket.socket(socket.AF_UNIX)
        except OSError as error:
            RESERVE.lacked(error)
            raise WireDown(f"the simulation cannot be reached ({error.strerror or error})") from None
        self._socket.setblocking(False)
        try:
            self._socket.connect(path)
        except OSError as error:
            self._socket.close()
            raise WireDown(f"the simulation does not run ({error.strerror or error})") from None
        self._decoder = p.reply_decoder()
        self._numbers = itertools.count(1)
        self._heard: deque[p.Reply] = deque()

    def tell(self, request: p.Request) -> None:
        """Send a request without waiting. Raise ``WireDown`` if the socket does not take all of it."""
        data = p.encode(request)
        try:
            sent = self._socket.send(data)
        except BlockingIOError:
            sent = 0
        except OSError as error:
            raise WireDown(f"the simulation ended ({error.strerror or error})") from None
        if sent != len(data):
            raise WireDown("the simulation does not read. reconnect")

    def ask(self, request: p.Request) -> int:
        """Send a request, and return the number of its reply."""
        number = next(self._numbers)
        self.tell(msgspec.structs.replace(request, number=number))
        return number

    async def answer(self, number: int, kind: type[T], within_s: float) -> T | None:
        """Return the reply with this number; None if it does not come in time. Drop other replies.

        Args:
            number: As returned by ``ask``.
            kind: Type of the expected reply.
            within_s: Timeout in seconds.

        Raises:
            Refusal: The reply is a ``No``.
            WireDown: The reply has another type, or the simulation is gone.
        """
        with trio.move_on_after(within_s):
            while True:
                reply = await self._next()
                if reply.number != number:
                    continue
                if isinstance(reply, p.No):
                    raise Refusal(reply.why)
                if not isinstance(reply, kind):
                    raise WireDown(f"the simulation answers with {type(reply).__name__}")
                return reply
        return None

    async def call(self, request: p.Request, kind: type[T], within_s: float) -> T:
        """Send a request and return its reply. Raise ``WireDown`` if it does not come in time."""
        reply = await self.answer(self.ask(request), kind, within_s)
        if reply is None:
            raise WireDown(f"the simulation does not answer within {within_s:g} s")
        return reply

    def close(self) -> None:
        with contextlib.suppress(OSError):
            trio.lowlevel.notify_closing(self._socket)
        self._socket.close()

    async def _next(self) -> p.Reply:
        while not self._heard:
            await trio.lowlevel.wait_readable(self._socket)
            try:
                data = self._socket.recv(_CHUNK)
            except BlockingIOError:
                continue
            except OSError as error:
                raise WireDown(f"the simulation ended ({error.strerror or error})") from None
            if not data:
                raise WireDown("the simulation ended")
            try:
                self._heard.extend(self._decoder.feed(data))
            except MalformedFrame as garbled:
                raise WireDown(f"the simulation says {garbled}") from None
        return self._heard.popleft()


class Refusal(Exception):
    """The simulation has refused a request. The text gives the reason."""
