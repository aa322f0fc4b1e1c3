"""Deliver messages to addresses: within this process, over a link, or over the mesh.

A message to an address of this process goes straight into the mailbox. Otherwise it leaves as a frame: over the
link (an inherited socket) whose other end announced the address, or else over the mesh. The semantics are the
same in each case: ``tell`` never waits, ``ask`` has a deadline, and ``watch`` is answered with ``Down``.

Trust. On a link the kernel guarantees which process is at the other end. On the mesh any process may claim any
address. So announcements of addresses (``HOSTS``) are accepted only over links. Addresses in ``linked`` are
never reached over the mesh. An answer counts only if it comes over the same link or mesh as its request left.
"""

from __future__ import annotations

import itertools
import os
from collections import deque
from collections.abc import Iterable
from typing import Any

import msgspec

from . import refusals
from .asks import Answer, Deadlines, went_away
from .clock import Clock
from .frames import ASK, DOWN, HOSTS, REPLY, TELL, WATCH, Down, Frame, decode_frame, frame, read_reply
from .inline_dispatch import InlineDispatch
from .instrument import Instrument
from .mailbox import ReplyTo
from .messages import MAX_MESSAGE_BYTES, Message, Refused
from .ref import PROMPT, Hosted, Ref
from .ways import Connection, Mesh

PREFIX = "strands"


class DeadLetter(msgspec.Struct, frozen=True):
    to: str
    message_type: str
    reason: str


class _RemoteReply:
    """The receiver of an answer in another process.

    The answer takes the link or mesh over which the request came. The request also names an address for the
    answer, but it could be the address of another process.
    """

    __slots__ = ("_cid", "_connection", "_node", "_to")

    def __init__(self, node: Router, connection: Connection, to: str, cid: int) -> None:
        self._node, self._connection, self._to, self._cid = node, connection, to, cid

    def send(self, answer: Message | None) -> None:
        data = frame(self._to, REPLY, self._cid, "", self._node.address, answer)
        self._connection.send(self._to, data, getattr(answer, "descriptors", ()))


