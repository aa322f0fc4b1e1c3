"""A node: the actors of one process, and the ways out of it.

A message to an address of this node goes straight into the mailbox. Otherwise it leaves as a frame: over
the link (inherited socket) whose other end announced the address, else over the mesh. Semantics are the
same on every way: ``tell`` never waits, ``ask`` has a deadline, ``watch`` answers with ``Down``.
"""

from __future__ import annotations

import itertools
import os
import threading
from collections import deque
from collections.abc import Callable, Iterable
from typing import Protocol as TypingProtocol
from typing import TypeVar

import msgspec
import trio

from .actor import Actor, Cell
from .asks import Answer, AskTimeout, Deadlines, Unreachable
from .channels.permissions import Channel
from .clock import Clock
from .frames import (
    ASK,
    DOWN,
    HOSTS,
    REPLY,
    TELL,
    WATCH,
    Down,
    Frame,
    Protocol,
    decode_frame,
    frame,
    protocol_of,
    read_reply,
)
from .inline_dispatch import InlineDispatch
from .instrument import Instrument
from .mailbox import ReplyTo
from .messages import MAX_MESSAGE_BYTES, Message, Refused

__all__ = [
    "PREFIX",
    "PROMPT",
    "ActorRef",
    "Answer",
    "AskTimeout",
    "DeadLetter",
    "Mesh",
    "Node",
    "Ref",
    "Sent",
    "Unreachable",
    "Way",
]

PREFIX = "strands"
PROMPT = 32
"""Answers that were there at once before an asker lets other tasks run all the same."""


class Way(TypingProtocol):
    """A link or a mesh: carries frames between nodes."""

    channel: Channel | None
    """What may be said over it; None: everything."""

    def send(self, to: str, data: bytes, descriptors: tuple[int, ...] = (), urgent: bool = False) -> bool:
        """Send without waiting; False when nobody there hosts ``to``. The sender keeps its descriptors, the
        receiver gets duplicates; a way between processes that is no link delivers none. ``urgent``: it may overtake
        what is not."""
        ...

    def send_at_once(self, data: bytes) -> bool:
        """From any thread: whole, or not at all. Only a link can, and only when nothing waits to be sent there."""
        ...

    def announce(self, address: str, hosted: bool) -> None: ...

    def watch(self, address: str) -> None:
        """Call ``node.lost(address)`` when the node that hosts it is gone."""
        ...


class Mesh(Way, TypingProtocol):
    def ask(
        self,
        to: str,
        sender: str,
        message: Message,
        decode: Callable[[msgspec.Raw], Message | None],
        deadline_s: float,
    ) -> Message | None:
        """Send and wait for the answer in the thread that calls."""
        ...

    def forget(self, to: str, why: str) -> None:
        """Nobody ``ask``s there any more; who waits is told why."""
        ...


class DeadLetter(msgspec.Struct, frozen=True):
    to: str
    what: str
    why: str


class _RemoteReply:
    """Over the way by which it was asked: whoever asks names where the answer goes, and could name another."""

    __slots__ = ("_cid", "_node", "_to", "_way")

    def __init__(self, node: Node, way: Way, to: str, cid: int) -> None:
        self._node, self._way, self._to, self._cid = node, way, to, cid

    def send(self, answer: Message | None) -> None:
        data = frame(self._to, REPLY, self._cid, "", self._node.address, answer)
        self._way.send(self._to, data, getattr(answer, "descriptors", ()))


M = TypeVar("M", bound=Message)


class ActorRef(TypingProtocol):
    """What can be asked and told. ``Ref`` says what each does."""

    address: str

    def tell(self, message: Message) -> None: ...

    async def ask(self, message: Message, deadline_s: float) -> Message | None: ...

    def ask_here(self, message: Message, deadline_s: float) -> Message | None: ...


