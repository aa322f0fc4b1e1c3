"""Compute the client's answers in an FRI session, cycle by cycle. Pure: no clock, no socket.

A message is checked against our own answers. It is new if its sequence number continues the last one. The
position that the controller has taken is looked up in the sent answers, by the number that the message
reflects. A repeated, late or forged message therefore neither moves a hold nor confirms one (SAF-022).

Every cycle gets one answer, by the state of the session:

    monitoring           no positions
    COMMANDING_WAIT      the controller's own interpolated position
    COMMANDING_ACTIVE    the last commanded position, or a step from it towards the goal

To hold means to repeat the answer. While a setpoint is valid, successive answers differ by at least
``LIVE_RAD``, so that a hold and a setpoint can be distinguished on the wire.
"""

from __future__ import annotations

from collections.abc import Sequence

from .protocol import COUNTER, Command, Monitoring, State, has_reached

LIVE_RAD = 1e-12
"""A millionth of an encoder's resolution."""
LATE = 10
"""A message this few numbers behind was overtaken on the way. A larger step back is a new session. A new
session begins by monitoring, so a message in a commanding state cannot belong to one."""
RUN, GAP = 3, 2
"""After a gap in the numbers, ``RUN`` messages are required that follow each other by ``GAP`` at most. A single
one may be old: the arm has left the position in it."""
MOST_SENT = 256
"""Number of answers to remember. A controller drops the session after a few that it has not taken."""

Row = tuple[float, ...]


def follow_each_other(run: Sequence[Monitoring], said: Monitoring) -> bool:
    """Return whether a message continues a run of messages."""
    return bool(run) and 0 < (said.sequence - run[-1].sequence) & COUNTER <= GAP


class FriSession:
    """The client's side of one session. ``speed_rad_s`` is the fastest commanded speed of each joint."""

    def __init__(self, speed_rad_s: Row) -> None:
        self._speed_rad_s = speed_rad_s
        self._answered: int | None = None  # sequence of the last answered message
        self._heard: int | None = None  # sequence of the newest message
        self._unconnected: list[Monitoring] = []  # a run of messages that does not continue the newest
        self._sent: dict[int, Row] = {}  # sent positions by number, from the last taken one on
        self._sequence = 0
        self._sent_by_then = 0  # sequence of our last answer when the newest message arrived
        self._commanded: Row = ()  # position in the last answer; empty for no position
        self._goal: Row = ()
        self._span_s = 0.0
        self._per_cycle: Row = ()

    @property
    def commanded(self) -> Row:
        """The position that the arm is commanded to; empty for no position."""
        return self._commanded

    @property
    def has_goal(self) -> bool:
        return bool(self._goal)

    def aim(self, goal: Row, span_s: float) -> None:
        """Move to ``goal`` from the next cycle on. Repeating the same goal changes nothing.

        Args:
            goal: Positions in rad.
            span_s: Time for the motion. Joints that are too slow take longer.
        """
        if goal != self._goal:
            self._goal, self._span_s = goal, span_s
            self._per_cycle = ()

    def hold(self) -> None:
        """Repeat the last commanded position from the next cycle on."""
        self._goal = self._per_cycle = ()

    def hear(self, said: Monitoring) -> bool:
        """Note a message. Return whether it is new: its number continues the last one, or it belongs to a new
        session."""
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
        """Return whether an answer is due. With a receive multiplier only one message in several is answered. A
        repeated or late message gets no answer."""
        if self._answered is None:
            return True
        ahead = (said.sequence - self._answered) & COUNTER
        return said.multiplier <= ahead <= COUNTER - LATE

    def has_received_answer(self, said: Monitoring, number: int) -> bool:
        """Return whether the controller has taken answer ``number``, or a later one that was sent before the
        newest message arrived."""
        return has_reached(said.reflected, number) and has_reached(self._sent_by_then, said.reflected)

    def next_number(self, said: Monitoring) -> int:
        """Return the number of the next answer. Our first number continues the last one that the controller has
        taken, from any client."""
        return ((said.reflected if self._answered is None else self._sequence) + 1) & COUNTER

    def answer(self, said: Monitoring) -> Command:
        """Return the answer to a message that is due."""
        number = self.next_number(said)
        if self._answered is None:
            self._sent[said.reflected] = said.commanded  # sent by an earlier client
        missed = (said.reflected + 1) & COUNTER != number
        position = self._next(said, missed)
        self._answered = said.sequence
        return self._send(number, said, position)

    def again(self, said: Monitoring) -> Command:
        """Return a hold in answer to an old message, for use when no newer one arrives."""
        self.hold()
        return self._send((self._sequence + 1) & COUNTER, said, self._commanded)

    def _send(self, number: int, said: Monitoring, position: Row) -> Command:
        self._commanded = self._sent[number] = position
        self._sequence = number
        if len(self._sent) > MOST_SENT:
            del self._sent[next(iter(self._sent))]
        return Command(number, said.sequence, position)

    def _taken(self, said: Monitoring) -> Row:
        """Return the position that the controller has taken, as it was sent. If the controller reflects none of
        our numbers, return the last sent position."""
        if said.reflected not in self._sent:
            return self._commanded
        while next(iter(self._sent)) != said.reflected:
            del self._sent[next(iter(self._sent))]  # The controller does not go back to these.
        return self._sent[said.reflected] or self._commanded

    def _next(self, said: Monitoring, missed: bool) -> Row:
        if said.state == State.COMMANDING_ACTIVE:
            # After a lost answer, continue from the position that the controller has. Otherwise two steps at
            # once would be a jump.
            before = self._taken(said) if missed else self._commanded
            before = before or said.commanded
            return self._step(before, said) if self._goal else before
        self.hold()  # A goal ends with the session in which it was given.
        if said.state == State.COMMANDING_WAIT:
            return said.interpolated or said.commanded
        return ()

    def _step(self, before: Row, said: Monitoring) -> Row:
        """Return the next step: at most speed x sample time, and at most an even share of the distance."""
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
        while after in (before, self._commanded):  # The controller received one of these last.
            first = after[0] - LIVE_RAD if after[0] > 0 else after[0] + LIVE_RAD
            after = (first, *after[1:])
        return after
