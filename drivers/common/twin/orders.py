"""A socket on which a running twin takes control lines, such as ``unplug``, from any program of the same user.

A client connects, sends one line, and gets one line back: ``DONE``, or why the twin did not carry it out.
"""

from __future__ import annotations

import contextlib
import os
import socket
from collections.abc import Callable, Iterator
from pathlib import Path

import trio

DONE = "done"
LONGEST = 4096
"""Longest line, in bytes."""
WITHIN_S = 5.0
"""Time for a client to send its line, and for the twin to answer it."""


async def serve_orders(
    path: str,
    obey: Callable[[str], None],
    task_status: trio.TaskStatus[list[trio.SocketListener]] = trio.TASK_STATUS_IGNORED,
) -> None:
    """Serve the socket until this task is cancelled. Then remove it.

    Args:
        path: Path of the socket. A socket that a killed twin has left there is replaced.
        obey: Carries out a line. It raises ``ValueError`` for a line that it does not know.
        task_status: Started when clients can connect.

    Raises:
        OSError: The socket cannot be made.
    """

    async def serve(stream: trio.SocketStream) -> None:
        # A client may end at any time.
        with contextlib.suppress(trio.BrokenResourceError, trio.TooSlowError), trio.fail_after(WITHIN_S):
            await stream.send_all(f"{_answer(await _line(stream))}\n".encode())

    def _answer(line: str) -> str:
        try:
            obey(line)
        except ValueError as error:
            return str(error).replace("\n", " ")
        return DONE

    with contextlib.suppress(FileNotFoundError):
        os.unlink(path)
    listener = trio.socket.socket(socket.AF_UNIX)
    try:
        with _short(path) as short:
            await listener.bind(short)
        os.chmod(path, 0o600)
        listener.listen()
        await trio.serve_listeners(serve, [trio.SocketListener(listener)], task_status=task_status)
    finally:
        listener.close()
        with contextlib.suppress(FileNotFoundError):
            os.unlink(path)


async def _line(stream: trio.SocketStream) -> str:
    """Return the line of a client. Raise ``trio.BrokenResourceError`` if the client ends before its line does,
    since a part of an order may be another order."""
    received = b""
    while b"\n" not in received:
        data = await stream.receive_some(LONGEST)
        if not data or len(received) > LONGEST:
            raise trio.BrokenResourceError("there is no whole line")
        received += data
    return received.partition(b"\n")[0].decode(errors="replace")


def send_order(path: str, line: str) -> str:
    """Send a control line to a running twin. Return why it was not carried out; empty if it was.

    Args:
        path: Path of the twin's socket.
        line: The line, such as ``unplug``.

    Raises:
        OSError: No twin serves this socket, or it does not answer.
    """
    with socket.socket(socket.AF_UNIX) as client:
        client.settimeout(WITHIN_S)
        with _short(path) as short:
            client.connect(short)
        client.sendall(f"{line}\n".encode())
        with client.makefile(encoding="utf-8", errors="replace") as answers:
            answer = answers.readline().removesuffix("\n")
    if not answer:
        raise ConnectionError("the twin has ended")
    return "" if answer == DONE else answer


@contextlib.contextmanager
def _short(path: str) -> Iterator[str]:
    """Give a path of the socket that is short enough for the system: at most 107 bytes."""
    folder = os.open(Path(path).parent, os.O_PATH | os.O_DIRECTORY)
    try:
        yield f"/proc/self/fd/{folder}/{Path(path).name}"
    finally:
        os.close(folder)