class Ref:
    """A way to reach one actor. Cheap; make as many as you like."""

    __slots__ = ("_cell", "_node", "_protocol", "_sender", "address")

    def __init__(self, node: Node, address: str, protocol: type[Actor] | None, sender: str) -> None:
        self.address = address
        self._node = node
        self._protocol: Protocol | None = None if protocol is None else protocol_of(protocol)
        self._sender = sender
        self._cell: Cell | None = None

    def _local(self) -> Cell | None:
        """The cell, if it is one of this node's."""
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
        """Send and wait for the answer. Raise ``AskTimeout`` or ``Unreachable``; a refusal is an answer."""
        node = self._node
        answer = Answer(self._protocol.decode_reply if self._protocol else None)
        cell = self._local()
        if cell is not None:
            with node.dispatch:
                if type(message) not in cell.plain or not cell.mailbox.put(message, answer, self._sender):
                    node.put_local(cell, message, answer, self._sender)
            if not answer.done:
                node.deadlines.add(answer, deadline_s)
            elif next(node.prompt) % PROMPT == 0:
                await trio.lowlevel.checkpoint()
            return await answer.wait()
        cid = node.new_cid()
        answer.way = node.way_to(self.address)
        node.pending[cid] = answer
        try:
            if not node.send_frame(self.address, ASK, cid, self._sender, message):
                raise Unreachable(f"nobody hosts {self.address}")
            if not answer.done:
                node.deadlines.add(answer, deadline_s)
            return await answer.wait()
        finally:
            node.pending.pop(cid, None)

    def ask_here(self, message: Message, deadline_s: float) -> Message | None:
        """As ``ask``, of an actor of another process that is on the mesh: from any thread but the loop's, which it
        would hold up. The loop has no part in it."""
        mesh, protocol = self._node.mesh, self._protocol
        if mesh is None or protocol is None:
            raise Unreachable(f"nobody hosts {self.address}")
        sender = f"{self._sender}/thread-{threading.get_ident()}"  # of each the newest setpoint waits, not of all
        return mesh.ask(self.address, sender, message, protocol.decode_reply, deadline_s)

    def ask_at_once(self, message: Message) -> Sent | None:
        """From any thread, without its loop: send over a link to the process of the actor. None: there is none, or
        it has something to send before, and nothing was sent."""
        node = self._node
        link = node.route(self.address)
        if link is None:
            return None
        cid, answer = node.new_cid(), Answer(self._protocol.decode_reply if self._protocol else None)
        answer.way = link
        sent = Sent(node, cid, answer)
        node.pending[cid] = answer  # before it leaves: the loop may be quicker with the answer than this thread
        if not link.send_at_once(frame(self.address, ASK, cid, self._sender, node.address, message)):
            sent.forget()
            return None
        return sent


class Sent:
    """An ask that has left, by ``Ref.ask_at_once``. What becomes of it is for the loop."""

    __slots__ = ("_answer", "_cid", "_node")

    def __init__(self, node: Node, cid: int, answer: Answer) -> None:
        self._node, self._cid, self._answer = node, cid, answer

    async def answer(self, deadline_s: float) -> Message | None:
        """Wait for it, as ``Ref.ask`` does. Raise ``AskTimeout``."""
        try:
            if not self._answer.done:
                self._node.deadlines.add(self._answer, deadline_s)
            return await self._answer.wait()
        finally:
            self.forget()

    def forget(self) -> None:
        self._node.pending.pop(self._cid, None)


