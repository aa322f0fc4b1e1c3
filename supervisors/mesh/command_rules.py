"""Check a command from the mesh before it is carried out: its form, its type, its age, and how many commands its
sender sends per second. Pure: no clock, no I/O."""

from __future__ import annotations

import functools
import secrets
from collections.abc import Callable, Iterable

import msgspec

from strands_actors.kernel.clock import NS
from strands_actors.kernel.messages import Refused
from strands_actors.supervisors.gate.lease import refuse_by_deadline

from . import refusals
from .refusals import MISSING_ACTIONS
from .schemas import ACTIONS, MAX_COMMAND_BYTES, Command, Dated, Envelope, Sender, plain
from .sessions import CLOCK_TTL_S, Sessions

_MAX_CLOCKS = 64
_MAX_TURNS = 256
_MAX_SENDERS = 64

_decode_envelope = msgspec.json.Decoder(Envelope).decode
_decode_sender = msgspec.json.Decoder(Sender).decode


class _Action(msgspec.Struct):
    action: str = "status"  # default action of strands-robots


_decode_action = msgspec.json.Decoder(_Action).decode


@functools.cache
def _decoder(command_type: type[Command]) -> msgspec.json.Decoder[Command]:
    return msgspec.json.Decoder(command_type)


class Limit:
    """A limit of ``rate`` events per second. At most ``burst`` of them may come at once (a token bucket)."""

    def __init__(self, rate: int, burst: int) -> None:
        self._rate = rate
        self._burst = float(burst)
        self._tokens = float(burst)
        self._at_ns = 0

    def admits(self, now_ns: int) -> bool:
        """Count one event. Return False if it exceeds the limit."""
        passed_s = (now_ns - self._at_ns) / NS if self._at_ns else 0.0
        self._at_ns = now_ns
        self._tokens = min(self._burst, self._tokens + passed_s * self._rate)
        if self._tokens < 1.0:
            return False
        self._tokens -= 1.0
        return True

    def refuse(self, now_ns: int) -> Refused | None:
        """Count one command. Return a refusal if it exceeds the limit."""
        if self.admits(now_ns):
            return None
        return refusals.too_many_commands(self._rate)


class Limits:
    """A ``Limit`` for each sender. If one sender sends too many commands, those of other senders are still
    accepted.

    When the table is full, the sender that has sent nothing for the longest time is removed. Its limit then starts
    again.
    """

    def __init__(self, rate: int, burst: int) -> None:
        self._rate = rate
        self._burst = burst
        self._of: dict[str, Limit] = {}

    def refuse(self, sender: str, now_ns: int) -> Refused | None:
        """Count one command of this sender. Return a refusal if it exceeds the sender's limit."""
        limit = self._of.pop(sender, None) or Limit(self._rate, self._burst)
        if len(self._of) >= _MAX_SENDERS:
            del self._of[next(iter(self._of))]
        self._of[sender] = limit
        return limit.refuse(now_ns)


class Clocks:
    """The senders that have read the robot's clock.

    Each reading of the clock has a secret name. A command with a deadline must contain the name of such a reading.
    Only the sender knows the name, so the name also proves the sender.
    """

    def __init__(self) -> None:
        # For each sender: name of its last reading of the clock, and when that expires.
        self._read: dict[str, tuple[str, int]] = {}

    def read(self, sender: str, now_ns: int) -> str:
        """Note that a sender reads the clock now. Return the secret name of this reading."""
        name = secrets.token_hex(16)
        self._read.pop(sender, None)
        if len(self._read) >= _MAX_CLOCKS:
            del self._read[next(iter(self._read))]
        self._read[sender] = name, now_ns + round(CLOCK_TTL_S * NS)
        return name

    def refuse(self, sender: str, clock: str, deadline_ns: int, now_ns: int) -> Refused | None:
        """Return a refusal for a command without a valid reading of the clock, or with a deadline that has passed
        or is too far ahead.

        Args:
            sender: The sender.
            clock: The secret name of the sender's reading.
            deadline_ns: The deadline, on the robot's clock.
            now_ns: The time.
        """
        name, expires_ns = self._read.get(sender, ("", 0))
        if clock != name or now_ns >= expires_ns:
            return refusals.clock_not_read(plain(sender), CLOCK_TTL_S)
        return refuse_by_deadline(deadline_ns, now_ns)


class Turns:
    """The turn ids of commands that move the robot beyond their own deadline. If such a command arrives twice, only
    the first one is carried out."""

    def __init__(self) -> None:
        self._done: dict[tuple[str, str], None] = {}

    def is_new(self, sender: str, turn: str) -> bool:
        """Store the turn id of a command. Return False if this sender has used it before."""
        if (sender, turn) in self._done:
            return False
        if len(self._done) >= _MAX_TURNS:
            del self._done[next(iter(self._done))]
        self._done[sender, turn] = None
        return True


class Shared:
    """State that the actors on the mesh share. It is kept when one of these actors is restarted."""

    def __init__(self) -> None:
        self.clocks = Clocks()
        self.resumed_epoch = 0  # the epoch in which a hold needs no resume (``refuse_by_mode``)
        # The function that writes the audit: (sender, command, decision, route of the command).
        self.audit: Callable[[str, str, str, str], None] = lambda *_: None
        self.received = 0  # number of received commands, valid or not
        self.turns = Turns()
        self.sessions = Sessions()  # sessions of callers on other hosts


def read_envelope(payload: bytes, limit: int = MAX_COMMAND_BYTES) -> Envelope | tuple[Sender | None, Refused]:
    """Decode an envelope, the outer part of a command's message. If it is invalid, return a refusal and the
    sender's name, or None in place of a name that cannot be read either."""
    try:
        envelope = _decode_envelope(payload)
    except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError) as error:
        return read_sender(payload), refusals.invalid_message(error)
    if len(payload) > limit:
        return Sender(envelope.sender_id, envelope.turn_id), refusals.oversized(len(payload), limit)
    return envelope


def read_sender(payload: bytes) -> Sender | None:
    """Return the sender of a payload; None if it cannot be read."""
    try:
        return _decode_sender(payload)
    except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError):
        return None


def no_action(action: str, offered: Iterable[str] = tuple(ACTIONS)) -> Refused:
    """Return the refusal of an action that this robot does not offer."""
    action = action[:64]
    if action in MISSING_ACTIONS and action not in ACTIONS:
        reason, remedy = MISSING_ACTIONS[action]
        return refusals.missing_action(action, reason, remedy)
    return refusals.unknown_action(action, ", ".join(offered))


def read_command(envelope: Envelope, offered: tuple[str, ...] = tuple(ACTIONS)) -> Command | Refused:
    """Decode the command of an envelope. Return a refusal if its action is not in ``offered`` or the command is
    invalid."""
    try:
        action = _decode_action(envelope.command).action
    except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError) as error:
        return refusals.invalid_json(error)
    if action not in offered:
        return no_action(action, offered)
    try:
        return _decoder(ACTIONS[action]).decode(envelope.command)
    except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError) as error:
        return refusals.invalid_fields(error).about(action)


def refuse_stale(clocks: Clocks, sender: str, command: Command, now_ns: int) -> Refused | None:
    """Return the result of ``Clocks.refuse`` for a command with a deadline; None for a command without one."""
    if isinstance(command, Dated):
        return clocks.refuse(sender, command.clock, command.deadline_ns, now_ns)
    return None
