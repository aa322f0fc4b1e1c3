"""An actor: state that only its own ``receive`` touches, one message at a time.

The annotation of ``receive`` *is* the protocol: the kernel reads the union from it, builds the decoder
of the inbox, and answers anything else with a typed refusal, never with an exception in the actor::

    class Gate(Actor):
        def receive(self, message: Setpoint | Stop) -> Accepted | Refused | StopReport: ...

A synchronous ``receive`` is the fast path; an asynchronous one may wait. An answer that is not known yet
is given later: return ``self.context.defer()`` and ``send`` on what it holds.
"""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from contextlib import aclosing
from typing import TYPE_CHECKING, Any, cast

import trio

from .clock import Clock
from .frames import Protocol, protocol_of
from .mailbox import Entry, Mailbox, ReplyTo
from .messages import Message, Refused

if TYPE_CHECKING:
    from .node import Node, Ref

BURST = 64
"""Messages handled before the loop lets other tasks run: one scheduler tick costs more than a message."""
BURST_NS = 200_000


class Deferred:
    """Returned by ``receive`` instead of an answer; answer with ``send`` when it is known."""

    __slots__ = ("_context", "_reply", "number")

    def __init__(self, reply: ReplyTo | None, context: Context | None = None, number: int = 0) -> None:
        self._reply = reply
        self._context = context
        self.number = number
        """Of its actor's, in the order they were made."""

    def send(self, answer: Message | None) -> None:
        context = self._context
        if context is not None and (tap := context.node.tap) is not None:
            tap.settled(context.address, self.number, answer)
        if self._reply is not None:
            self._reply.send(answer)
            self._reply = None


class Actor:
    """Subclass with a typed ``receive``; override ``started`` to set timers or look others up."""

    context: Context

    async def started(self) -> None:
        """Runs before the first message of each incarnation."""

    def receive(self, message: Any) -> Any:
        raise NotImplementedError


class Context:
    """What an actor may use of its surroundings; new for each incarnation."""

    def __init__(self, cell: Cell, nursery: trio.Nursery) -> None:
        self._cell = cell
        self._nursery = nursery
        self.node = cell.node
        self.clock: Clock = cell.node.clock
        self.address = cell.address
        self.reply: ReplyTo | None = None
        self.received_ns = self.clock.now_ns()
        """When the present message was taken up; before the first one, when this incarnation began. A handler
        that reads the time here and nowhere else is a function of its state, the message and this."""
        self.deferrals = 0

    @property
    def asked(self) -> bool:
        """Whether somebody waits for the answer to the present message."""
        return self.reply is not None

    @property
    def me(self) -> Ref:
        return self.node.ref(self.address, type(self._cell.actor), sender=self.address)

    def ref(self, address: str, protocol: type[Actor] | None = None) -> Ref:
        """A reference whose messages name this actor as the sender."""
        return self.node.ref(address, protocol, sender=self.address)

    def defer(self) -> Deferred:
        """Keep the present message's reply for later."""
        self.deferrals += 1
        return Deferred(self.reply, self, self.deferrals)

    def saw(self, value: object) -> None:
        """For a recorder: what a handler has just read of the world beside its message."""
        if (tap := self.node.tap) is not None:
            tap.saw(self.address, value)

    def note(self, message: Message) -> None:
        """For a recorder: an event that no message tells."""
        if (tap := self.node.tap) is not None:
            tap.noted(self.address, self.clock.now_ns(), message)

    def watch(self, address: str) -> None:
        """Receive ``Down`` when the actor at ``address`` ends or cannot be reached any more."""
        self.node.watch(address, self.address)

    @property
    def urgent_waiting(self) -> bool:
        return self._cell.mailbox.urgent_waiting

    def every(self, period_s: float, make: Callable[[int], Message]) -> None:
        """Tell this actor ``make(now_ns)`` once per period, by a ticker of its own."""

        async def tick() -> None:
            async with aclosing(self.clock.ticks(period_s)) as ticks:
                async for now_ns in ticks:
                    self._cell.mailbox.put(make(now_ns), None, self.address)

        self._nursery.start_soon(tick)

    def start_soon(self, task: Callable[..., Awaitable[Any]], *args: Any) -> None:
        """A task that lives as long as this incarnation; its failure is the actor's."""
        self._nursery.start_soon(task, *args)


class Cell:
    """An address, a mailbox, and the incarnations of one actor. The mailbox survives a restart."""

    def __init__(self, node: Node, address: str, factory: Callable[[], Actor], role: str = "") -> None:
        self.node = node
        self.address = address
        self.role = role or address.rsplit("/", 1)[-1]
        self.factory = factory
        self.mailbox = Mailbox()
        self.actor: Actor = factory()
        self.protocol: Protocol = protocol_of(type(self.actor))
        self.incarnations = 0
        self.state = "starting"

    async def run(self, task_status: trio.TaskStatus[None] = trio.TASK_STATUS_IGNORED) -> None:
        """One incarnation: returns only by cancellation or by the actor's exception."""
        if self.incarnations:
            self.actor = self.factory()
        self.incarnations += 1
        self.state = "starting"
        self.node.host(self)
        reason = "stopped"
        try:
            async with trio.open_nursery() as nursery:
                self.actor.context = context = Context(self, nursery)
                await self.actor.started()
                self.state = "running"
                task_status.started()
                await self._loop(context)
        except Exception as error:
            reason = describe(error)
            raise
        finally:
            self.state = "stopped"
            self.node.unhost(self, reason)

    async def _loop(self, context: Context) -> None:
        mailbox, protocol = self.mailbox, self.protocol
        receive = cast(Callable[[Message], Any], self.actor.receive)
        now_ns = self.node.clock.now_ns
        while True:
            at_ns = now_ns()
            yield_at_ns = at_ns + BURST_NS
            for _ in range(BURST):
                entry = mailbox.pop()
                if entry is None:
                    await mailbox.wait()
                    break
                context.received_ns = at_ns
                await self._handle(entry, context, receive, protocol.is_async)
                at_ns = now_ns()
                if at_ns > yield_at_ns:
                    await trio.lowlevel.checkpoint()
                    break
            else:
                await trio.lowlevel.checkpoint()

    async def _handle(
        self, entry: Entry, context: Context, receive: Callable[[Message], Any], is_async: bool
    ) -> None:
        message, reply = entry
        context.reply = reply
        tap = self.node.tap
        if tap is not None:
            tap.took(self.address, context.received_ns, message, reply is not None)
        try:
            answer = receive(message)
            if is_async:
                answer = await answer
        except Exception as error:
            if reply is not None:
                reply.send(Refused("crashed", f"{self.address} failed: {describe(error)}"))
            raise
        if tap is not None:
            if type(answer) is Deferred:
                tap.deferred(self.address, answer.number)
            else:
                tap.answered(self.address, answer)
        if reply is not None and type(answer) is not Deferred:
            reply.send(answer)


def describe(error: BaseException) -> str:
    """One line for people; of a group, its first cause."""
    while isinstance(error, BaseExceptionGroup):
        error = error.exceptions[0]
    return f"{type(error).__name__}: {error}" if str(error) else type(error).__name__
