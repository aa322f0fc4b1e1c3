"""Deliver messages to addresses: within this process, over a link, or over the mesh.

A message to an address of this process goes straight into the mailbox. Otherwise it leaves as a frame: over the
link (an inherited socket) whose other end announced the address, or else over the mesh. The semantics are the
same on every way: ``tell`` never waits, ``ask`` has a deadline, and ``watch`` is answered with ``Down``.

Trust. On a link the kernel guarantees which process is at the other end. On the mesh any process may claim any
address. So the mesh cannot announce addresses (``HOSTS``), addresses in ``linked`` are never reached over the
mesh, and an answer counts only on the way over which the request left.
"""

from __future__ import annotations

import itertools
import os
from collections import deque
from collections.abc import Iterable
from typing import Any

import msgspec

from strands_actors.kernel.refusals import Code

from .asks import Answer, Deadlines, went_away
from .clock import Clock
from .frames import ASK, DOWN, HOSTS, REPLY, TELL, WATCH, Down, Frame, decode_frame, frame, read_reply
from .inline_dispatch import InlineDispatch
from .instrument import Instrument
from .mailbox import ReplyTo
from .messages import MAX_MESSAGE_BYTES, Message, Refused
from .ref import PROMPT, Hosted, Ref
from .ways import Mesh, Way

PREFIX = "strands"


class DeadLetter(msgspec.Struct, frozen=True):
    to: str
    what: str
    why: str


class _RemoteReply:
    """The receiver of an answer in another process.

    The answer goes back over the way of the request. The requester also names an address for the answer, and
    could name one of another process.
    """

    __slots__ = ("_cid", "_node", "_to", "_way")

    def __init__(self, node: Router, way: Way, to: str, cid: int) -> None:
        self._node, self._way, self._to, self._cid = node, way, to, cid

    def send(self, answer: Message | None) -> None:
        data = frame(self._to, REPLY, self._cid, "", self._node.address, answer)
        self._way.send(self._to, data, getattr(answer, "descriptors", ()))


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
        self._links: set[Way] = set()
        self._routes: dict[str, Way] = {}
        self._watchers: dict[str, set[str]] = {}
        self._cids = itertools.count(1)
        self._prompt = itertools.count(1)

    # -- actors of this process

    def host(self, cell: Hosted) -> None:
        existing = self.cells.get(cell.address)
        if existing is not None and existing is not cell:
            raise ValueError(f"{cell.address} is already hosted here")
        if existing is None:
            self.cells[cell.address] = cell
            cell.hosted = True
            for way in self._ways():
                way.announce(cell.address, True)

    def unhost(self, cell: Hosted, reason: str) -> None:
        """End an incarnation. The address stays hosted, and its mailbox waits for the next one."""
        self._notify_down(cell.address, reason)

    def release(self, cell: Hosted) -> None:
        """Give up the address, and refuse the messages in its mailbox."""
        if self.cells.pop(cell.address, None) is None:
            return
        cell.hosted = False
        for way in self._ways():
            way.announce(cell.address, False)
        while (entry := cell.mailbox.pop()) is not None:
            message, reply = entry
            self.dead(cell.address, message, "the actor ended")
            if reply is not None:
                reply.send(Refused(Code.GONE, f"{cell.address} ended before it read this"))

    def ref(self, address: str, protocol: type[Any] | None = None, sender: str = "") -> Ref:
        return Ref(self, address, protocol, sender or self.address)

    def put(self, cell: Hosted, message: Message, reply: ReplyTo | None, sender: str) -> bool:
        """Put a message into the mailbox of an actor here. Return False if it was refused."""
        if type(message) not in cell.protocol.accepts:
            self._refuse(cell.address, message, cell.protocol.wrong_type(message), reply)
            return False
        if not cell.mailbox.put(message, reply, sender):
            full = Refused(Code.MAILBOX_FULL, f"{cell.address} has {len(cell.mailbox)} messages waiting", "wait")
            self._refuse(cell.address, message, full, reply)
            return False
        return True

    def put_local(self, cell: Hosted, message: Message, reply: ReplyTo | None, sender: str) -> None:
        """As ``put``, for a message of this process: its descriptors are duplicated, as on a link."""
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

    def is_turn(self) -> bool:
        """Return True for one in ``PROMPT`` answers that came without waiting: then other tasks must run."""
        return next(self._prompt) % PROMPT == 0

    def new_cid(self) -> int:
        return next(self._cids)

    def route(self, address: str) -> Way | None:
        """Return the link that leads to the address, or None."""
        return self._routes.get(address)

    def way_to(self, address: str) -> Way | None:
        """Return the link that leads to the address, or else the mesh."""
        link = self._routes.get(address)
        return link if link is not None or address in self.linked else self.mesh

    def attach(self, way: Way) -> None:
        """Use a new link, and announce the addresses of this node over it."""
        self._links.add(way)
        way.announce(self.address, True)
        for address in self.cells:
            way.announce(address, True)

    def learn(self, address: str, way: Way, hosted: bool) -> None:
        """Note that the other end of a link hosts ``address``, or no longer does."""
        if hosted:
            self._routes[address] = way
        elif self._routes.get(address) is way:
            del self._routes[address]
            self._lose(address, way)

    def detach(self, way: Way) -> None:
        """Forget a link that is down, with all addresses that it led to."""
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
        """Handle a frame from a link or a mesh.

        This never raises: a frame that cannot be read is refused and counted.
        """
        if not self._receive(data, way, descriptors):
            _close_all(descriptors)

    def _receive(self, data: bytes, way: Way, descriptors: tuple[int, ...]) -> bool:
        """Return True if an actor got the message, and the descriptors with it."""
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
        # Only a link may announce: on a mesh any process could claim any address.
        elif kind == HOSTS and way in self._links:
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
        refusal = Refused(
            Code.CHANNEL, f"{head.sender} does not speak over this channel", "speak for yourself alone"
        )
        self._refuse(head.to or self.address, head, refusal, reply)

    def _receive_message(
        self, head: Frame, body: msgspec.Raw, way: Way, size: int, descriptors: tuple[int, ...]
    ) -> bool:
        reply = _RemoteReply(self, way, head.reply_to, head.cid) if head.kind == ASK else None
        cell = self.cells.get(head.to)
        if cell is None:
            refusal = Refused(Code.UNKNOWN_ADDRESS, f"nobody hosts {head.to} here")
            self._refuse(head.to, head, refusal, reply)
            return False
        if size > MAX_MESSAGE_BYTES:
            self._refuse(head.to, head, _oversized(size), reply)
            return False
        try:
            message = cell.protocol.decode(body)
        except (msgspec.MsgspecError, RecursionError, UnicodeDecodeError) as error:
            accepted = ", ".join(sorted(kind.__name__ for kind in cell.protocol.accepts))
            refusal = Refused(Code.MALFORMED, f"{cell.protocol.name} cannot read this: {error}", f"send {accepted}")
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
        # The numbers in the body are descriptors of the sender. Only those that came with the frame are valid
        # here.
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
        if self.mesh is not None and self.way_to(address) is self.mesh:
            self._lose(address, self.mesh)

    def _lose(self, address: str, way: Way) -> None:
        self._notify_down(address, "unreachable")
        for answer in self.pending.values():
            if answer.to == address and answer.way is way:
                answer.fail(went_away(address))

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
    return Refused(Code.OVERSIZED, f"{size} bytes", f"send at most {limit}", str(size), str(limit))


def _close_all(descriptors: Iterable[int]) -> None:
    for fd in descriptors:
        os.close(fd)
