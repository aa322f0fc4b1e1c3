"""Collect the events of the demo as lines of text."""

from __future__ import annotations

import time
from collections.abc import Callable

from rich.text import Text

STYLES = {"plain": "", "good": "green", "bad": "bold red", "fault": "bold yellow"}


class Story:
    def __init__(self, say: Callable[[Text], None]) -> None:
        """Begin without events. ``say`` is called with each new line."""
        self.began_ns = time.monotonic_ns()
        self.lines: list[Text] = []
        self._say = say

    def seconds(self) -> float:
        return (time.monotonic_ns() - self.began_ns) / 1e9

    def note(self, text: str, kind: str) -> None:
        line = Text.assemble((f"{self.seconds():6.2f} s  ", "dim"), (text, STYLES[kind]))
        self.lines.append(line)
        self._say(line)
