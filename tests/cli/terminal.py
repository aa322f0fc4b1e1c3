"""Run the command in a pseudo-terminal."""

from __future__ import annotations

import os
import pty
import struct
import subprocess
import termios
import threading
from fcntl import ioctl
from types import TracebackType
from typing import Any

from .command import PATIENCE_S, Command

ALT_SCREEN_OFF = b"\x1b[?1049l"


class Terminal:
    """A terminal. ``shown`` has all its output, and is complete after the block."""

    def __init__(self, cli: Command, *arguments: str, rows: int = 45, **keywords: Any) -> None:
        """``keywords`` are passed to ``Popen``."""
        self.shown = bytearray()
        self._screen, self._terminal = pty.openpty()
        ioctl(self._terminal, termios.TIOCSWINSZ, struct.pack("HHHH", rows, 120, 0, 0))
        self.settings_before = self.settings()
        cli.environment["TERM"] = "xterm-256color"
        streams = dict.fromkeys(("stdin", "stdout", "stderr"), self._terminal)
        self.process: subprocess.Popen[str] = cli.start(*arguments, start_new_session=True, **streams, **keywords)
        self._reader = threading.Thread(target=self._read)
        self._reader.start()

    def settings(self) -> list[Any]:
        return termios.tcgetattr(self._terminal)

    def press(self, key: bytes) -> None:
        os.write(self._screen, key)

    def __enter__(self) -> Terminal:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.process.kill()
        os.close(self._terminal)
        self._reader.join(PATIENCE_S)
        os.close(self._screen)

    def _read(self) -> None:
        try:
            while data := os.read(self._screen, 65536):
                self.shown.extend(data)
        except OSError:  # the last process has closed its end
            pass
