"""Commands from the terminal: a key each, or a word a line where there is none."""

from __future__ import annotations

import os
import termios
import tty
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import contextmanager

import trio

KEYS = {
    " ": "toggle",
    "\r": "toggle",
    "\n": "toggle",
    "d": "discard",
    "a": "again",
    "q": "quit",
}
HELP = "space: start, finish    d: discard    a: again    q: quit"
LINE_BYTES = 200
STDIN = 0


@contextmanager
def single_keys(descriptor: int) -> Iterator[None]:
    """Give each key at once, unshown. Ctrl-C stays what it is."""
    before = termios.tcgetattr(descriptor)
    tty.setcbreak(descriptor)
    try:
        yield
    finally:
        termios.tcsetattr(descriptor, termios.TCSADRAIN, before)


async def read_keys(command: Callable[[str], None]) -> None:
    """Obey the terminal on standard input, until cancelled. Its keys are taken one by one
    meanwhile."""
    async for piece in _pieces(STDIN):
        for key in piece.decode(errors="replace"):
            if key in KEYS:
                command(KEYS[key])


async def read_words(command: Callable[[str], None], at_end: Callable[[], None]) -> None:
    """Obey the words on standard input, one a line, until cancelled. ``at_end``: nothing more will
    come."""
    rest = b""
    async for piece in _pieces(STDIN):
        *lines, rest = (rest + piece).split(b"\n")
        for line in lines:
            if word := line.decode(errors="replace").strip():
                command(word)
        rest = rest[:LINE_BYTES]
    at_end()


async def _pieces(descriptor: int) -> AsyncIterator[bytes]:
    """What is read, as it comes. In a thread: standard input may be a file, which no poll knows."""
    while piece := await trio.to_thread.run_sync(os.read, descriptor, 4096, abandon_on_cancel=True):
        yield piece
