"""What the question ``wires`` asks of whoever moves a robot."""

from __future__ import annotations

import os
import time
from abc import ABC, abstractmethod


class Hand(ABC):
    """A robot that is connected, energised, and takes commands. ``hz``: its control rate."""

    pause_s: float = 0.0
    """Between two setpoints, at least: a motion of this client's has to end first."""

    @abstractmethod
    def setpoint(self, number: int) -> int:
        """Command something that differs from the command before; return when that began
        (CLOCK_MONOTONIC ns)."""

    def move(self, number: int) -> None:
        """Have the robot move until it is stopped, for a while at least."""
        self.setpoint(number)

    @abstractmethod
    def stop(self) -> None:
        """Stop it, as this client's users do."""

    def again(self) -> None:  # noqa: B027  # most clients need nothing for that
        """Have it take commands again, after a stop."""

    def stream(self, hz: float, seconds: float) -> None:
        """Command it at its control rate for so long."""
        began_s = time.monotonic()
        for number in range(round(hz * seconds)):
            self.setpoint(number)
            time.sleep(max(0.0, began_s + (number + 1) / hz - time.monotonic()))

    def pids(self) -> tuple[list[int], list[int]]:
        """The processes that have the wire, and the others that this takes."""
        return [os.getpid()], []

    def close(self) -> None:  # noqa: B027  # the process ends
        """Let go of the robot."""


def wave(number: int) -> float:
    """0 to 1, never twice the same in a row."""
    return (1 + number % 3) / 3