class Router:
    """The addresses that a process can reach, and the actors that it hosts."""

    def __init__(self, name: str, clock: Clock, mesh: Mesh | None = None) -> None:
        self.name = name
        self.address = f"{PREFIX}/node/{name}"
        self.clock = clock
        self.mesh = mesh
        self.dispatch = InlineDispatch(clock)
        self.cells: dict[str, Hosted] = {}
        self.pending: dict[int, Answer] = {}
        self.deadlines = Deadlines()
        self.dead_letters: deque[DeadLetter] = deque(maxlen=256)
        self.dead_letter_count = 0
        self.refused_count = 0
        self.instrument: Instrument | None = None
        """The recorder of this node's actors, if there is one."""
        self.linked: frozenset[str] = frozenset()
        """Addresses that are reached over a link or not at all. On a mesh any process could claim them."""
        self._links: set[Connection] = set()
        self._routes: dict[str, Connection] = {}
        self._watchers: dict[str, set[str]] = {}
        self._cids = itertools.count(1)
        self._prompt = itertools.count(1)

    # -- the actors of this process

    def host(self, cell: Hosted) -> None:
        existing = self.cells.get(cell.address)
        if existing is not None and existing is not cell:
            raise ValueError(f"{cell.address} is already hosted here")
        if existing is None:
            self.cells[cell.address] = cell
            cell.hosted = True
            for connection in self._connections():
                connection.announce(cell.address, True)

    def unhost(self, cell: Hosted, reason: str) -> None:
        """Note that an incarnation (one start) of an actor has ended.

        The address stays hosted. Its mailbox keeps messages for the next incarnation.
        """
        self._notify_down(cell.address, reason)

    def release(self, cell: Hosted) -> None:
        """Give up the address, and refuse the messages in its mailbox."""
        if self.cells.pop(cell.address, None) is None:
            return
        cell.hosted = False
        for connection in self._connections():
            connection.announce(cell.address, False)
        while (entry := cell.mailbox.pop()) is not None:
            message, reply = entry
            self.dead(cell.address, message, "the actor ended")
            if reply is not None:
                reply.send(refusals.actor_ended(cell.address))

    def ref(self, address: str, protocol: type[Any] | None = None, sender: str = "") -> Ref:
        return Ref(self, address, protocol, sender or self.address)

    def put(self, cell: Hosted, message: Message, reply: ReplyTo | None, sender: str) -> bool:
        """Put a message into the mailbox of an actor of this process. Return False if it was refused."""
        if type(message) not in cell.protocol.accepts:
            self._refuse(cell.address, message, cell.protocol.wrong_type(message), reply)
            return False
        if not cell.mailbox.put(message, reply, sender):
            full = refusals.mailbox_full(cell.address, len(cell.mailbox))
            self._refuse(cell.address, message, full, reply)
            return False
        return True

    def put_local(self, cell: Hosted, message: Message, reply: ReplyTo | None, sender: str) -> None:
        """Put a message of this process into a mailbox, as ``put`` does.

        The descriptors of the message are duplicated, as on a link.
        """
        if type(message) in cell.protocol.carriers:
            own = tuple(os.dup(fd) for fd in message.descriptors)  # type: ignore[attr-defined]
            if not self.put(cell, msgspec.structs.replace(message, descriptors=own), reply, sender):
                _close_all(own)
        else:
            self.put(cell, message, reply, sender)

    def dead(self, to: str, subject: object, reason: str) -> None:
        self.dead_letter_count += 1
        self.dead_letters.append(DeadLetter(to, type(subject).__name__, reason))

    def _refuse(self, to: str, subject: object, refusal: Refused, reply: ReplyTo | None) -> None:
        self.refused_count += 1
        self.dead(to, subject, refusal.reason)
        if self.instrument is not None:
            self.instrument.refused(to, type(subject).__name__, refusal)
        if reply is not None:
            reply.send(refusal)

    # -- outgoing frames

    def is_turn(self) -> bool:
        """Return True for every ``PROMPT``-th answer that came without waiting.

        The sender must then let other tasks run once.
        """
        return next(self._prompt) % PROMPT == 0

    def new_cid(self) -> int:
        return next(self._cids)

    def route(self, address: str) -> Connection | None:
        """Return the link that leads to the address, or None."""
        return self._routes.get(address)

    def connection_to(self, address: str) -> Connection | None:
        """Return the link that leads to the address. Without such a link, return the mesh.

        Addresses in ``linked`` are never reached over the mesh. For them the result is then None.
        """
        link = self._routes.get(address)
        return link if link is not None or address in self.linked else self.mesh

    def attach(self, connection: Connection) -> None:
        """Use a new link, and announce the addresses of this node over it."""
        self._links.add(connection)
        connection.announce(self.address, True)
        for address in self.cells:
            connection.announce(address, True)

    def learn(self, address: str, connection: Connection, hosted: bool) -> None:
        """Note that the other end of a link hosts ``address``, or no longer does."""
        if hosted:
            self._routes[address] = connection
        elif self._routes.get(address) is connection:
            del self._routes[address]
            self._lose(address, connection)

    def detach(self, connection: Connection) -> None:
        """Forget a link that has ended, with all addresses that were reached over it."""
        self._links.discard(connection)
        for address in [routed for routed, route in self._routes.items() if route is connection]:
            self.learn(address, connection, False)

    def _connections(self) -> set[Connection]:
        return self._links if self.mesh is None else {*self._links, self.mesh}

    def send_frame(self, to: str, kind: int, cid: int, sender: str, body: Message | None) -> bool:
        connection = self.connection_to(to)
        if connection is None:
            return False
        descriptors: tuple[int, ...] = getattr(body, "descriptors", ())
        data = frame(to, kind, cid, sender, self.address, body)
        if len(data) > MAX_MESSAGE_BYTES and kind in (TELL, ASK):
            self._refuse(to, body, refusals.oversized(len(data)), self.pending.get(cid))
            return True
        return connection.send(
            to, data, descriptors, body is not None and body.lane == "urgent" and kind in (TELL, ASK)
        )

    def receive_frame(self, data: bytes, connection: Connection, descriptors: tuple[int, ...] = ()) -> None:
        """Handle a frame from a link or a mesh.

        This never raises: a frame that cannot be read is refused and counted.
        """
        if not self._receive(data, connection, descriptors):
            _close_all(descriptors)

    def _receive(self, data: bytes, connection: Connection, descriptors: tuple[int, ...]) -> bool:
        """Handle a frame. Return True if an actor got its message, with the descriptors of the frame."""
        try:
            head = decode_frame(data)
        except (msgspec.MsgspecError, RecursionError, UnicodeDecodeError) as error:
            self.refused_count += 1
            self.dead(self.address, data, f"not a frame: {error}")
            return False
        kind, channel = head.kind, connection.channel
        if channel is not None and kind != REPLY and not channel.speaks_for(head.sender):
            self._refuse_sender(head, connection)
            return False
        if kind in (TELL, ASK):
            return self._receive_message(head, head.body, connection, len(data), descriptors)
        if kind == REPLY:
            self._receive_reply(head, connection)
        # Only a link may announce: on a mesh any process could claim any address.
        elif kind == HOSTS and connection in self._links:
            self.learn(head.sender, connection, head.cid == 1)
        elif kind == WATCH:
            self._watchers.setdefault(head.to, set()).add(head.sender)
            if head.to not in self.cells:
                self._notify_down(head.to, "not hosted here")
        elif kind == DOWN:
            self._deliver_down(head, connection)
        else:
            self.refused_count += 1
            self.dead(head.to, head, f"unknown frame kind {kind}")
        return False

    def _refuse_sender(self, head: Frame, connection: Connection) -> None:
        reply = _RemoteReply(self, connection, head.reply_to, head.cid) if head.kind == ASK else None
        self._refuse(head.to or self.address, head, refusals.foreign_sender(head.sender), reply)

    def _receive_message(
        self, head: Frame, body: msgspec.Raw, connection: Connection, size: int, descriptors: tuple[int, ...]
    ) -> bool:
        reply = _RemoteReply(self, connection, head.reply_to, head.cid) if head.kind == ASK else None
        cell = self.cells.get(head.to)
        if cell is None:
            self._refuse(head.to, head, refusals.unknown_address(head.to), reply)
            return False
        if size > MAX_MESSAGE_BYTES:
            self._refuse(head.to, head, refusals.oversized(size), reply)
            return False
        try:
            message = cell.protocol.decode(body)
        except (msgspec.MsgspecError, RecursionError, UnicodeDecodeError) as error:
            accepted = ", ".join(sorted(message_type.__name__ for message_type in cell.protocol.accepts))
            self._refuse(head.to, head, refusals.malformed(cell.protocol.name, error, accepted), reply)
            return False
        channel = connection.channel
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
        # The descriptor numbers in the body are those of the sender. Only the descriptors that came with the
        # frame are valid here.
        message = msgspec.structs.replace(message, descriptors=descriptors)
        return self.put(cell, message, reply, head.sender)

    def _receive_reply(self, head: Frame, connection: Connection) -> None:
        answer = self.pending.get(head.cid)
        if answer is None or answer.done:
            self.dead(head.to, head, "the asker no longer waits")
            return
        if answer.connection is not connection:
            self.refused_count += 1
            self.dead(head.to, head, "an answer from elsewhere than where it was asked")
            return
        del self.pending[head.cid]
        answer.send(None if answer.decode is None else read_reply(answer.decode, head.body))

    def hosts_frame(self, address: str, hosted: bool) -> bytes:
        """Return the frame by which a link announces that ``address`` is hosted here, or no longer."""
        return frame("", HOSTS, int(hosted), address, self.address, None)

    # -- watching

    def watch(self, address: str, watcher: str) -> None:
        self._watchers.setdefault(address, set()).add(watcher)
        if address in self.cells:
            return
        if not self.send_frame(address, WATCH, 0, watcher, None):
            self._notify_down(address, "nobody hosts it")

    def lost(self, address: str) -> None:
        """Note that the node that hosted ``address`` has left the mesh."""
        if self.mesh is not None and self.connection_to(address) is self.mesh:
            self._lose(address, self.mesh)

    def _lose(self, address: str, connection: Connection) -> None:
        self._notify_down(address, "unreachable")
        for answer in self.pending.values():
            if answer.to == address and answer.connection is connection:
                answer.fail(went_away(address))

    def _notify_down(self, address: str, reason: str) -> None:
        for watcher in self._watchers.pop(address, ()):
            down = Down(address, reason)
            cell = self.cells.get(watcher)
            if cell is not None:
                self.put(cell, down, None, address)
            else:
                self.send_frame(watcher, DOWN, 0, address, down)

    def _deliver_down(self, head: Frame, connection: Connection) -> None:
        watchers = self._watchers.get(head.sender)
        if watchers is not None and head.to in watchers:
            watchers.discard(head.to)
            tell = Frame(head.to, TELL, 0, head.sender, head.reply_to, head.body)
            self._receive_message(tell, head.body, connection, len(head.body), ())


def _close_all(descriptors: Iterable[int]) -> None:
    for fd in descriptors:
        os.close(fd)
