"""The mesh over zenoh: pub/sub inboxes with a correlation id (half the latency of query and reply).

Loopback only: unix sockets in a directory of the user's own, no multicast, no gossip. Every node listens
on its own socket and connects to those it is told of. Nothing on a command key is cached or replayed.

Two traps shape this file. A subscriber with an ordinary Python callback owns a Python thread that keeps a
crashed process hanging, its liveliness token alive: ``Callback(indirect=False)`` has no such thread. And a
callback runs on zenoh's thread: it appends to a deque and writes an eventfd, nothing else.
"""

from __future__ import annotations

import atexit
import json
import os
from collections import deque
from collections.abc import Sequence
from typing import Any

import trio
import zenoh

from .node import PREFIX, Node

LEASE_MS = 1000
"""Of the transport: a frozen peer is dropped after this long (zenoh's default is 10 s)."""

_WAKE_BATCH = 512
_PUBLISHERS = 256
"""Kept ready; of more addresses than that (askers come and go) the oldest is declared anew when needed."""


def config(listen: Sequence[str] = (), connect: Sequence[str] = ()) -> zenoh.Config:
    """A closed peer: only these endpoints, retried quickly when they go away."""
    result = zenoh.Config()
    for key, value in {
        "mode": "peer",
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": False,
        "listen/endpoints": list(listen),
        "connect/endpoints": list(connect),
        "connect/timeout_ms": -1,
        "connect/exit_on_failure": False,
        "connect/retry": {"period_init_ms": 20, "period_max_ms": 200, "period_increase_factor": 1.5},
        # A frozen peer takes the connection and says nothing; close() would wait for it (zenoh: 10 s).
        "transport/unicast/open_timeout": LEASE_MS,
        "transport/link/tx/lease": LEASE_MS,
        "transport/link/tx/keep_alive": 4,
        # A peer that reads nothing (frozen) may hold a sender up this long, in us; then it is cut off.
        "transport/link/tx/queue/congestion_control/block/wait_before_close": 100_000,
        "transport/shared_memory/enabled": False,
    }.items():
        result.insert_json5(key, json.dumps(value))
    return result


def unix_endpoint(path: str) -> str:
    return f"unixsock-stream/{path}"


class ZenohMesh:
    """One session of one process. ``attach`` a node, then run ``run`` as long as the node lives."""

    def __init__(self, session: zenoh.Session) -> None:
        self._session = session
        self._pid = os.getpid()
        self._inbox: deque[bytes] = deque()
        self._wake_pending = False
        self._read_fd, self._write_fd = _wake_pair()
        self._publishers: dict[tuple[str, bool], zenoh.Publisher] = {}
        self._subscribers: dict[str, Any] = {}
        self._watched: dict[str, Any] = {}
        self._lost: deque[str] = deque()
        self.node: Node
        _open.add(self)

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
        """Carry frames from zenoh's thread into the node's loop."""
        task_status.started()
        inbox, lost = self._inbox, self._lost
        while True:
            await trio.lowlevel.wait_readable(self._read_fd)
            # Read, then clear the flag, then drain: in any other order a wake-up can be lost.
            os.read(self._read_fd, 8)
            self._wake_pending = False
            for _ in range(min(len(inbox), _WAKE_BATCH)):
                self.node.receive_frame(inbox.popleft(), self)
            while lost:
                self.node.lost(lost.popleft())
            if inbox:
                self._wake()

    def close(self) -> None:
        """Close the session. Blocks for a few milliseconds."""
        _open.discard(self)
        self._session.close()  # type: ignore[no-untyped-call]  # zenoh's stubs leave it open

    # -- the Way protocol

    def send(self, to: str, data: bytes, descriptors: tuple[int, ...] = (), prompt: bool = True) -> bool:
        try:
            publisher = self._publishers.get((to, prompt)) or self._publisher(to, prompt)
            status: Any = publisher.matching_status  # the stubs say bool
            if not status.matching:
                return False
            publisher.put(data)
        except zenoh.ZError:
            return False  # no key at all (a peer names where its answer goes), or the session is closed
        return True

    def _publisher(self, to: str, prompt: bool) -> zenoh.Publisher:
        if "*" in to:
            raise zenoh.ZError(f"{to} is not one address")
        if len(self._publishers) >= _PUBLISHERS:
            self._publishers.pop(next(iter(self._publishers))).undeclare()  # type: ignore[no-untyped-call]
        # One priority, so that messages of one sender keep their order; asks and answers leave at once
        # (express), tells may share a batch. Not dropped when a queue is full: a stop is among them.
        publisher = self._publishers[to, prompt] = self._session.declare_publisher(
            to,
            congestion_control=zenoh.CongestionControl.BLOCK,
            priority=zenoh.Priority.REAL_TIME,
            express=prompt,
        )
        return publisher

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
                self._wake()

        self._watched[address] = self._session.liveliness().declare_subscriber(
            f"{address}/alive", zenoh.handlers.Callback(on_change, indirect=False)
        )

    # -- on zenoh's thread

    def _on_sample(self, sample: zenoh.Sample) -> None:
        self._inbox.append(sample.payload.to_bytes())
        self._wake()

    def _wake(self) -> None:
        if not self._wake_pending:
            self._wake_pending = True
            os.write(self._write_fd, b"\1\0\0\0\0\0\0\0")


_open: set[ZenohMesh] = set()


@atexit.register
def _close_all() -> None:
    """A thread of zenoh's that enters Python while the interpreter goes aborts the process: at the end of a
    script every session is closed before that. Not in a forked child, where they have no threads."""
    for mesh in list(_open):
        if mesh._pid == os.getpid():
            mesh.close()


def _wake_pair() -> tuple[int, int]:
    """An eventfd, or a pipe where there is none (macOS)."""
    if hasattr(os, "eventfd"):
        fd = os.eventfd(0, os.EFD_NONBLOCK | os.EFD_CLOEXEC)
        return fd, fd
    read_fd, write_fd = os.pipe()
    os.set_blocking(read_fd, False)
    os.set_blocking(write_fd, False)
    return read_fd, write_fd


__all__ = ["PREFIX", "ZenohMesh", "config", "unix_endpoint"]