class Node:
    """The actors of one process. Enter with ``async with open_nursery() as n: await n.start(node.run)``."""

    def __init__(self, name: str, clock: Clock, mesh: Mesh | None = None) -> None:
        self.name = name
        self.address = f"{PREFIX}/node/{name}"
        self.clock = clock
        self.mesh = mesh
        self.dispatch = InlineDispatch(clock)
        self.cells: dict[str, Cell] = {}
        self.pending: dict[int, Answer] = {}
        self.deadlines = Deadlines()
        self.dead_letters: deque[DeadLetter] = deque(maxlen=256)
        self.dead_letter_count = 0
        self.refused_count = 0
        self.instrument: Instrument | None = None
        """Told what the actors of this node do, while somebody records them."""
        self.linked: frozenset[str] = frozenset()
        """Addresses that are reached by a link or not at all: on a mesh anybody could claim them."""
        self._links: set[Way] = set()
        self._routes: dict[str, Way] = {}
        self._watchers: dict[str, set[str]] = {}
        self._cids = itertools.count(1)
        self.prompt = itertools.count(1)

    async def run(self, task_status: trio.TaskStatus[None] = trio.TASK_STATUS_IGNORED) -> None:
        """Serve deadlines; runs as long as the node."""
        task_status.started()
        await self.deadlines.run()

    # -- actors of this node

    def cell(self, path: str, factory: Callable[[], Actor], role: str = "") -> Cell:
        """A cell not yet running; give its ``run`` to a supervisor. ``path`` is ``<robot>/actor/<name>``."""
        return Cell(self, f"{PREFIX}/{path}", factory, role)

    def host(self, cell: Cell) -> None:
        known = self.cells.get(cell.address)
        if known is not None and known is not cell:
            raise ValueError(f"{cell.address} is already hosted here")
        if known is None:
            self.cells[cell.address] = cell
            cell.hosted = True
            for way in self._ways():
                way.announce(cell.address, True)

    def unhost(self, cell: Cell, reason: str) -> None:
        """An incarnation ended; the address stays hosted, its mailbox waits for the next."""
        self._notify_down(cell.address, reason)

    def release(self, cell: Cell) -> None:
        """The address is given up: what waits in the mailbox is refused."""
        if self.cells.pop(cell.address, None) is None:
            return
        cell.hosted = False
        for way in self._ways():
            way.announce(cell.address, False)
        while (entry := cell.mailbox.pop()) is not None:
            message, reply = entry
            self.dead(cell.address, message, "the actor ended")
            if reply is not None:
                reply.send(Refused("gone", f"{cell.address} ended before it read this"))

    def ref(self, address: str, protocol: type[Actor] | None = None, sender: str = "") -> Ref:
        return Ref(self, address, protocol, sender or self.address)

    def put(self, cell: Cell, message: Message, reply: ReplyTo | None, sender: str) -> bool:
        """Into the mailbox; False when it was refused."""
        if type(message) not in cell.protocol.accepts:
            self._refuse(cell.address, message, cell.protocol.wrong_type(message), reply)
            return False
        if not cell.mailbox.put(message, reply, sender):
            full = Refused("mailbox_full", f"{cell.address} has {len(cell.mailbox)} messages waiting", "wait")
            self._refuse(cell.address, message, full, reply)
            return False
        return True

    def put_local(self, cell: Cell, message: Message, reply: ReplyTo | None, sender: str) -> None:
        """As ``put``, from this process: descriptors are duplicated, as on a link."""
        if type(message) in cell.protocol.carriers:
            own = tuple(os.dup(fd) for fd in message.descriptors)  # type: ignore[attr-defined]
            if not self.put(cell, msgspec.structs.replace(message, descriptors=own), reply, sender):
                _close_all(own)
        else:
            self.put(cell, message, reply, sender)

    def dead(self, to: str, what: object, why: str) -> None:
        self.dead_letter_count += 1
        self.dead_letters.append(DeadLetter(to, type(what).__name__, why))

    def _refuse(self, to: str, what: object, refusal: Refused, reply: ReplyTo | None) -> None:
        self.refused_count += 1
        self.dead(to, what, refusal.reason)
        if self.instrument is not None:
            self.instrument.refused(to, type(what).__name__, refusal)
        if reply is not None:
            reply.send(refusal)

    # -- ways out

    def new_cid(self) -> int:
        return next(self._cids)

    def route(self, address: str) -> Way | None:
        """The link behind which it lives."""
        return self._routes.get(address)

    def way_to(self, address: str) -> Way | None:
        """The link behind which it lives, or else the mesh."""
        link = self._routes.get(address)
        return link if link is not None or address in self.linked else self.mesh

    def attach(self, way: Way) -> None:
        """A link came up: tell its other end what lives here."""
        self._links.add(way)
        way.announce(self.address, True)
        for address in self.cells:
            way.announce(address, True)

    def learn(self, address: str, way: Way, hosted: bool) -> None:
        """The other end of a link hosts ``address`` (or no longer does)."""
        if hosted:
            self._routes[address] = way
        elif self._routes.get(address) is way:
            del self._routes[address]
            self.lost(address)

    def detach(self, way: Way) -> None:
        """A link went down: everything behind it is gone."""
        self._links.discard(way)
        for address in [known for known, route in self._routes.items() if route is way]:
            self.learn(address, way, False)

    def _ways(self) -> set[Way]:
        return self._links if self.mesh is None else {*self._links, self.mesh}

    def send_frame(self, to: str, kind: int, cid: int, sender: str, body: Message | None) -> bool:
        way = self.way_to(to)
        if way is None:
            return False
        descriptors: tuple[int, ...] = getattr(body, "descriptors", ())
        data = frame(to, kind, cid, sender, self.address, body)
        if len(data) > MAX_MESSAGE_BYTES and kind in (TELL, ASK):
            self._refuse(to, body, _oversized(len(data)), self.pending.get(cid))
            return True
        return way.send(to, data, descriptors, body is not None and body.lane == "urgent" and kind in (TELL, ASK))

    def receive_frame(self, data: bytes, way: Way, descriptors: tuple[int, ...] = ()) -> None:
        """Bytes from a link or a mesh. Never raises: what cannot be read is refused and counted."""
        if not self._receive(data, way, descriptors):
            _close_all(descriptors)

    def _receive(self, data: bytes, way: Way, descriptors: tuple[int, ...]) -> bool:
        """Whether an actor got a message, and with it the descriptors."""
        try:
            head = decode_frame(data)
        except (msgspec.MsgspecError, RecursionError, UnicodeDecodeError) as error:
            self.refused_count += 1
            self.dead(self.address, data, f"not a frame: {error}")
            return False
        kind, channel = head.kind, way.channel
        if channel is not None and kind != REPLY and not channel.speaks_for(head.sender):
            self._refuse_sender(head, way)
            return False
        if kind in (TELL, ASK):
            return self._receive_message(head, head.body, way, len(data), descriptors)
        if kind == REPLY:
            self._receive_reply(head, way)
        elif kind == HOSTS and way in self._links:  # on a mesh anybody could claim anything
            self.learn(head.sender, way, head.cid == 1)
        elif kind == WATCH:
            self._watchers.setdefault(head.to, set()).add(head.sender)
            if head.to not in self.cells:
                self._notify_down(head.to, "not hosted here")
        elif kind == DOWN:
            self._deliver_down(head, way)
        else:
            self.refused_count += 1
            self.dead(head.to, head, f"unknown frame kind {kind}")
        return False

    def _refuse_sender(self, head: Frame, way: Way) -> None:
        reply = _RemoteReply(self, way, head.reply_to, head.cid) if head.kind == ASK else None
        refusal = Refused("channel", f"{head.sender} does not speak over this channel", "speak for yourself alone")
        self._refuse(head.to or self.address, head, refusal, reply)

    def _receive_message(
        self, head: Frame, body: msgspec.Raw, way: Way, size: int, descriptors: tuple[int, ...]
    ) -> bool:
        reply = _RemoteReply(self, way, head.reply_to, head.cid) if head.kind == ASK else None
        cell = self.cells.get(head.to)
        if cell is None:
            refusal = Refused("unknown_address", f"nobody hosts {head.to} here")
            self._refuse(head.to, head, refusal, reply)
            return False
        if size > MAX_MESSAGE_BYTES:
            self._refuse(head.to, head, _oversized(size), reply)
            return False
        try:
            message = cell.protocol.decode(body)
        except (msgspec.MsgspecError, RecursionError, UnicodeDecodeError) as error:
            accepted = ", ".join(sorted(kind.__name__ for kind in cell.protocol.accepts))
            refusal = Refused("malformed", f"{cell.protocol.name} cannot read this: {error}", f"send {accepted}")
            self._refuse(head.to, head, refusal, reply)
            return False
        channel = way.channel
        if channel is not None and (refused := channel.refuse(head.to, message)) is not None:
            self._refuse(head.to, message, refused, reply)
            return False
        if type(message) in cell.protocol.stamped:
            name = "" if channel is None else channel.name
            if message.channel != name:  # type: ignore[attr-defined]
                message = msgspec.structs.replace(message, channel=name)
        if type(message) not in cell.protocol.carriers:
            self.put(cell, message, reply, head.sender)
            return False
        # The numbers in the body are the sender's; only what came with the frame is ours.
        message = msgspec.structs.replace(message, descriptors=descriptors)
        return self.put(cell, message, reply, head.sender)

    def _receive_reply(self, head: Frame, way: Way) -> None:
        answer = self.pending.get(head.cid)
        if answer is None or answer.done:
            self.dead(head.to, head, "the asker no longer waits")
            return
        if answer.way is not way:
            self.refused_count += 1
            self.dead(head.to, head, "an answer from elsewhere than where it was asked")
            return
        del self.pending[head.cid]
        answer.send(None if answer.decode is None else read_reply(answer.decode, head.body))

    def hosts_frame(self, address: str, hosted: bool) -> bytes:
        """What a link tells its other end: ``address`` lives here, or no longer does."""
        return frame("", HOSTS, int(hosted), address, self.address, None)

    # -- watching

    def watch(self, address: str, watcher: str) -> None:
        self._watchers.setdefault(address, set()).add(watcher)
        if address in self.cells:
            return
        if (way := self.way_to(address)) is not None:
            way.watch(address)  # first: what ends between the two is then seen by one of them
        if not self.send_frame(address, WATCH, 0, watcher, None):
            self._notify_down(address, "nobody hosts it")

    def lost(self, address: str) -> None:
        """The node that hosted ``address`` cannot be reached any more."""
        self._notify_down(address, "unreachable")

    def _notify_down(self, address: str, reason: str) -> None:
        for watcher in self._watchers.pop(address, ()):
            down = Down(address, reason)
            cell = self.cells.get(watcher)
            if cell is not None:
                self.put(cell, down, None, address)
            else:
                self.send_frame(watcher, DOWN, 0, address, down)

    def _deliver_down(self, head: Frame, way: Way) -> None:
        watchers = self._watchers.get(head.sender)
        if watchers is not None and head.to in watchers:
            watchers.discard(head.to)
            tell = Frame(head.to, TELL, 0, head.sender, head.reply_to, head.body)
            self._receive_message(tell, head.body, way, len(head.body), ())


def _oversized(size: int) -> Refused:
    limit = MAX_MESSAGE_BYTES
    return Refused("oversized", f"{size} bytes", f"send at most {limit}", str(size), str(limit))


def _close_all(descriptors: Iterable[int]) -> None:
    for fd in descriptors:
        os.close(fd)
