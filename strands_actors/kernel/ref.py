"""References: how an actor, in this process or another, is asked and told."""

from __future__ import annotations

import threading
from collections.abc import Mapping
from typing import Any
from typing import Protocol as TypingProtocol

import trio

from .asks import Answer, Deadlines, not_there
from .frames import ASK, TELL, Protocol, frame, protocol_of
from .inline_dispatch import InlineDispatch
from .instrument import Instrument
from .mailbox import Mailbox, ReplyTo
from .messages import Message
from .ways import Mesh, Way

PROMPT = 32
"""Answers that were there at once before an asker lets other tasks run all the same."""


class Hosted(TypingProtocol):
    """An actor as its node knows it. ``actor.Cell`` is one."""

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
    """What a reference uses of the node of its process. ``router.Router`` says what each does."""

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

    def dead(self, to: str, what: object, why: str) -> None: ...

    def new_cid(self) -> int: ...

    def route(self, address: str) -> Way | None: ...

    def way_to(self, address: str) -> Way | None: ...


class ActorRef(TypingProtocol):
    """What can be asked and told. ``Ref`` says what each does."""

    address: str

    def tell(self, message: Message) -> None: ...

    async def ask(self, message: Message, deadline_s: float) -> Message | None: ...

    def ask_here(self, message: Message, deadline_s: float) -> Message | None: ...


class Ref:
    """A way to reach one actor. Cheap; make as many as you like."""

    __slots__ = ("_cell", "_node", "_protocol", "_sender", "address")

    def __init__(self, node: Home, address: str, protocol: type[Any] | None, sender: str) -> None:
        self.address = address
        self._node = node
        self._protocol: Protocol | None = None if protocol is None else protocol_of(protocol)
        self._sender = sender
        self._cell: Hosted | None = None

    def _local(self) -> Hosted | None:
        """Return the cell, if it is one of this node's."""
        cell = self._cell
        if cell is None or not cell.hosted:
            self._cell = cell = self._node.cells.get(self.address)
        return cell

    def tell(self, message: Message) -> None:
        """Send and forget. What cannot be delivered becomes a dead letter."""
        node = self._node
        if node.instrument is not None:
            node.instrument.sent(self._sender, self.address, message)
        cell = self._cell
        if cell is None or not cell.hosted:
            cell = self._local()
        if cell is not None:
            mailbox, kind = cell.mailbox, type(message)
            if kind in cell.commands and len(mailbox.queue) < mailbox.capacity:  # as Mailbox.put; a call less
                mailbox.queue.append(message)
                if mailbox.idle:
                    mailbox.rouse()
            elif kind not in cell.plain or not mailbox.put(message, None, self._sender):
                node.put_local(cell, message, None, self._sender)
        elif not node.send_frame(self.address, TELL, 0, self._sender, message):
            node.dead(self.address, message, "nobody hosts it")

    async def ask(self, message: Message, deadline_s: float) -> Message | None:
        """Send and wait for the answer. Raise ``AskTimeout`` or ``Unreachable``; a refusal is an
        answer."""
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
        answer.to, answer.way = self.address, node.way_to(self.address)
        node.pending[cid] = answer
        try:
            if not node.send_frame(self.address, ASK, cid, self._sender, message):
                raise not_there(self.address)
            if not answer.done:
                node.deadlines.add(answer, deadline_s)
            return await answer.wait()
        finally:
            node.pending.pop(cid, None)

    def ask_here(self, message: Message, deadline_s: float) -> Message | None:
        """As ``ask``, of an actor of another process that is on the mesh: from any thread but the
        loop's, which it would hold up. The loop has no part in it."""
        mesh, protocol = self._node.mesh, self._protocol
        if mesh is None or protocol is None:
            raise not_there(self.address)
        sender = f"{self._sender}/thread-{threading.get_ident()}"  # of each the newest setpoint waits, not of all
        return mesh.ask(self.address, sender, message, protocol.decode_reply, deadline_s)

    def ask_at_once(self, message: Message) -> Sent | None:
        """From any thread, without its loop: send over a link to the process of the actor. None:
        there is none, or it has something to send before, and nothing was sent."""
        node = self._node
        link = node.route(self.address)
        if link is None:
            return None
        cid, answer = node.new_cid(), Answer(self._protocol.decode_reply if self._protocol else None)
        answer.to, answer.way = self.address, link
        sent = Sent(node, cid, answer)
        node.pending[cid] = answer  # before it leaves: the loop may be quicker with the answer than this thread
        if not link.send_at_once(frame(self.address, ASK, cid, self._sender, node.address, message)):
            sent.forget()
            return None
        return sent


class Sent:
    """An ask that has left, by ``Ref.ask_at_once``. What becomes of it is for the loop."""

    __slots__ = ("_answer", "_cid", "_node")

    def __init__(self, node: Home, cid: int, answer: Answer) -> None:
        self._node, self._cid, self._answer = node, cid, answer

    async def answer(self, deadline_s: float) -> Message | None:
        """Wait for it, as ``Ref.ask`` does. Raise ``AskTimeout`` or ``Unreachable``."""
        try:
            if not self._answer.done:
                self._node.deadlines.add(self._answer, deadline_s)
            return await self._answer.wait()
        finally:
            self.forget()

    def forget(self) -> None:
        self._node.pending.pop(self._cid, None)
