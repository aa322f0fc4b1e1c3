"""The interface of a client in the question ``wires``."""

from __future__ import annotations

import os
import time
from abc import ABC, abstractmethod


class Hand(ABC):
    """A connected and energised robot that takes commands."""

    pause_s: float = 0.0
    """Least pause between two setpoints, in seconds, if a motion of this client has to end first."""

    @abstractmethod
    def setpoint(self, number: int) -> int:
        """Send a command that differs from the previous one. Return when it began, in nanoseconds of
        CLOCK_MONOTONIC."""

    def move(self, number: int) -> None:
        """Make the robot move until it is stopped, or for a while."""
        self.setpoint(number)

    @abstractmethod
    def stop(self) -> None:
        """Stop the robot as users of this client do."""

    def again(self) -> None:  # noqa: B027  # most clients need nothing for that
        """Make the robot ready for commands again, after a stop."""

    def stream(self, hz: float, seconds: float) -> None:
        """Send commands at the control rate (``hz``) for so many seconds."""
        began_s = time.monotonic()
        for number in range(round(hz * seconds)):
            self.setpoint(number)
            time.sleep(max(0.0, began_s + (number + 1) / hz - time.monotonic()))

    def pids(self) -> tuple[list[int], list[int]]:
        """Return the pids of the processes with the wire, and those of the other processes."""
        return [os.getpid()], []

    def close(self) -> None:  # noqa: B027  # the process ends
        """Release the robot."""


def wave(number: int) -> float:
    """Return a value from 0 to 1. Successive ones differ."""
    return (1 + number % 3) / 3
