"""An actor has state that only its ``receive`` changes. It handles one message at a time.

The annotation of ``receive`` *is* the protocol: the kernel reads the accepted message types from it, and
decodes messages as these types. It answers any other message with a refusal, and the actor never sees that
message::

    class Gate(Actor):
        def receive(self, message: Setpoint | Stop) -> Accepted | Refused | StopReport: ...

A synchronous ``receive`` is the fast path; an asynchronous one may wait. To reply later, return
``self.context.defer()`` and call ``send`` on it when the answer is known.
"""

from __future__ import annotations

import contextlib
from collections.abc import Awaitable, Callable, Coroutine, Iterator
from functools import partial
from typing import Any

import trio

from . import refusals
from .clock import Clock
from .frames import Protocol, protocol_of
from .inline_dispatch import BURST, LONGEST_NS
from .mailbox import Mailbox, ReplyTo, Slot
from .messages import Message
from .ref import Ref
from .router import Router
from .ticker import Ticker


class Deferred:
    """A reply that ``receive`` returns in place of an answer. Call ``send`` when the answer is known."""

    __slots__ = ("_context", "_reply", "number")

    def __init__(self, reply: ReplyTo | None, context: Context | None = None, number: int = 0) -> None:
        self._reply = reply
        self._context = context
        self.number = number
        """Counts the deferred replies of an actor."""

    def send(self, answer: Message | None) -> None:
        context = self._context
        if context is not None and (instrument := context.node.instrument) is not None:
            instrument.settled(context.address, self.number, answer)
        if self._reply is not None:
            self._reply.send(answer)
            self._reply = None


class Actor:
    """Base of all actors. Define ``receive`` with annotated message types; override ``started`` to set timers
    or to look up other actors.
    """

    context: Context

    async def started(self) -> None:
        """Run before the first message of each incarnation (start or restart of the actor)."""

    def receive(self, message: Any) -> Any:
        raise NotImplementedError

    def is_prompt(self, message: Any) -> bool:
        """Return True if an asynchronous ``receive`` would handle this message without waiting.

        The message can then be handled while its sender runs, without waking this actor's task (``dispatch``).
        """
        return False


def read_protocols() -> None:
    """Read the protocols of all imported actor classes, so that forked children need not."""
    unread: list[type[Actor]] = [Actor]
    while unread:
        derived = unread.pop().__subclasses__()
        unread += derived
        for actor_class in derived:
            protocol_of(actor_class)


class Context:
    """The interface of an actor to its node. Each incarnation (each start of the actor) gets a new one."""

    def __init__(self, cell: Cell, nursery: trio.Nursery) -> None:
        self._cell = cell
        self._nursery = nursery
        self.node = cell.node
        self.clock: Clock = cell.node.clock
        self.address = cell.address
        self.reply: ReplyTo | None = None
        self.received_ns = self.clock.now_ns()
        """When the present message was taken from the mailbox; before the first one, when this incarnation
        began. A handler that reads the time only here depends on its state, the message and this time
        alone, and can be replayed."""
        self.deferrals = 0

    @property
    def expects_answer(self) -> bool:
        """True if the sender waits for the answer to the present message."""
        return self.reply is not None

    @property
    def me(self) -> Ref:
        return self.node.ref(self.address, type(self._cell.actor), sender=self.address)

    def ref(self, address: str, protocol: type[Actor] | None = None) -> Ref:
        """Return a reference to the actor at ``address``. Messages that are sent by it name this actor as the
        sender.
        """
        return self.node.ref(address, protocol, sender=self.address)

    def defer(self) -> Deferred:
        """Return a ``Deferred``, by which the actor answers the present message later."""
        self.deferrals += 1
        return Deferred(self.reply, self, self.deferrals)

    def saw(self, value: object) -> None:
        """Report a value to the recorder, if there is one, so that a replay knows it. A handler has read or
        written the value, and it is not in the handler's message.
        """
        if (instrument := self.node.instrument) is not None:
            instrument.saw(self.address, value)

    def note(self, message: Message) -> None:
        """Report an event that no message describes to the recorder, if there is one."""
        if (instrument := self.node.instrument) is not None:
            instrument.noted(self.address, self.clock.now_ns(), message)

    def watch(self, address: str) -> None:
        """Receive ``Down`` when the actor at ``address`` has ended or cannot be reached."""
        self.node.watch(address, self.address)

    @property
    def urgent_waiting(self) -> bool:
        return self._cell.mailbox.urgent_waiting

    @contextlib.contextmanager
    def until_urgent(self) -> Iterator[None]:
        """Cancel the block when an urgent message for this actor comes, so that a stop does not wait for a slow
        robot.

        Variables that the block should assign may then be missing.
        """
        mailbox = self._cell.mailbox
        with trio.CancelScope() as scope:
            mailbox.on_urgent = scope.cancel
            try:
                if mailbox.urgent_waiting:
                    scope.cancel()
                yield
            finally:
                mailbox.on_urgent = None

    def every(self, period_s: float, make: Callable[[int], Message]) -> Ticker:
        """Send ``make(now_ns)`` to this actor once per period. Return the ticker."""
        put, dispatch, address = self._cell.mailbox.put, self.node.dispatch, self.address

        def tick(now_ns: int) -> None:
            with dispatch:
                put(make(now_ns), None, address)

        ticker = Ticker(self.clock, period_s)
        self._nursery.start_soon(ticker.run, tick)
        return ticker

    def start_soon(self, task: Callable[..., Awaitable[Any]], *args: Any) -> None:
        """Start a task that is cancelled when this incarnation (start of the actor) ends. If the task fails, the
        actor fails.
        """
        self._nursery.start_soon(task, *args)


