"""Compute the client's answers in an FRI session, cycle by cycle. Pure: no clock, no socket.

A message of the controller is never trusted alone. It counts as new only if its sequence number continues that of
the last message. It also has the number of the last answer that the controller has accepted. The position in that
answer is taken from our own list of sent answers. So a repeated, late or forged message cannot move an arm that is
held, and cannot confirm a hold (requirement SAF-022).

In every cycle one answer is sent. Its positions depend on the state of the session:

    monitoring           no positions
    COMMANDING_WAIT      the controller's own interpolated position
    COMMANDING_ACTIVE    the last commanded position, or a step from it towards the goal

To hold the arm, the same positions are sent again. While a setpoint is valid, successive answers differ by at least
``LIVE_RAD``. So a log of the network shows whether an answer was a hold or a setpoint.
"""

from __future__ import annotations

from collections.abc import Sequence

from .protocol import COUNTER, Command, Monitoring, State, has_reached

LIVE_RAD = 1e-12
"""A millionth of an encoder's resolution."""
LATE = 10
"""A message up to this many numbers behind the newest was delayed in the network. A message further behind shows a
new session, but not if it is in a commanding state: a new session begins in a monitoring state."""
RUN, GAP = 3, 2
"""After a gap in the sequence numbers, ``RUN`` messages in a row are required, with numbers at most ``GAP`` apart.
A single message may be an old one, with a position that the arm has left."""
MOST_SENT = 256
"""Number of sent answers to remember. A controller ends the session after fewer answers that it did not accept."""

Row = tuple[float, ...]


def follow_each_other(run: Sequence[Monitoring], message: Monitoring) -> bool:
    """Return True if ``message`` follows the last message of ``run``: its number is at most ``GAP`` later."""
    return bool(run) and 0 < (message.sequence - run[-1].sequence) & COUNTER <= GAP


