"""What a child process runs first: read the specification, import the entry, call it, end at once.

A child ends by ``os._exit``: no thread, no exit handler and no open session keeps it, or its lease, alive.
Signals keep their default action: a child that is told to end is simply gone, and its parent makes the
robot safe exactly as if it had crashed. One way of dying, one way of being safe.
"""

from __future__ import annotations

import contextlib
import gc
import importlib
import os
import signal
import socket
import sys
import traceback

import msgspec

from .process import ChildSpecification
from .realtime import run_like_others

YOUNG = 20_000
"""Containers made before the collector looks at them: what is made 500 times a second is gone by itself."""


def main(fd: int) -> None:
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    sock = socket.socket(fileno=fd)
    run_like_others()
    code = 1
    try:
        specification = msgspec.msgpack.decode(_read_exactly(sock), type=ChildSpecification)
        module, _, function = specification.entry.partition(":")
        entry = getattr(importlib.import_module(module), function)
        gc.collect()
        gc.freeze()  # a later full collection then has nothing of start-up to walk (34 ms measured)
        gc.set_threshold(YOUNG, 10, 10)
        entry(specification.args, sock)
        code = 0
    except SystemExit as stop:
        code = _exit_code(stop)
    except BaseException:
        traceback.print_exc()
    finally:
        # Nobody may be left to read what is flushed; the end must come all the same.
        for stream in (sys.stderr, sys.stdout):
            with contextlib.suppress(Exception):
                stream.flush()
        os._exit(code)


def _exit_code(stop: SystemExit) -> int:
    """As the interpreter does it: nothing is success, a text is printed and is failure."""
    if stop.code is None:
        return 0
    if isinstance(stop.code, int):
        return stop.code
    print(stop.code, file=sys.stderr)
    return 1


def _read_exactly(sock: socket.socket) -> bytes:
    size = int.from_bytes(_receive(sock, 4), "little")
    return _receive(sock, size)


def _receive(sock: socket.socket, size: int) -> bytes:
    data = b""
    while len(data) < size:
        piece = sock.recv(size - len(data))
        if not piece:
            raise EOFError("the parent ended before it said what to run")
        data += piece
    return data
