"""Read commands from standard input: single keys on a terminal, otherwise one word per line."""

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
    """Let the terminal deliver each key at once and without echo while the block runs. Ctrl-C still raises
    SIGINT."""
    before = termios.tcgetattr(descriptor)
    tty.setcbreak(descriptor)
    try:
        yield
    finally:
        termios.tcsetattr(descriptor, termios.TCSADRAIN, before)


async def read_keys(command: Callable[[str], None]) -> None:
    """Call ``command`` with the word in ``KEYS`` for each pressed key, until cancelled. Ignore other keys."""
    async for piece in _pieces(STDIN):
        for key in piece.decode(errors="replace"):
            if key in KEYS:
                command(KEYS[key])


async def read_words(command: Callable[[str], None], at_end: Callable[[], None]) -> None:
    """Call ``command`` with each line of standard input, until cancelled or until the end of the input.

    Args:
        command: Called with each word.
        at_end: Called when standard input has ended.
    """
    rest = b""
    async for piece in _pieces(STDIN):
        *lines, rest = (rest + piece).split(b"\n")
        for line in lines:
            if word := line.decode(errors="replace").strip():
                command(word)
        rest = rest[:LINE_BYTES]
    at_end()


async def _pieces(descriptor: int) -> AsyncIterator[bytes]:
    """Yield the bytes as they arrive. A thread reads them, because standard input may be a file, and files
    cannot be polled."""
    while piece := await trio.to_thread.run_sync(os.read, descriptor, 4096, abandon_on_cancel=True):
        yield piece
