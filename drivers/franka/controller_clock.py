"""Measure how fast the controller's time passes, by the clock of this computer."""

from __future__ import annotations

from collections import deque

from strands_actors.kernel.clock import NS

OVER_S = 1.0
"""Time over which it is measured."""
LEAST_S = 0.5
"""Shortest time that gives a number."""


class ControllerClock:
    """The time stamps of the last states.

    A real controller's time passes at 1000 ms a second. A simulated one may be slower on a busy computer.
    """

    def __init__(self) -> None:
        self._states: deque[tuple[int, int]] = deque()

    def note(self, received_ns: int, message_id: int) -> None:
        """Note a state: when it was received, and its time stamp in ms."""
        if self._states and message_id < self._states[-1][1]:
            self._states.clear()  # The controller was restarted.
        self._states.append((received_ns, message_id))
        # One state is kept that is older, so that the whole time is covered.
        while len(self._states) > 2 and received_ns - self._states[1][0] >= OVER_S * NS:
            self._states.popleft()

    @property
    def hz(self) -> float:
        """Milliseconds of the controller in a second of this computer. 0 as long as it is not known."""
        if len(self._states) < 2:
            return 0.0
        (first_ns, first), (last_ns, last) = self._states[0], self._states[-1]
        if last_ns - first_ns < LEAST_S * NS:
            return 0.0
        return (last - first) * NS / (last_ns - first_ns)
