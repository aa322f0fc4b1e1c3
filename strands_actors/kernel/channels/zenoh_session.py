"""What every zenoh session of ours has in common: a closed configuration, and a wake-up for the
loop. How sessions end stands in ``zenoh_exit``.

Loopback only: unless told otherwise a session listens on unix sockets in a directory of the user's
own. No multicast, no gossip: nobody is found who was not named.
"""

from __future__ import annotations

import contextlib
import json
import os
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import trio
import zenoh

LEASE_MS = 1000
"""Of the transport: a frozen peer is dropped after this long (zenoh's default is 10 s)."""
ANSWERED_S = 3600.0
"""No answer to a query comes later; who asks has a deadline of its own."""


def config(
    listen: Sequence[str] = (), connect: Sequence[str] = (), more: Mapping[str, Any] | None = None
) -> zenoh.Config:
    """Return the configuration of a closed peer: only these endpoints, retried quickly when they go
    away. ``more``: settings by zenoh's own path, over these."""
    result = zenoh.Config()
    settings = {
        "mode": "peer",
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": False,
        "listen/endpoints": list(listen),
        "connect/endpoints": list(connect),
        "connect/timeout_ms": -1,
        "connect/exit_on_failure": False,
        "connect/retry": {"period_init_ms": 20, "period_max_ms": 200, "period_increase_factor": 1.5},
        # Opening does not wait for those it connects to: a frozen one would hold it up (0.5 s).
        "open/return_conditions/connect_scouted": False,
        # A frozen peer takes the connection and says nothing; close() would wait for it (zenoh: 10
        # s).
        "transport/unicast/open_timeout": LEASE_MS,
        "transport/link/tx/lease": LEASE_MS,
        "transport/link/tx/keep_alive": 4,
        # A peer that reads nothing (frozen) may hold a sender up this long, in us; then it is cut
        # off.
        "transport/link/tx/queue/congestion_control/block/wait_before_close": 100_000,
        # Commands and answers leave at once, each in a batch of its own. zenoh has room for one
        # such batch: of five put in a row on a busy machine the third and those behind it were
        # dropped. It takes 16 at most.
        "transport/link/tx/queue/size/real_time": 16,
        "transport/shared_memory/enabled": False,
    }
    for key, value in {**settings, **(more or {})}.items():
        result.insert_json5(key, json.dumps(value))
    return result


def hand_over() -> None:
    """Have one of zenoh's threads do the work of four: an answer comes a quarter sooner. Before the
    first session, and only in a process where nobody holds the interpreter's lock for long: a
    callback that waits for it holds up what is sent as well, and after ``LEASE_MS`` of that the
    others think this process is gone."""
    os.environ.setdefault("ZENOH_RUNTIME", _ONE_RUNTIME)


_ONE_RUNTIME = "(net: (handover: app), tx: (handover: app), rx: (handover: app), acc: (handover: app))"


@contextlib.contextmanager
def known_by(secret: str) -> Iterator[dict[str, str]]:
    """Settings of a session that opens within the block, and which lets in nobody who does not
    know the secret, and joins nobody who does not ask for it. None for an empty one."""
    if not secret:
        yield {}
        return
    auth = "transport/auth/usrpwd"
    with _in_memory(f"{_USER}:{secret}\n".encode()) as path:  # zenoh reads who may come in from a file
        yield {f"{auth}/user": _USER, f"{auth}/password": secret, f"{auth}/dictionary_file": path}


_USER = "tree"


@contextlib.contextmanager
def _in_memory(data: bytes) -> Iterator[str]:
    """A file that this process alone can open, by this path."""
    has_memory = hasattr(os, "memfd_create")  # macOS has not
    with open(os.memfd_create("known"), "w+b") if has_memory else tempfile.TemporaryFile() as file:
        file.write(data)
        file.seek(0)
        yield f"/dev/fd/{file.fileno()}"


def unix_endpoint(path: str) -> str:
    return f"unixsock-stream/{path}"


def short(error: zenoh.ZError) -> str:
    """Return what it says, without where in zenoh's source it says so."""
    return str(error).partition(" at /")[0]


class Waker:
    """From zenoh's threads into the loop: an eventfd, or a pipe where there is none (macOS)."""

    def __init__(self) -> None:
        self._pending = False
        if hasattr(os, "eventfd"):
            self._read_fd = self._write_fd = os.eventfd(0, os.EFD_NONBLOCK | os.EFD_CLOEXEC)
        else:
            self._read_fd, self._write_fd = os.pipe()
            os.set_blocking(self._read_fd, False)
            os.set_blocking(self._write_fd, False)

    def wake(self) -> None:
        """From any thread."""
        if not self._pending:
            self._pending = True
            os.write(self._write_fd, b"\1\0\0\0\0\0\0\0")

    async def wait(self) -> None:
        await trio.lowlevel.wait_readable(self._read_fd)
        # Read, then clear the flag, and only then may the caller drain: in any other order a
        # wake-up can be lost.
        os.read(self._read_fd, 8)
        self._pending = False

    def close(self) -> None:
        """Nobody may wake it any more."""
        for fd in {self._read_fd, self._write_fd}:
            os.close(fd)