class Cell:
    """The address and the mailbox of one actor, through all its incarnations (starts and restarts).

    The mailbox survives a restart.
    """

    def __init__(self, node: Router, address: str, factory: Callable[[], Actor], role: str = "") -> None:
        self.node = node
        self.address = address
        self.role = role or address.rsplit("/", 1)[-1]
        self.factory = factory
        self.actor: Actor = factory()
        self.protocol: Protocol = protocol_of(type(self.actor))
        can_be_helped = not self.protocol.is_async or type(self.actor).is_prompt is not Actor.is_prompt
        self.plain = self.protocol.accepts - self.protocol.carriers
        """Messages that go into the mailbox unchanged, without descriptors."""
        self.commands = frozenset(message_type for message_type in self.plain if message_type.lane == "command")
        self.mailbox = Mailbox(offer=partial(node.dispatch.offer, self) if can_be_helped else None)
        self._error: Exception | None = None
        self.hosted = False
        """True while its node knows the address."""
        self.incarnations = 0
        self.state = "starting"

    async def run(self, task_status: trio.TaskStatus[None] = trio.TASK_STATUS_IGNORED) -> None:
        """Run one incarnation (one start of the actor), until it is cancelled or the actor raises."""
        if self.incarnations:
            self.actor = self.factory()
        self.incarnations += 1
        self.state = "starting"
        self._error = None
        self.node.host(self)
        reason = "stopped"
        try:
            async with trio.open_nursery() as nursery:
                self.actor.context = Context(self, nursery)
                await self.actor.started()
                self.state = "running"
                task_status.started()
                await self._loop()
        except Exception as error:
            reason = describe(error)
            raise
        finally:
            self.state = "stopped"
            self.node.unhost(self, reason)

    # -- handle messages, in the actor's task or in a sender's turn

    async def _loop(self) -> None:
        mailbox, dispatch = self.mailbox, self.node.dispatch
        while True:
            if self.protocol.is_async:
                await self._work_slowly()
            else:
                with dispatch:
                    self.work(self.node.clock.now_ns() + LONGEST_NS)
            try:
                await mailbox.wait()
            finally:
                if self._error is not None:
                    raise self._error

    def help(self, until_ns: int) -> bool:
        if not self.mailbox.take_up():
            # The actor's task was woken, or it ends. So nothing is left to do here.
            return True
        try:
            return self._work_promptly(until_ns) if self.protocol.is_async else self.work(until_ns)
        except Exception as error:
            # The actor's task raises this error.
            self._error = error
            self.wake()
            return True

    def wake(self) -> None:
        self.mailbox.wake()

    def work(self, until_ns: int) -> bool:
        """Handle the waiting messages of a synchronous actor. Return True if no message is left.

        An exception of the actor is raised.
        """
        urgent, queue = self.mailbox.urgent, self.mailbox.queue
        now_ns, instrument = self.node.clock.now_ns, self.node.instrument
        context, receive = self.actor.context, self.actor.receive
        at_ns = now_ns()
        for _ in range(BURST):
            # This repeats ``Mailbox.pop`` inline, which saves a call for each message.
            if urgent:
                item: Any = urgent.popleft()
            elif queue:
                item = queue.popleft()
            else:
                return True
            # ``isinstance()`` would call msgspec's metaclass, which takes 50 ns.
            message_type = type(item)
            if message_type is tuple:
                message, reply = item
            elif message_type is Slot:
                message, reply = item.take()
            else:
                message, reply = item, None
            context.received_ns = at_ns
            context.reply = reply
            if instrument is not None:
                instrument.took(self.address, at_ns, message, reply is not None)
            try:
                answer = receive(message)
            except Exception as error:
                self._failed(reply, error)
                raise
            if instrument is not None or reply is not None:
                self._answered(reply, answer)
            at_ns = now_ns()
            if at_ns > until_ns:
                break
        return not self.mailbox

    def _work_promptly(self, until_ns: int) -> bool:
        """Handle the waiting messages of an asynchronous actor, as long as they need no waiting
        (``is_prompt``).
        """
        mailbox, now_ns, actor = self.mailbox, self.node.clock.now_ns, self.actor
        at_ns = now_ns()
        while (entry := mailbox.first()) is not None:
            message, reply = entry
            if at_ns > until_ns or not actor.is_prompt(message):
                return False
            mailbox.pop()
            self._take_up(message, reply, at_ns)
            try:
                answer = _at_once(actor.receive(message))
            except Exception as error:
                self._failed(reply, error)
                raise
            self._answered(reply, answer)
            at_ns = now_ns()
        return True

    async def _work_slowly(self) -> None:
        pop, now_ns = self.mailbox.pop, self.node.clock.now_ns
        at_ns = now_ns()
        until_ns = at_ns + LONGEST_NS
        for _ in range(BURST):
            entry = pop()
            if entry is None:
                return
            message, reply = entry
            self._take_up(message, reply, at_ns)
            try:
                answer = await self.node.dispatch.of(self.actor.receive(message))
            except Exception as error:
                self._failed(reply, error)
                raise
            self._answered(reply, answer)
            at_ns = now_ns()
            if at_ns > until_ns:
                return

    def _take_up(self, message: Message, reply: ReplyTo | None, at_ns: int) -> None:
        context, instrument = self.actor.context, self.node.instrument
        context.received_ns = at_ns
        context.reply = reply
        if instrument is not None:
            instrument.took(self.address, at_ns, message, reply is not None)

    def _answered(self, reply: ReplyTo | None, answer: Any) -> None:
        instrument = self.node.instrument
        if instrument is not None:
            if type(answer) is Deferred:
                instrument.deferred(self.address, answer.number)
            else:
                instrument.answered(self.address, answer)
        if reply is not None and type(answer) is not Deferred:
            reply.send(answer)

    def _failed(self, reply: ReplyTo | None, error: Exception) -> None:
        if reply is not None:
            reply.send(refusals.crashed(self.address, describe(error)))


def _at_once(handler: Coroutine[Any, Any, Any]) -> Any:
    """Run an asynchronous handler that must not wait, and return its result.

    Raise ``RuntimeError`` if the handler waits.
    """
    try:
        handler.send(None)
    except StopIteration as done:
        return done.value
    handler.close()
    raise RuntimeError(f"{handler} waits, but is_prompt returned True for its message")


def first_of(error: BaseException) -> BaseException:
    """Return the first error of an exception group. Return an error that is not a group unchanged."""
    while isinstance(error, BaseExceptionGroup):
        error = error.exceptions[0]
    return error


def describe(error: BaseException) -> str:
    """Describe an error in one line for people. An exception group is described by its first error."""
    error = first_of(error)
    return f"{type(error).__name__}: {error}" if str(error) else type(error).__name__
