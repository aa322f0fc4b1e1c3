"""The client of a simulation's control socket."""

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
    """One connection to a simulation, with one request at a time. Every method raises ``WireDown`` once the
    simulation has ended."""

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
        self._replies: deque[p.Reply] = deque()

    def tell(self, request: p.Request) -> None:
        """Send a request without waiting for a reply. Raise ``WireDown`` if the socket does not accept all of
        it."""
        data = p.encode(request)
        try:
            sent = self._socket.send(data)
        except BlockingIOError:
            sent = 0
        except OSError as error:
            raise WireDown(f"the simulation ended ({error.strerror or error})") from None
        if sent != len(data):
            raise WireDown("the simulation does not read its socket. Reconnect")

    def ask(self, request: p.Request) -> int:
        """Send a request. Return its number, which its reply will carry."""
        number = next(self._numbers)
        self.tell(msgspec.structs.replace(request, number=number))
        return number

    async def answer(self, number: int, reply_type: type[T], within_s: float) -> T | None:
        """Wait for the reply with this number, and drop other replies. Return None if it does not come in time.

        Args:
            number: The result of ``ask``.
            reply_type: Type of the expected reply.
            within_s: Timeout in seconds.

        Raises:
            Refusal: The simulation has refused the request (reply ``No``).
            WireDown: The reply has another type, or the simulation has ended.
        """
        with trio.move_on_after(within_s):
            while True:
                reply = await self._next()
                if reply.number != number:
                    continue
                if isinstance(reply, p.No):
                    raise Refusal(reply.reason)
                if not isinstance(reply, reply_type):
                    raise WireDown(f"the simulation sent an unexpected reply ({type(reply).__name__})")
                return reply
        return None

    async def call(self, request: p.Request, reply_type: type[T], within_s: float) -> T:
        """Send a request and return its reply. Raise ``WireDown`` if it does not come in time."""
        reply = await self.answer(self.ask(request), reply_type, within_s)
        if reply is None:
            raise WireDown(f"the simulation does not answer within {within_s:g} s")
        return reply

    def close(self) -> None:
        with contextlib.suppress(OSError):
            trio.lowlevel.notify_closing(self._socket)
        self._socket.close()

    async def _next(self) -> p.Reply:
        while not self._replies:
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
                self._replies.extend(self._decoder.feed(data))
            except MalformedFrame as garbled:
                raise WireDown(f"the simulation sent malformed data ({garbled})") from None
        return self._replies.popleft()


class Refusal(Exception):
    """The simulation has refused a request. The exception's text gives the reason."""
