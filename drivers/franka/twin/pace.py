"""Decide how long the simulated controller waits for the command of each millisecond of a motion.

A real controller has its own computer, and a command that comes after its millisecond counts as missed. The twin
shares this computer with its client. If the client got no processor in time, that is the fault of neither. So the
twin keeps real time as long as a processor was free for the client. Otherwise it stretches the millisecond, and
counts how many it has stretched.
"""

from __future__ import annotations

import os
from typing import Literal, Protocol

from .path import TICK_S

Stretches = Literal["busy", "always", "never"]
"""When a millisecond may be stretched: while all processors are busy, always, or never."""

PAUSE_S = 0.0015
"""A wait of a millisecond that takes this much longer was a pause of this process: it had no processor either."""
LONGEST_PAUSE_S = 0.03
"""In real time, a longer pause of this process is not made up for: 20 missed commands have ended the motion."""


class Computer(Protocol):
    @property
    def busy(self) -> bool:
        """True if a program may be waiting for a processor."""
        ...


class Processors:
    """Compare how many programs run or wait for a processor with the number of processors."""

    def __init__(self, path: str = "/proc/loadavg", count: int | None = None) -> None:
        """Open the system's table.

        Args:
            path: The table, as described in proc(5). Its fourth column is ``running/all``.
            count: The number of processors. None: those of this computer.
        """
        self._count = count or os.cpu_count() or 1
        try:
            self._file = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
        except OSError:
            self._file = -1  # Only Linux has this table.

    @property
    def busy(self) -> bool:
        """True if more programs want to run than there are processors, and if the system does not say how many."""
        if self._file < 0:
            return True
        running = os.pread(self._file, 64, 0).split()[3].partition(b"/")[0]
        return int(running) > self._count


class Pace:
    """The pace of one motion, millisecond by millisecond."""

    def __init__(self, longest_s: float, stretches: Stretches, computer: Computer) -> None:
        """Set the rule.

        Args:
            longest_s: Longest stretch of a millisecond.
            stretches: When a millisecond may be stretched.
            computer: Tells whether the client had a processor.
        """
        self._longest_s = longest_s
        self._stretches = stretches
        self._computer = computer
        self.start_motion()

    def start_motion(self) -> None:
        """Count from 0 again."""
        self.ticks = self.stretched = 0

    def begin(self, due_s: float) -> None:
        """Begin a millisecond that was due at this time."""
        self.ticks += 1
        self._due_s = self._seen_s = due_s
        self._until_s = due_s + TICK_S

    def is_over(self, now_s: float) -> bool:
        """Return whether the wait for the command is over, so that it counts as missed."""
        paused, self._seen_s = now_s - self._seen_s > TICK_S + PAUSE_S, now_s
        if now_s < self._until_s:
            return False
        if self._stretches == "never" or now_s >= self._due_s + self._longest_s:
            return True
        if self._stretches == "busy" and not paused and not self._computer.busy:
            return True
        self._until_s = min(now_s + TICK_S, self._due_s + self._longest_s)
        return False

    def wait_s(self, now_s: float) -> float:
        """Return how long to wait for the command at most, before ``is_over`` is asked again."""
        return max(0.0, self._until_s - now_s)

    def rest_s(self, now_s: float) -> float:
        """Return the rest of the millisecond after its command has come; 0 or less if it is over."""
        return self._due_s + TICK_S - now_s

    def end(self, now_s: float) -> float:
        """End the millisecond. Return when the next one is due: at once if this one was too long.

        In real time the milliseconds of a short pause are made up for, and their commands are missed.
        """
        due_s = self._due_s + TICK_S
        if now_s - due_s <= (LONGEST_PAUSE_S if self._stretches == "never" else TICK_S):
            return due_s
        self.stretched += 1
        return now_s


__all__ = ["Computer", "Pace", "Processors", "Stretches"]
