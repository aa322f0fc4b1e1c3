"""Common parts of all zenoh sessions: a closed configuration, and a wake-up of the loop.

``zenoh_exit`` describes how sessions end. By default a session uses loopback only: it listens on unix sockets
in a directory of the user. There is no multicast and no gossip, so a session connects only to peers that are
named.
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
"""Milliseconds after which the transport drops a frozen peer (zenoh's default is 10 s)."""
ANSWERED_S = 3600.0
"""Timeout of a zenoh query, in seconds. The sender has a shorter deadline."""


def config(
    listen: Sequence[str] = (), connect: Sequence[str] = (), more: Mapping[str, Any] | None = None
) -> zenoh.Config:
    """Return the configuration of a peer that connects only to named endpoints.

    It uses only these endpoints, and connects again quickly after a connection was lost.

    Args:
        listen: Endpoints to listen on.
        connect: Endpoints to connect to.
        more: Further settings by zenoh's own path. They override the ones here.
    """
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
        # Opening does not wait for the peers that it connects to. A frozen peer would delay it by 0.5 s.
        "open/return_conditions/connect_scouted": False,
        # A frozen peer accepts the connection and then sends nothing. This limits the time that close() waits
        # for such a peer (10 s by zenoh's default).
        "transport/unicast/open_timeout": LEASE_MS,
        "transport/link/tx/lease": LEASE_MS,
        "transport/link/tx/keep_alive": 4,
        # A frozen peer, which reads nothing, may delay a sender by this many microseconds. Then it is
        # disconnected.
        "transport/link/tx/queue/congestion_control/block/wait_before_close": 100_000,
        # Each command or answer leaves at once, in a separate batch. By default zenoh has room for one such
        # batch. When five were sent in a row on a busy machine, zenoh dropped the third and all later ones. It
        # allows room for 16 at most.
        "transport/link/tx/queue/size/real_time": 16,
        "transport/shared_memory/enabled": False,
    }
    for key, value in {**settings, **(more or {})}.items():
        result.insert_json5(key, json.dumps(value))
    return result


def hand_over() -> None:
    """Let one thread of zenoh do the work of four. An answer then comes a quarter sooner.

    Call it before the first session, and only in a process in which no thread holds the interpreter's lock for
    long. A callback that waits for the lock also delays the sending of messages. If the delay is longer than
    ``LEASE_MS``, the peers treat this process as gone.
    """
    os.environ.setdefault("ZENOH_RUNTIME", _ONE_RUNTIME)


_ONE_RUNTIME = "(net: (handover: app), tx: (handover: app), rx: (handover: app), acc: (handover: app))"


@contextlib.contextmanager
def secured_by(secret: str) -> Iterator[dict[str, str]]:
    """Yield the settings of a session that accepts only peers which know the secret.

    The session must be opened within the block. It also joins only peers that ask for the secret. An empty
    secret yields no settings.
    """
    if not secret:
        yield {}
        return
    auth = "transport/auth/usrpwd"
    # zenoh reads the accepted users from a file.
    with _in_memory(f"{_USER}:{secret}\n".encode()) as path:
        yield {f"{auth}/user": _USER, f"{auth}/password": secret, f"{auth}/dictionary_file": path}


_USER = "tree"


@contextlib.contextmanager
def _in_memory(data: bytes) -> Iterator[str]:
    """Yield the path of a file that only this process can open."""
    # macOS lacks memfd_create.
    has_memory = hasattr(os, "memfd_create")
    with open(os.memfd_create("known"), "w+b") if has_memory else tempfile.TemporaryFile() as file:
        file.write(data)
        file.seek(0)
        yield f"/dev/fd/{file.fileno()}"


def unix_endpoint(path: str) -> str:
    return f"unixsock-stream/{path}"


def short(error: zenoh.ZError) -> str:
    """Return the text of an error, without the place in zenoh's source."""
    return str(error).partition(" at /")[0]


class Waker:
    """Wakes the loop from zenoh's threads, by an eventfd, or by a pipe where the system has no eventfd (macOS)."""

    def __init__(self) -> None:
        self._pending = False
        if hasattr(os, "eventfd"):
            self._read_fd = self._write_fd = os.eventfd(0, os.EFD_NONBLOCK | os.EFD_CLOEXEC)
        else:
            self._read_fd, self._write_fd = os.pipe()
            os.set_blocking(self._read_fd, False)
            os.set_blocking(self._write_fd, False)

    def wake(self) -> None:
        """Wake the loop. It may be called from any thread."""
        if not self._pending:
            self._pending = True
            os.write(self._write_fd, b"\1\0\0\0\0\0\0\0")

    async def wait(self) -> None:
        await trio.lowlevel.wait_readable(self._read_fd)
        # Keep this order: read, clear the flag, return to the caller, which drains its queue. In any other
        # order a wake-up can be lost.
        os.read(self._read_fd, 8)
        self._pending = False

    def close(self) -> None:
        """Close the descriptors. ``wake`` must not be called afterwards."""
        for fd in {self._read_fd, self._write_fd}:
            os.close(fd)
