"""The end of ``top`` by a signal, or because its terminal has gone, whatever its screen waits for.

A screen that nobody reads takes no more output, and the loop that draws it stands still; a terminal
that is no controlling one ends without a signal. So signals are taken by Python's own handlers,
which run while the loop waits for its output, and a thread looks at the terminal. What has not
ended in ``GRACE_S`` is ended.
"""

from __future__ import annotations

import contextlib
import os
import select
import signal
import sys
import termios
import threading
from collections.abc import Callable, Iterator
from types import FrameType
from typing import Any

GRACE_S = 1.0
"""For the screen to be put back. An order has left long before; nobody is there to read what became
of it."""
SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
_SCREEN_AS_IT_WAS = b"\x1b[?1049l\x1b[?25h\x1b[?1000l\x1b[?1002l\x1b[?1003l\x1b[?1006l\x1b[?2004l"


@contextlib.contextmanager
def ends_with_its_terminal(leave: Callable[[int], None]) -> Iterator[None]:
    """In the main thread, around the screen. ``leave``: of any thread, with an exit code; it may
    have no effect."""
    ending = _Ending(sys.stdin.fileno(), leave)
    before = {number: signal.signal(number, ending.by_signal) for number in SIGNALS}
    threading.Thread(target=ending.watch, name="top-terminal", daemon=True).start()
    try:
        yield
    finally:
        ending.over.set()
        for number, handler in before.items():
            signal.signal(number, handler)


class _Ending:
    def __init__(self, terminal: int, leave: Callable[[int], None]) -> None:
        self._terminal = terminal
        self._settings: list[Any] = termios.tcgetattr(terminal)
        self._leave = leave
        self._begun = False
        self.over = threading.Event()

    def by_signal(self, number: int, _: FrameType | None) -> None:
        self._begin(128 + number)

    def watch(self) -> None:
        hung_up = select.poll()
        hung_up.register(self._terminal, 0)  # POLLHUP is always told, and nothing else is asked for
        hung_up.poll()
        self._begin(128 + signal.SIGHUP)

    def _begin(self, code: int) -> None:
        if self._begun or self.over.is_set():
            return
        self._begun = True
        threading.Thread(target=self._insist, args=(code,), daemon=True).start()
        self._leave(code)

    def _insist(self, code: int) -> None:
        if self.over.wait(GRACE_S):
            return
        with contextlib.suppress(OSError, termios.error):  # it may have gone, or take nothing
            termios.tcsetattr(self._terminal, termios.TCSANOW, self._settings)
            os.set_blocking(self._terminal, False)
            os.write(self._terminal, _SCREEN_AS_IT_WAS)
        os._exit(code)
