"""A small serial robot on a pseudo-terminal, with a log of its commands and their times."""

from __future__ import annotations

import os
import select
import threading
import time
import tty
from pathlib import Path
from typing import NamedTuple


class Line(NamedTuple):
    t_ns: int
    text: str


class SmallArm:
    """A robot with two joints. It follows its last command, even when the sender is gone.

    Args:
        port: A path for this robot only, which ends with it, because the next terminal may get the same number.
    """

    def __init__(self, port: Path) -> None:
        self._master, self._slave = os.openpty()
        tty.setraw(self._slave)
        port.symlink_to(os.ttyname(self._slave))
        self.port = str(port)
        self.log: list[Line] = []
        self.answers = True
        self._joints = {"pan.pos": 1.5, "lift.pos": -2.5}
        self._over = False
        self._thread = threading.Thread(target=self._serve)
        self._thread.start()

    def __enter__(self) -> SmallArm:
        return self

    def __exit__(self, *_: object) -> None:
        os.unlink(self.port)
        self._over = True
        self._thread.join()
        os.close(self._master)
        os.close(self._slave)

    def said(self, word: str, since_ns: int = 0) -> list[Line]:
        return [line for line in list(self.log) if line.text.split()[0] == word and line.t_ns >= since_ns]

    def answer(self, text: str) -> None:
        os.write(self._master, text.encode() + b"\n")

    def _serve(self) -> None:
        received = b""
        while not self._over:
            if not select.select([self._master], [], [], 0.05)[0]:
                continue
            *lines, received = (received + os.read(self._master, 4096)).split(b"\n")
            for line in lines:
                self._take(line.decode())

    def _take(self, text: str) -> None:
        self.log.append(Line(time.monotonic_ns(), text))
        word, *rest = text.split()
        if word == "goal":
            self._joints |= {key: float(value) for key, value in (pair.split("=") for pair in rest)}
        answer = " ".join(str(value) for value in self._joints.values()) if word == "read" else "ok"
        if self.answers:
            self.answer(answer)