class FriSession:
    """The client's state in one FRI session, and its answers. ``speed_rad_s`` limits the speed of each joint."""

    def __init__(self, speed_rad_s: Row) -> None:
        self._speed_rad_s = speed_rad_s
        self._answered: int | None = None  # Sequence number of the last message that was answered.
        self._newest: int | None = None  # Sequence number of the newest message.
        self._unconnected: list[Monitoring] = []  # Successive messages after a gap in the sequence numbers.
        # Sent positions by answer number, from the last answer that the controller has accepted.
        self._sent: dict[int, Row] = {}
        self._sequence = 0
        self._sent_by_then = 0  # Number of our last answer at the time when the newest message arrived.
        self._commanded: Row = ()  # Positions in the last answer. Empty if it had no positions.
        self._goal: Row = ()
        self._span_s = 0.0
        self._per_cycle: Row = ()

    @property
    def commanded(self) -> Row:
        """The joint positions in the last answer, in rad. Empty if it had no positions."""
        return self._commanded

    @property
    def has_goal(self) -> bool:
        return bool(self._goal)

    def aim(self, goal: Row, span_s: float) -> None:
        """Move to ``goal`` from the next cycle on. Repeating the same goal changes nothing.

        Args:
            goal: Positions in rad.
            span_s: Time for the motion in seconds. A joint whose speed limit is too low takes longer.
        """
        if goal != self._goal:
            self._goal, self._span_s = goal, span_s
            self._per_cycle = ()

    def hold(self) -> None:
        """Repeat the last commanded position from the next cycle on."""
        self._goal = self._per_cycle = ()

    def accept(self, message: Monitoring) -> bool:
        """Check the sequence number of a received message, and store it if the message is new.

        Return True if it is new: its number continues that of the last message, or it begins a new session.
        """
        if self._newest is not None:
            ahead = (message.sequence - self._newest) & COUNTER
            if not ahead or ahead > COUNTER - LATE:
                return False
            if ahead > LATE and not self._goes_on(message):
                return False
            if ahead > COUNTER // 2 and message.state >= State.COMMANDING_WAIT:
                return False
        self._newest, self._sent_by_then = message.sequence, self._sequence
        return True

    def _goes_on(self, message: Monitoring) -> bool:
        follows = follow_each_other(self._unconnected, message)
        self._unconnected = [*self._unconnected, message][-RUN:] if follows else [message]
        return len(self._unconnected) == RUN

    def is_due(self, message: Monitoring) -> bool:
        """Return True if this message must be answered.

        With a receive multiplier N, only every N-th message is answered. A repeated or late message is not
        answered.
        """
        if self._answered is None:
            return True
        ahead = (message.sequence - self._answered) & COUNTER
        return message.multiplier <= ahead <= COUNTER - LATE

    def has_received_answer(self, message: Monitoring, number: int) -> bool:
        """Return True if ``message`` shows that the controller has accepted answer ``number`` or a later answer.

        A number that was not yet sent when the message arrived does not count.
        """
        return has_reached(message.reflected, number) and has_reached(self._sent_by_then, message.reflected)

    def next_number(self, message: Monitoring) -> int:
        """Return the sequence number for the next answer.

        The first number of this client continues the last number that the controller has accepted from any client.
        """
        return ((message.reflected if self._answered is None else self._sequence) + 1) & COUNTER

    def answer(self, message: Monitoring) -> Command:
        """Return the answer to a message for which ``is_due`` is True."""
        number = self.next_number(message)
        if self._answered is None:
            self._sent[message.reflected] = message.commanded  # An earlier client has sent this answer.
        missed = (message.reflected + 1) & COUNTER != number
        position = self._next(message, missed)
        self._answered = message.sequence
        return self._send(number, message, position)

    def again(self, message: Monitoring) -> Command:
        """Return one more answer to a message that was already answered. This answer holds the arm. It is sent
        when no new message arrives."""
        self.hold()
        return self._send((self._sequence + 1) & COUNTER, message, self._commanded)

    def _send(self, number: int, message: Monitoring, position: Row) -> Command:
        self._commanded = self._sent[number] = position
        self._sequence = number
        if len(self._sent) > MOST_SENT:
            del self._sent[next(iter(self._sent))]
        return Command(number, message.sequence, position)

    def _accepted_position(self, message: Monitoring) -> Row:
        """Return the positions in the last answer that the controller has accepted.

        If the controller reports a number that we did not send, return the positions in our last answer.
        """
        if message.reflected not in self._sent:
            return self._commanded
        while next(iter(self._sent)) != message.reflected:
            del self._sent[next(iter(self._sent))]  # The controller has accepted a later answer than this one.
        return self._sent[message.reflected] or self._commanded

    def _next(self, message: Monitoring, missed: bool) -> Row:
        if message.state == State.COMMANDING_ACTIVE:
            # After a lost answer, continue from the position that the controller has accepted. Otherwise the arm
            # would make two steps at once.
            before = self._accepted_position(message) if missed else self._commanded
            before = before or message.commanded
            return self._step(before, message) if self._goal else before
        self.hold()  # Outside COMMANDING_ACTIVE, forget the goal, so that it does not move the arm later.
        if message.state == State.COMMANDING_WAIT:
            return message.interpolated or message.commanded
        return ()

    def _step(self, before: Row, message: Monitoring) -> Row:
        """Return the positions for the next answer, one step from ``before`` towards the goal.

        A joint moves at most at its speed limit, and at most by an equal share of its distance: the distance
        divided by the number of cycles that the motion should take.
        """
        cycle_s = message.sample_ms * message.multiplier / 1e3
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
        # The answer must differ from the last one, or it would look like a hold. So change it by a tiny amount.
        while after in (before, self._commanded):
            first = after[0] - LIVE_RAD if after[0] > 0 else after[0] + LIVE_RAD
            after = (first, *after[1:])
        return after
