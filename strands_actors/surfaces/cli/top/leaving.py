"""End ``top`` on a signal, or when its terminal is gone, even if its screen is blocked.

Two cases need care:

* If the terminal's output is not read, writing blocks, and with it the event loop that draws the screen.
  Python's signal handlers run nevertheless, so they are used.
* If the terminal is not the controlling terminal of the process, its end causes no signal. So a thread
  watches it.

If the application has not ended within ``GRACE_S``, the process ends itself.
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
"""Time to restore the screen, in seconds. An order has been sent long before, and its result cannot be read any
more."""
SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
_SCREEN_AS_IT_WAS = b"\x1b[?1049l\x1b[?25h\x1b[?1000l\x1b[?1002l\x1b[?1003l\x1b[?1006l\x1b[?2004l"


@contextlib.contextmanager
def ends_with_its_terminal(leave: Callable[[int], None]) -> Iterator[None]:
    """Watch for signals and the end of the terminal while the block shows the screen. Use this in the main
    thread.

    Args:
        leave: Called from any thread with an exit code, to end the application. If this has no effect within
            ``GRACE_S``, the process is ended.
    """
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
        hung_up.register(self._terminal, 0)  # Request no events: POLLHUP is always reported.
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
        with contextlib.suppress(OSError, termios.error):  # The terminal may have vanished, or may block.
            termios.tcsetattr(self._terminal, termios.TCSANOW, self._settings)
            os.set_blocking(self._terminal, False)
            os.write(self._terminal, _SCREEN_AS_IT_WAS)
        os._exit(code)
