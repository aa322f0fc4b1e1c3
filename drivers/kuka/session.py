"""What a client of FRI answers, cycle by cycle. Pure: no clock, no socket.

In every cycle one answer: without positions while the controller only monitors, its own
interpolated position while it waits for that, and from then on the last commanded position, or a
step from it towards the goal. Holding is repeating the answer. While a setpoint lives no two
answers are alike, by ``LIVE_RAD`` at least: so a hold can be told from a setpoint on the wire.
"""

from __future__ import annotations

from .protocol import COUNTER, Command, Monitoring, State

LIVE_RAD = 1e-12
"""A millionth of what an encoder can tell."""
LATE = 10
"""A message that is so few numbers behind was overtaken on the way; a larger step back is a new
session."""

Row = tuple[float, ...]


class FriSession:
    """The client's side of one session. ``speed_rad_s``: how fast each joint may be commanded."""

    def __init__(self, speed_rad_s: Row) -> None:
        self._speed_rad_s = speed_rad_s
        self._answered: int | None = None  # sequence of the message that was answered last
        self._sequence = 0
        self._commanded: Row = ()  # what the last answer commanded; empty: nothing
        self._goal: Row = ()
        self._span_s = 0.0
        self._per_cycle: Row = ()

    @property
    def commanded(self) -> Row:
        """The position that the arm is told; empty: none."""
        return self._commanded

    @property
    def has_goal(self) -> bool:
        return bool(self._goal)

    def aim(self, goal: Row, span_s: float) -> None:
        """Move to ``goal`` from the next cycle on, within ``span_s`` if the joints are fast enough.
        The same goal again changes nothing."""
        if goal != self._goal:
            self._goal, self._span_s = goal, span_s
            self._per_cycle = ()

    def hold(self) -> None:
        """Repeat the last commanded position from the next cycle on."""
        self._goal = self._per_cycle = ()

    def is_due(self, said: Monitoring) -> bool:
        """Tell whether a message wants an answer: with a receive multiplier only every so many do,
        and one that came twice or late does not."""
        if self._answered is None:
            return True
        ahead = (said.sequence - self._answered) & COUNTER
        return said.multiplier <= ahead <= COUNTER - LATE

    def next_number(self, said: Monitoring) -> int:
        """Return the number of the next answer. Own numbers go on from what the controller has
        taken last, by whoever that was sent."""
        return ((said.reflected if self._answered is None else self._sequence) + 1) & COUNTER

    def answer(self, said: Monitoring) -> Command:
        """Answer a message that is due."""
        number = self.next_number(said)
        missed = (said.reflected + 1) & COUNTER != number
        position = self._next(said, missed)
        self._commanded = position
        self._answered = said.sequence
        self._sequence = number
        return Command(self._sequence, said.sequence, position)

    def again(self, said: Monitoring) -> Command:
        """Hold, in answer to a message that was answered already: when no newer one comes."""
        self.hold()
        self._sequence = (self._sequence + 1) & COUNTER
        return Command(self._sequence, said.sequence, self._commanded)

    def _next(self, said: Monitoring, missed: bool) -> Row:
        if said.state == State.COMMANDING_ACTIVE:
            # After an answer that did not arrive go on from what the controller has: two steps at
            # once are a jump.
            before = said.commanded if missed or not self._commanded else self._commanded
            return self._step(before, said) if self._goal else before
        self.hold()  # a goal does not outlive the session that it was given in
        if said.state == State.COMMANDING_WAIT:
            return said.interpolated or said.commanded
        return ()

    def _step(self, before: Row, said: Monitoring) -> Row:
        """At most speed x sample time, and no more than spreads the way over the span."""
        cycle_s = said.sample_ms * said.multiplier / 1e3
        if not self._per_cycle:
            cycles = max(1.0, round(self._span_s / cycle_s))
            self._per_cycle = tuple(
                min(speed * cycle_s, abs(to - rad) / cycles) + 4 * LIVE_RAD
                for speed, to, rad in zip(self._speed_rad_s, self._goal, before, strict=True)
            )
        after = tuple(
            to if abs(to - rad) <= most else rad + (most if to > rad else -most)
            for rad, to, most in zip(before, self._goal, self._per_cycle, strict=True)
        )
        while after in (before, self._commanded):  # one of them the controller has heard last
            first = after[0] - LIVE_RAD if after[0] > 0 else after[0] + LIVE_RAD
            after = (first, *after[1:])
        return after
