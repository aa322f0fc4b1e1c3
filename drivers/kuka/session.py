"""What a client of FRI answers, cycle by cycle. Pure: no clock, no socket.

A message is believed as far as our own answers go: it is news when its number goes on, and what the
controller has taken is looked up in what we sent, by the number that it names. So a message that is
repeated, late or forged neither moves a hold nor confirms one (SAF-022).

In every cycle one answer: without positions while the controller only monitors, its own
interpolated position while it waits for that, and from then on the last commanded position, or a
step from it towards the goal. Holding is repeating the answer. While a setpoint lives no two
answers are alike, by ``LIVE_RAD`` at least: so a hold can be told from a setpoint on the wire.
"""

from __future__ import annotations

from collections.abc import Sequence

from .protocol import COUNTER, Command, Monitoring, State, has_reached

LIVE_RAD = 1e-12
"""A millionth of what an encoder can tell."""
LATE = 10
"""A message that is so few numbers behind was overtaken on the way. A larger step back is a new
session, which begins by monitoring: one that commands has been answered for seconds."""
RUN, GAP = 3, 2
"""Where numbers do not go on from the last one, so many messages are believed that follow each other,
by ``GAP`` at most. One alone may be an old one: the arm has left the position that it tells."""
MOST_SENT = 256
"""Answers that are remembered. A controller drops the session after a few that it has not taken."""

Row = tuple[float, ...]


def follow_each_other(run: Sequence[Monitoring], said: Monitoring) -> bool:
    """Tell whether a message goes on from the last one of a run."""
    return bool(run) and 0 < (said.sequence - run[-1].sequence) & COUNTER <= GAP


class FriSession:
    """The client's side of one session. ``speed_rad_s``: how fast each joint may be commanded."""

    def __init__(self, speed_rad_s: Row) -> None:
        self._speed_rad_s = speed_rad_s
        self._answered: int | None = None  # sequence of the message that was answered last
        self._heard: int | None = None  # sequence of the newest message
        self._unconnected: list[Monitoring] = []  # that follow each other, and not the newest
        self._sent: dict[int, Row] = {}  # positions by number, from the one that was taken last
        self._sequence = 0
        self._sent_by_then = 0  # sequence of the last answer when that message came
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

    def hear(self, said: Monitoring) -> bool:
        """Note a message. Return whether it is news: its number goes on, or a session begins that
        does."""
        if self._heard is not None:
            ahead = (said.sequence - self._heard) & COUNTER
            if not ahead or ahead > COUNTER - LATE:
                return False
            if ahead > LATE and not self._goes_on(said):
                return False
            if ahead > COUNTER // 2 and said.state >= State.COMMANDING_WAIT:
                return False
        self._heard, self._sent_by_then = said.sequence, self._sequence
        return True

    def _goes_on(self, said: Monitoring) -> bool:
        follows = follow_each_other(self._unconnected, said)
        self._unconnected = [*self._unconnected, said][-RUN:] if follows else [said]
        return len(self._unconnected) == RUN

    def is_due(self, said: Monitoring) -> bool:
        """Tell whether a message wants an answer: with a receive multiplier only every so many do,
        and one that came twice or late does not."""
        if self._answered is None:
            return True
        ahead = (said.sequence - self._answered) & COUNTER
        return said.multiplier <= ahead <= COUNTER - LATE

    def has_taken(self, said: Monitoring, number: int) -> bool:
        """Tell whether the newest message says that the controller has an answer, or a later one that
        had been sent by then."""
        return has_reached(said.reflected, number) and has_reached(self._sent_by_then, said.reflected)

    def next_number(self, said: Monitoring) -> int:
        """Return the number of the next answer. Own numbers go on from what the controller has
        taken last, by whoever that was sent."""
        return ((said.reflected if self._answered is None else self._sequence) + 1) & COUNTER

    def answer(self, said: Monitoring) -> Command:
        """Answer a message that is due."""
        number = self.next_number(said)
        if self._answered is None:
            self._sent[said.reflected] = said.commanded  # by whoever answered before
        missed = (said.reflected + 1) & COUNTER != number
        position = self._next(said, missed)
        self._answered = said.sequence
        return self._send(number, said, position)

    def again(self, said: Monitoring) -> Command:
        """Hold, in answer to a message that was answered already: when no newer one comes."""
        self.hold()
        return self._send((self._sequence + 1) & COUNTER, said, self._commanded)

    def _send(self, number: int, said: Monitoring, position: Row) -> Command:
        self._commanded = self._sent[number] = position
        self._sequence = number
        if len(self._sent) > MOST_SENT:
            del self._sent[next(iter(self._sent))]
        return Command(number, said.sequence, position)

    def _taken(self, said: Monitoring) -> Row:
        """Return the position of the answer that the controller has, as it was sent; where it names
        none of ours, of the last one."""
        if said.reflected not in self._sent:
            return self._commanded
        while next(iter(self._sent)) != said.reflected:
            del self._sent[next(iter(self._sent))]  # the controller does not go back to those
        return self._sent[said.reflected] or self._commanded

    def _next(self, said: Monitoring, missed: bool) -> Row:
        if said.state == State.COMMANDING_ACTIVE:
            # After an answer that did not arrive go on from what the controller has: two steps at
            # once are a jump.
            before = self._taken(said) if missed else self._commanded
            before = before or said.commanded
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
