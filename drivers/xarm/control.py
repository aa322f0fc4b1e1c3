"""Talk to a controller's control port, and stop the arm over this connection. The wire process and the root's stop
channel share this code."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from typing import Protocol

import trio

from strands_actors.contract.wire import Permit, WireDown
from strands_actors.drivers.common.codecs.malformed import MalformedFrame
from strands_actors.drivers.common.kit.outcome import Outcome
from strands_actors.drivers.common.ports.exchange import Exchange, numbers
from strands_actors.drivers.common.ports.receive_budget import ReceiveBudget
from strands_actors.drivers.common.ports.tcp_port import ByteStream
from strands_actors.kernel.clock import NS, Clock

from . import protocol as p
from .config import XArmConfig
from .protocol import Register, State

ATTEMPTS = 3
ACKNOWLEDGE_S, CONFIRM_S = 0.1, 0.2
"""Timeouts of the two requests of an attempt, in seconds. Three attempts and a new connection fit into the time
limit of a stop."""

LOOK_S = 0.02
"""Period of checking the permit during the wait for a reply, in seconds."""

FORGET_S = 1.0
"""A request without a reply is deleted after this many seconds."""


class Stream(ByteStream, Protocol):
    """The methods that a connection must have for this module."""

    def read_waiting(self) -> bytes | None: ...

    def close_in_order(self) -> None: ...


OpenStream = Callable[[str, int], Awaitable[Stream]]


class Control:
    """Send requests without waiting, and match each reply to its request by number. Every method may raise
    ``WireDown``."""

    def __init__(self, stream: Stream, name: str, clock: Clock) -> None:
        self._stream = stream
        self._name = name
        self._clock = clock
        self._budget = ReceiveBudget(name)
        self._decoder = p.Decoder()
        self._numbers = numbers(p.LAST_NUMBER)
        # For each request its register.
        self._exchange: Exchange[int, int, p.Reply] = Exchange()
        # Codes of the error and the warning, from the last reply to ``ERRORS``.
        self.errors: tuple[int, int] = (0, 0)
        # Called with each reply to a request.
        self.on_reply: Callable[[p.Reply], None] = lambda reply: None
        self.error_pending = False  # the error bit in the state byte of the last reply
        self.state_set = 0  # number of the last ``SET_STATE`` request that was answered

    @property
    def idle(self) -> bool:
        """Return True if every request was answered."""
        return self._exchange.unanswered == 0

    def silent_s(self, now_ns: int) -> float:
        """Return for how long the controller has sent nothing while a request waits for its reply; 0 if no request
        waits."""
        return self._exchange.silent_s(now_ns)

    def send(self, register: int, data: bytes = b"", *, awaited: bool = False) -> int:
        """Send a request now. Return its number, which the reply repeats."""
        number = next(self._numbers)
        self._stream.write(p.request(number, register, data))
        self._exchange.sent(number, register, self._clock.now_ns(), awaited=awaited)
        return number

    async def ask(
        self, register: int, data: bytes = b"", *, within_s: float, permit: Permit | None = None
    ) -> p.Reply | None:
        """Send a request and wait for its reply.

        Args:
            register: The register that the request reads or writes.
            data: The data of the request.
            within_s: The timeout.
            permit: The check whether the robot may still be commanded. It is repeated during the wait, and raises
                an exception if not. None for no check.

        Returns:
            The reply; None if it did not arrive in time.
        """
        number = self.send(register, data, awaited=True)
        end_s = trio.current_time() + within_s
        try:
            while self._exchange.waits_for(number) and (remaining_s := end_s - trio.current_time()) > 0:
                if permit is not None:
                    permit.check()
                await self._exchange.wait(min(remaining_s, LOOK_S), self._receive, number)
            return self._exchange.pop(number)
        finally:
            self._exchange.forget(number)

    def take_waiting(self) -> None:
        """Process received data, up to a limit for each call. Never waits."""
        for data in self._budget.turn(self._stream.read_waiting):
            self._take(data)

    def close(self) -> None:
        self._stream.close()

    def close_in_order(self) -> None:
        """Close the connection after all sent bytes are delivered. So a frozen controller still reads a stop that
        was sent before."""
        self._stream.close_in_order()

    async def _receive(self) -> None:
        self._take(await self._stream.read())

    def _take(self, data: bytes) -> None:
        now_ns = self._clock.now_ns()
        try:
            for received in self._decoder.feed(data):
                self._take_reply(p.reply_of(received))
        except MalformedFrame as malformed:
            raise WireDown(f"{self._name}: the controller sent invalid data ({malformed}). Reconnect") from None
        self._exchange.received(now_ns)
        self._exchange.expire(now_ns - round(FORGET_S * NS))

    def _take_reply(self, reply: p.Reply) -> None:
        register = self._exchange.request(reply.number)
        if register is None:
            # The reply came so late that its request was deleted.
            return
        if register != reply.register:
            raise MalformedFrame(f"register {reply.register} for {register}")
        self._exchange.take(reply.number, reply)
        self.error_pending = bool(reply.state & p.ERROR)
        if reply.register == Register.ERRORS:
            self.errors = p.errors_of(reply.data)
        if reply.register == Register.SET_STATE:
            self.state_set = reply.number
        self.on_reply(reply)


async def open_control(config: XArmConfig, clock: Clock, open_stream: OpenStream) -> Control:
    """Connect to the control port. Raise ``WireDown`` if that fails."""
    try:
        host, port = config.address()
    except ValueError as error:
        raise WireDown(str(error)) from None
    return Control(await open_stream(host, port), f"{config.robot} at {host}:{port}", clock)


async def stop(control: Control) -> Outcome:
    """Stop the arm (state 4), and read the state back to confirm it. Never raises."""
    written = acknowledged = False
    detail = "silent"
    try:
        for _ in range(ATTEMPTS):
            reply = await control.ask(Register.SET_STATE, bytes((State.STOPPED,)), within_s=ACKNOWLEDGE_S)
            written = True
            acknowledged = acknowledged or (reply is not None and not reply.state & p.INVALID)
            reading = await control.ask(Register.GET_STATE, within_s=CONFIRM_S)
            detail = "silent" if reading is None else unsafe_reason(reading)
            if not detail:
                break
    except WireDown as down:
        detail = str(down)
    return Outcome(written, acknowledged, detail)


def unsafe_reason(reply: p.Reply) -> str:
    """Return why the reply to a ``GET_STATE`` does not show a stopped arm; empty if it shows a stopped arm."""
    data = reply.data
    if reply.state & p.INVALID:
        return "the controller refuses the request for its state"
    if data[:1] == bytes((State.STOPPED,)):
        return ""
    return f"the controller reports state {data[0]}" if data else "the controller reports no state"
