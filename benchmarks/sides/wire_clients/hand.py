"""The interface that each client in the question ``wires`` implements."""

from __future__ import annotations

import os
import time
from abc import ABC, abstractmethod


class BaseClient(ABC):
    """A client's connection to an energised robot that takes commands."""

    pause_s: float = 0.0
    """Least pause between two setpoints, in seconds, if a motion of this client has to end first."""

    @abstractmethod
    def setpoint(self, number: int) -> int:
        """Send a command that differs from the previous one. Return the time before the call, in nanoseconds of
        CLOCK_MONOTONIC.
        """

    def move(self, number: int) -> None:
        """Make the robot move until it is stopped, or until the client's motion ends by itself."""
        self.setpoint(number)

    @abstractmethod
    def stop(self) -> None:
        """Stop the robot in the way in which users of this client do it."""

    def again(self) -> None:  # noqa: B027  # most clients need nothing for that
        """Make the robot ready for commands again after a stop."""

    def stream(self, hz: float, seconds: float) -> None:
        """Send commands at the control rate (``hz``), for ``seconds``."""
        began_s = time.monotonic()
        for number in range(round(hz * seconds)):
            self.setpoint(number)
            time.sleep(max(0.0, began_s + (number + 1) / hz - time.monotonic()))

    def pids(self) -> tuple[list[int], list[int]]:
        """Return the ids of the processes that talk to the robot, and those of the client's other processes."""
        return [os.getpid()], []

    def close(self) -> None:  # noqa: B027  # the process ends
        """Close the connection to the robot."""


def wave(number: int) -> float:
    """Return a value from 0 to 1 for setpoint ``number``. Successive setpoints have different values."""
    return (1 + number % 3) / 3
