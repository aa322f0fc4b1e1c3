"""References to actors, in this process or another: ``tell``, ``ask`` and their variants."""

from __future__ import annotations

import threading
from collections.abc import Mapping
from typing import Any
from typing import Protocol as TypingProtocol

import trio

from .asks import Answer, Deadlines, not_running
from .frames import ASK, TELL, Protocol, frame, protocol_of
from .inline_dispatch import InlineDispatch
from .instrument import Instrument
from .mailbox import Mailbox, ReplyTo
from .messages import Message
from .ways import Connection, Mesh

PROMPT = 32
"""After so many answers that came without waiting, a sender still lets other tasks run once."""


class Hosted(TypingProtocol):
    """The attributes and methods of an actor of this process that a reference uses. ``actor.Cell`` implements
    them.
    """

    address: str
    role: str
    actor: Any
    mailbox: Mailbox
    protocol: Protocol
    plain: frozenset[type[Message]]
    commands: frozenset[type[Message]]
    hosted: bool
    state: str
    incarnations: int


class Home(TypingProtocol):
    """The part of a node that a reference to an actor uses. ``router.Router`` describes its methods."""

    address: str
    mesh: Mesh | None
    dispatch: InlineDispatch
    instrument: Instrument | None
    deadlines: Deadlines
    pending: dict[int, Answer]

    @property
    def cells(self) -> Mapping[str, Hosted]: ...

    def is_turn(self) -> bool: ...

    def put_local(self, cell: Hosted, message: Message, reply: ReplyTo | None, sender: str) -> None: ...

    def send_frame(self, to: str, kind: int, cid: int, sender: str, body: Message | None) -> bool: ...

    def dead(self, to: str, subject: object, reason: str) -> None: ...

    def new_cid(self) -> int: ...

    def route(self, address: str) -> Connection | None: ...

    def connection_to(self, address: str) -> Connection | None: ...


class ActorRef(TypingProtocol):
    """The interface of a reference to an actor. ``Ref`` describes its methods."""

    address: str

    def tell(self, message: Message) -> None: ...

    async def ask(self, message: Message, deadline_s: float) -> Message | None: ...

    def ask_here(self, message: Message, deadline_s: float) -> Message | None: ...


class Ref:
    """A reference to one actor. It is cheap to make."""

    __slots__ = ("_cell", "_node", "_protocol", "_sender", "address")

    def __init__(self, node: Home, address: str, protocol: type[Any] | None, sender: str) -> None:
        self.address = address
        self._node = node
        self._protocol: Protocol | None = None if protocol is None else protocol_of(protocol)
        self._sender = sender
        self._cell: Hosted | None = None

    def _local(self) -> Hosted | None:
        """Return the actor's cell (its address and mailbox) if this node hosts it."""
        cell = self._cell
        if cell is None or not cell.hosted:
            self._cell = cell = self._node.cells.get(self.address)
        return cell

    def tell(self, message: Message) -> None:
        """Send a message that needs no answer. If it cannot be delivered, it is recorded as a dead letter."""
        node = self._node
        if node.instrument is not None:
            node.instrument.sent(self._sender, self.address, message)
        cell = self._cell
        if cell is None or not cell.hosted:
            cell = self._local()
        if cell is not None:
            mailbox, message_type = cell.mailbox, type(message)
            # This repeats ``Mailbox.put`` inline, with one call less.
            if message_type in cell.commands and len(mailbox.queue) < mailbox.capacity:
                mailbox.queue.append(message)
                if mailbox.idle:
                    mailbox.rouse()
            elif message_type not in cell.plain or not mailbox.put(message, None, self._sender):
                node.put_local(cell, message, None, self._sender)
        elif not node.send_frame(self.address, TELL, 0, self._sender, message):
            node.dead(self.address, message, "nobody hosts it")

    async def ask(self, message: Message, deadline_s: float) -> Message | None:
        """Send a request to the actor, and wait for its answer. A refusal is an answer.

        Args:
            message: The request.
            deadline_s: Seconds from now until which the answer must have come.

        Raises:
            AskTimeout: No answer came in time. The request may still have been carried out.
            Unreachable: The actor does not exist, or ended before it answered.
        """
        node = self._node
        answer = Answer(self._protocol.decode_reply if self._protocol else None)
        cell = self._local()
        if cell is not None:
            with node.dispatch:
                if type(message) not in cell.plain or not cell.mailbox.put(message, answer, self._sender):
                    node.put_local(cell, message, answer, self._sender)
            if not answer.done:
                node.deadlines.add(answer, deadline_s)
            elif node.is_turn():
                await trio.lowlevel.checkpoint()
            return await answer.wait()
        cid = node.new_cid()
        answer.to, answer.connection = self.address, node.connection_to(self.address)
        node.pending[cid] = answer
        try:
            if not node.send_frame(self.address, ASK, cid, self._sender, message):
                raise not_running(self.address)
            if not answer.done:
                node.deadlines.add(answer, deadline_s)
            return await answer.wait()
        finally:
            node.pending.pop(cid, None)

    def ask_here(self, message: Message, deadline_s: float) -> Message | None:
        """Send a request and wait for the answer as ``ask`` does, from any thread except that of the loop, which
        would be blocked.

        The actor must live in another process and be on the mesh. The loop of this process does nothing for it.
        """
        mesh, protocol = self._node.mesh, self._protocol
        if mesh is None or protocol is None:
            raise not_running(self.address)
        # The thread is part of the sender's name. So the newest setpoint of each thread waits, not only the
        # newest of all threads.
        sender = f"{self._sender}/thread-{threading.get_ident()}"
        return mesh.ask(self.address, sender, message, protocol.decode_reply, deadline_s)

    def ask_at_once(self, message: Message) -> Sent | None:
        """Send a request over a link, from any thread, without the loop.

        Returns:
            The sent request. None if no link leads to the actor, or if the link still has other frames to send.
            In that case nothing was sent.
        """
        node = self._node
        link = node.route(self.address)
        if link is None:
            return None
        cid, answer = node.new_cid(), Answer(self._protocol.decode_reply if self._protocol else None)
        answer.to, answer.connection = self.address, link
        sent = Sent(node, cid, answer)
        # Store the answer before the frame leaves, since the loop may read the reply before this thread
        # continues.
        node.pending[cid] = answer
        if not link.send_at_once(frame(self.address, ASK, cid, self._sender, node.address, message)):
            sent.forget()
            return None
        return sent


class Sent:
    """A request that ``Ref.ask_at_once`` has sent. The loop handles its answer."""

    __slots__ = ("_answer", "_cid", "_node")

    def __init__(self, node: Home, cid: int, answer: Answer) -> None:
        self._node, self._cid, self._answer = node, cid, answer

    async def answer(self, deadline_s: float) -> Message | None:
        """Wait for the answer. Raise as ``Ref.ask`` does."""
        try:
            if not self._answer.done:
                self._node.deadlines.add(self._answer, deadline_s)
            return await self._answer.wait()
        finally:
            self.forget()

    def forget(self) -> None:
        self._node.pending.pop(self._cid, None)
