"""What a child process runs first: read the specification, import the entry, call it, end at once.

A child ends by ``os._exit``: no thread, no exit handler and no open session keeps it, or its lease,
alive. Signals keep their default action: a child that is told to end is simply gone, and its parent
makes the robot safe exactly as if it had crashed. One way of dying, one way of being safe.

Standard output belongs to the program, which another may read: what a child prints, or an SDK
within it, goes to standard error.

What an exception says is said in few words: its parent makes the robot safe once this process has
ended, and the lines of source that Python prints take 3 ms to be read.
"""

from __future__ import annotations

import contextlib

# The first use of a host name would import it, in a process that is not to wait for the disk.
import encodings.idna  # noqa: F401
import gc
import importlib
import io
import os
import signal
import socket
import sys
import traceback
from collections.abc import Iterator

import msgspec

from strands_actors.kernel.health.realtime import run_like_others

from .process import MAX_DESCRIPTORS, SIZE_BYTES, ChildSpecification

YOUNG = 20_000
"""Containers made before the collector looks at them: what is made 500 times a second is gone by
itself."""


def main(fd: int) -> None:
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    # Ignored, which an exec hands down, the system would reap our children: nobody could learn of
    # an end, nor of its code.
    signal.signal(signal.SIGCHLD, signal.SIG_DFL)
    _print_to_stderr()
    sock = socket.socket(fileno=fd)
    run_like_others()
    code = 1
    try:
        specification = _specification(sock)
        module, _, function = specification.entry.partition(":")
        entry = getattr(importlib.import_module(module), function)
        gc.collect()
        gc.freeze()  # a later full collection then has nothing of start-up to walk (34 ms measured)
        gc.set_threshold(YOUNG, 10, 10)
        entry(specification.args, sock)
        code = 0
    except BaseException as error:
        code = exit_code(error)
    finally:
        # Nobody may be left to read what is flushed; the end must come all the same.
        for stream in (sys.stderr, sys.stdout):
            with contextlib.suppress(Exception):
                stream.flush()
        os._exit(code)


def _print_to_stderr() -> None:
    """What C prints, too; and of Python a line as soon as it ends: who is killed flushes
    nothing."""
    if sys.stderr is None or sys.stdout is None:
        return  # closed by whoever started the program; the descriptors may be anything's
    os.dup2(2, 1)
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(line_buffering=True)


def exit_code(error: BaseException) -> int:
    """Return the code of a process that ends by this. As the interpreter does it: ``sys.exit``
    without anything is success, with a text it is failure, and the text is printed, as is every
    other exception. A trio nursery wraps what is raised in it."""
    if isinstance(error, BaseExceptionGroup) and error.split(SystemExit)[1] is None:
        return exit_code(error.exceptions[0])
    if not isinstance(error, SystemExit):
        _print("\n".join(told(error)))
        return 1
    if error.code is None:
        return 0
    if isinstance(error.code, int):
        return error.code
    _print(str(error.code))
    return 1


def _print(text: str) -> None:
    """Print to standard error, also when its disk is full or nobody reads it."""
    with contextlib.suppress(OSError, ValueError):
        print(text, file=sys.stderr)


def told(error: BaseException, indent: str = "") -> Iterator[str]:
    """Return where it was raised and what it says, innermost last; then what it was raised from, or
    in place of, and what is in it if it is a group."""
    yield f"{indent}Traceback, without the source:"
    for frame, line in traceback.walk_tb(error.__traceback__):
        yield f'{indent}  File "{frame.f_code.co_filename}", line {line}, in {frame.f_code.co_name}'
    yield f"{indent}{type(error).__qualname__}: {error}"
    before = error.__cause__ or (None if error.__suppress_context__ else error.__context__)
    if before is not None:
        yield f"{indent}which came after:"
        yield from told(before, indent)
    if isinstance(error, BaseExceptionGroup):
        for part in error.exceptions:
            yield from told(part, indent + "    ")


def report_failure(what: str, error: BaseException) -> None:
    """Print where something failed that its process outlives, also when nobody can read it any
    more."""
    with contextlib.suppress(MemoryError):
        _print("\n".join((f"{what} failed.", *told(error))))


def _specification(sock: socket.socket) -> ChildSpecification:
    """Raise ``EOFError`` when the parent ended before it said all of it."""
    begun, descriptors, _, _ = socket.recv_fds(sock, SIZE_BYTES, MAX_DESCRIPTORS)
    size = int.from_bytes(_receive(sock, SIZE_BYTES, begun), "little")
    specification = msgspec.msgpack.decode(_receive(sock, size), type=ChildSpecification)
    if descriptors:
        specification.args["descriptors"] = list(descriptors)
    return specification


def _receive(sock: socket.socket, size: int, data: bytes = b"") -> bytes:
    while len(data) < size:
        piece = sock.recv(size - len(data))
        if not piece:
            raise EOFError("the parent ended before it said what to run")
        data += piece
    return data
