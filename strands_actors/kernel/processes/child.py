"""The first code of a child process: read the specification, import the entry, call it, and exit at once.

A child ends by ``os._exit``. So no thread, exit handler or open session keeps the process, or its lease, alive.
Signals keep their default action: a child that gets one ends at once, and its parent makes the robot safe
exactly as after a crash. So the parent has to handle only one kind of end.

Standard output belongs to the program, and another program may read it. So a child, and any SDK in it, prints
to standard error.

Tracebacks are printed without source lines. The parent makes the robot safe only when this process has ended,
and Python needs 3 ms to read those lines.
"""

from __future__ import annotations

import contextlib

# Import this before it is needed. The first use of a host name would import it, in a process that must not wait
# for the disk.
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
"""Number of new container objects after which the garbage collector runs. Objects that are made 500 times a
second are freed without the collector.
"""


def main(fd: int) -> None:
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    # A program that is started by exec inherits an ignored SIGCHLD. The system would then reap our children,
    # and their ends and exit codes would be lost.
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
        # Freeze the objects of the start. A later full collection then does not walk them (34 ms measured).
        gc.freeze()
        gc.set_threshold(YOUNG, 10, 10)
        entry(specification.args, sock)
        code = 0
    except BaseException as error:
        code = exit_code(error)
    finally:
        # The reader of these streams may be gone, so a flush may fail. The process must end all the same.
        for stream in (sys.stderr, sys.stdout):
            with contextlib.suppress(Exception):
                stream.flush()
        os._exit(code)


def _print_to_stderr() -> None:
    """Redirect standard output to standard error, for C code too. Python flushes each line at once, since a
    killed process flushes nothing."""
    if sys.stderr is None or sys.stdout is None:
        # The parent started this process without these streams. Their descriptors may be open files of any
        # kind.
        return
    os.dup2(2, 1)
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(line_buffering=True)


def exit_code(error: BaseException) -> int:
    """Return the exit code of a process that ends by this exception, as the interpreter would.

    ``sys.exit`` without a value is success. With a text it is failure, and the text is printed, like every
    other exception. A group of only ``SystemExit``, as a trio nursery makes it, counts as the first of them.
    """
    if isinstance(error, BaseExceptionGroup) and error.split(SystemExit)[1] is None:
        return exit_code(error.exceptions[0])
    if not isinstance(error, SystemExit):
        _print("\n".join(traceback_lines(error)))
        return 1
    if error.code is None:
        return 0
    if isinstance(error.code, int):
        return error.code
    _print(str(error.code))
    return 1


def _print(text: str) -> None:
    """Print to standard error. Ignore a full disk and a missing reader."""
    with contextlib.suppress(OSError, ValueError):
        print(text, file=sys.stderr)


def traceback_lines(error: BaseException, indent: str = "") -> Iterator[str]:
    """Yield the lines of a traceback without source, innermost call last.

    The same lines follow for the cause or context of the exception, and for each exception of a group.
    """
    yield f"{indent}Traceback, without the source:"
    for frame, line in traceback.walk_tb(error.__traceback__):
        yield f'{indent}  File "{frame.f_code.co_filename}", line {line}, in {frame.f_code.co_name}'
    yield f"{indent}{type(error).__qualname__}: {error}"
    before = error.__cause__ or (None if error.__suppress_context__ else error.__context__)
    if before is not None:
        yield f"{indent}which came after:"
        yield from traceback_lines(before, indent)
    if isinstance(error, BaseExceptionGroup):
        for part in error.exceptions:
            yield from traceback_lines(part, indent + "    ")


def report_failure(subject: str, error: BaseException) -> None:
    """Print a failure that does not end the process. Ignore a missing reader and a lack of memory."""
    with contextlib.suppress(MemoryError):
        _print("\n".join((f"{subject} failed.", *traceback_lines(error))))


def _specification(sock: socket.socket) -> ChildSpecification:
    """Receive the specification (the function to run, and its arguments). Raise ``EOFError`` if the parent ended
    before it had sent all of it.
    """
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
