"""The mesh over zenoh: pub/sub inboxes with a correlation id (half the latency of query and reply).

Every node listens on its own unix socket and connects to those it is told of. Nothing here is cached or replayed.

Two traps shape this file. A subscriber with an ordinary Python callback owns a Python thread that keeps a
crashed process hanging, its liveliness token alive: ``Callback(indirect=False)`` has no such thread. And a
callback runs on zenoh's thread: it appends to a deque and writes an eventfd, nothing else.
"""

from __future__ import annotations

import contextlib
from collections import deque
from collections.abc import Sequence
from typing import Any

import msgspec
import trio
import zenoh

from .channel import Channel
from .frames import TELLS, frame
from .node import PREFIX, Node
from .zenoh_session import Waker, closed, config, opened, unix_endpoint

_WAKE_BATCH = 512
_PUBLISHERS = 32
"""Kept ready; of more addresses than that (askers come and go) the oldest is declared anew when needed."""
_TOGETHER_BYTES = 16 * 1024
"""Of tells in one frame."""


class ZenohMesh:
    """One session of one process. ``attach`` a node, then run ``run`` as long as the node lives."""

    def __init__(self, session: zenoh.Session) -> None:
        self.channel: Channel | None = None
        self._session = session
        self._inbox: deque[bytes] = deque()
        self._waiting: dict[tuple[str, str], list[msgspec.Raw]] = {}  # by receiver and sender
        self._waiting_bytes = 0
        self._flush_wanted = trio.Event()
        self._waker = Waker()
        self._publishers: dict[tuple[str, bool], zenoh.Publisher] = {}
        self._subscribers: dict[str, Any] = {}
        self._watched: dict[str, Any] = {}
        self._lost: deque[str] = deque()
        self.node: Node
        opened(self)

    @classmethod
    async def open(cls, listen: Sequence[str] = (), connect: Sequence[str] = ()) -> ZenohMesh:
        """Open a session (in a worker thread: it blocks for some 10 ms)."""
        return cls(await trio.to_thread.run_sync(zenoh.open, config(listen, connect)))

    def attach(self, node: Node) -> None:
        self.node = node
        node.mesh = self
        self.announce(node.address, True)
        for address in node.cells:
            self.announce(address, True)

    async def run(self, task_status: trio.TaskStatus[None] = trio.TASK_STATUS_IGNORED) -> None:
        """Carry frames from zenoh's thread into the node's loop, and those that wait for company out of it."""
        async with trio.open_nursery() as nursery:
            nursery.start_soon(self._flush_when_wanted)
            task_status.started()
            await self._receive()

    async def _receive(self) -> None:
        inbox, lost = self._inbox, self._lost
        while True:
            await self._waker.wait()
            with self.node.turn:
                for _ in range(min(len(inbox), _WAKE_BATCH)):
                    self.node.receive_frame(inbox.popleft(), self)
            while lost:
                self.node.lost(lost.popleft())
            if inbox:
                self._waker.wake()

    def close(self) -> None:
        """Close the session. Blocks for a few milliseconds."""
        closed(self)
        self._session.close()  # type: ignore[no-untyped-call]  # zenoh's stubs leave it open

    # -- the Way protocol

    def send(self, to: str, data: bytes, descriptors: tuple[int, ...] = ()) -> bool:
        try:
            publisher = self._publisher(to, True)
            if not _matching(publisher):
                return False
            if self._waiting:
                self._flush()  # first: what one sender says arrives in order
            publisher.put(data)
        except zenoh.ZError:
            return False  # no key at all (a peer names where its answer goes), or the session is closed
        return True

    def tell(self, to: str, sender: str, body: bytes) -> bool:
        """A put costs ten times a message: what is told in one turn leaves as one."""
        waiting = self._waiting.get((to, sender))
        if waiting is None:
            try:
                if not _matching(self._publisher(to, False)):
                    return False
            except zenoh.ZError:
                return False
            if not self._waiting and not self.node.turn.last(self._flush):
                self._flush_wanted.set()
            waiting = self._waiting[to, sender] = []
        waiting.append(msgspec.Raw(body))
        self._waiting_bytes += len(body)
        if self._waiting_bytes > _TOGETHER_BYTES:
            self._flush()
        return True

    def _flush(self) -> None:
        waiting, self._waiting, self._waiting_bytes = self._waiting, {}, 0
        for (to, sender), bodies in waiting.items():
            with contextlib.suppress(zenoh.ZError):  # the session is closed: who told them is ending
                self._publisher(to, False).put(frame(to, TELLS, 0, sender, self.node.address, bodies))

    async def _flush_when_wanted(self) -> None:
        while True:
            await self._flush_wanted.wait()
            self._flush_wanted = trio.Event()
            self._flush()

    def _publisher(self, to: str, prompt: bool) -> zenoh.Publisher:
        known = self._publishers.get((to, prompt))
        if known is not None:
            return known
        if "*" in to:
            raise zenoh.ZError(f"{to} is not one address")
        if len(self._publishers) >= _PUBLISHERS:
            self._publishers.pop(next(iter(self._publishers))).undeclare()  # type: ignore[no-untyped-call]
        # One priority, so that messages of one sender keep their order; asks, answers and stops leave at once
        # (express), other tells may share a batch. Not dropped when a queue is full: a stop is among them.
        publisher = self._publishers[to, prompt] = self._session.declare_publisher(
            to,
            congestion_control=zenoh.CongestionControl.BLOCK,
            priority=zenoh.Priority.REAL_TIME,
            express=prompt,
        )
        return publisher

    def send_at_once(self, data: bytes) -> bool:
        return False

    def announce(self, address: str, hosted: bool) -> None:
        if not hosted:
            for declared in self._subscribers.pop(address, ()):
                declared.undeclare()
        elif address not in self._subscribers:
            inbox = self._session.declare_subscriber(
                address, zenoh.handlers.Callback(self._on_sample, indirect=False)
            )
            token = self._session.liveliness().declare_token(f"{address}/alive")
            self._subscribers[address] = (inbox, token)

    def watch(self, address: str) -> None:
        if address in self._watched:
            return

        def on_change(sample: zenoh.Sample) -> None:
            if sample.kind == zenoh.SampleKind.DELETE:
                self._lost.append(address)
                self._waker.wake()

        self._watched[address] = self._session.liveliness().declare_subscriber(
            f"{address}/alive", zenoh.handlers.Callback(on_change, indirect=False)
        )

    # -- on zenoh's thread

    def _on_sample(self, sample: zenoh.Sample) -> None:
        self._inbox.append(sample.payload.to_bytes())
        self._waker.wake()


def _matching(publisher: zenoh.Publisher) -> bool:
    status: Any = publisher.matching_status  # the stubs say bool
    return bool(status.matching)


__all__ = ["PREFIX", "ZenohMesh", "config", "unix_endpoint"]
