"""Check a command from the mesh before it is carried out: its form, its type, its age, and the rate of its
sender. Pure: no clock, no I/O."""

from __future__ import annotations

import functools
import secrets
from collections.abc import Callable, Iterable, Mapping

import msgspec

from strands_actors.kernel.clock import NS
from strands_actors.kernel.messages import Refused
from strands_actors.kernel.refusals import Code
from strands_actors.supervisors.gate.lease import refuse_by_deadline

from .schemas import ACTIONS, MAX_COMMAND_BYTES, Command, Dated, Envelope, Sender, command_key, plain
from .sessions import CLOCK_TTL_S, Sessions

_MAX_CLOCKS = 64
_MAX_TURNS = 256
_MAX_SENDERS = 64

_decode_envelope = msgspec.json.Decoder(Envelope).decode
_decode_sender = msgspec.json.Decoder(Sender).decode


class _Action(msgspec.Struct):
    action: str = "status"  # the default of strands-robots


_decode_action = msgspec.json.Decoder(_Action).decode


@functools.cache
def _decoder(kind: type[Command]) -> msgspec.json.Decoder[Command]:
    return msgspec.json.Decoder(kind)


class Limit:
    """A limit of ``rate`` per second, with at most ``burst`` at once (a token bucket)."""

    def __init__(self, rate: int, burst: int) -> None:
        self._rate = rate
        self._burst = float(burst)
        self._left = float(burst)
        self._at_ns = 0

    def admits(self, now_ns: int) -> bool:
        """Count one event. Return False if it exceeds the limit."""
        passed_s = (now_ns - self._at_ns) / NS if self._at_ns else 0.0
        self._at_ns = now_ns
        self._left = min(self._burst, self._left + passed_s * self._rate)
        if self._left < 1.0:
            return False
        self._left -= 1.0
        return True

    def refuse(self, now_ns: int) -> Refused | None:
        """Count one command. Return a refusal if it exceeds the limit."""
        if self.admits(now_ns):
            return None
        return Refused(Code.RATE, f"more than {self._rate} commands a second", "send fewer", limit=f"{self._rate}")


class Limits:
    """A ``Limit`` for each sender, so that a flood from one does not get another's commands refused.

    When the table is full, the sender that was silent longest is dropped. Its limit then starts anew.
    """

    def __init__(self, rate: int, burst: int) -> None:
        self._rate = rate
        self._burst = burst
        self._of: dict[str, Limit] = {}

    def refuse(self, sender: str, now_ns: int) -> Refused | None:
        """As ``Limit.refuse``, for this sender."""
        limit = self._of.pop(sender, None) or Limit(self._rate, self._burst)
        if len(self._of) >= _MAX_SENDERS:
            del self._of[next(iter(self._of))]
        self._of[sender] = limit
        return limit.refuse(now_ns)


class Clocks:
    """The senders that have read the robot's clock.

    A command names the reading by which its deadline is set. Only the sender knows this name, so it also
    identifies the sender.
    """

    def __init__(self) -> None:
        self._read: dict[str, tuple[str, int]] = {}  # by sender: the reading's name, when it expires

    def read(self, sender: str, now_ns: int) -> str:
        """Note that a sender reads the clock now, and return the name of the reading."""
        name = secrets.token_hex(16)
        self._read.pop(sender, None)
        if len(self._read) >= _MAX_CLOCKS:
            del self._read[next(iter(self._read))]
        self._read[sender] = name, now_ns + round(CLOCK_TTL_S * NS)
        return name

    def refuse(self, sender: str, clock: str, deadline_ns: int, now_ns: int) -> Refused | None:
        """Return a refusal for a command without a valid reading of the clock, or with a deadline that
        has passed or lies too far ahead.

        Args:
            sender: The sender.
            clock: The name of the reading.
            deadline_ns: The deadline, on the robot's clock.
            now_ns: The time.
        """
        name, expires_ns = self._read.get(sender, ("", 0))
        if clock != name or now_ns >= expires_ns:
            why = f"{plain(sender)} has not read this robot's clock in the last {CLOCK_TTL_S:g} s"
            return Refused(Code.CLOCK, why, "send sync first")
        return refuse_by_deadline(deadline_ns, now_ns)


class Turns:
    """The turns of commands that move the robot beyond their own deadline. A repeated one is carried out
    only once."""

    def __init__(self) -> None:
        self._done: dict[tuple[str, str], None] = {}

    def is_new(self, sender: str, turn: str) -> bool:
        """Note a turn. Return False if it was noted before."""
        if (sender, turn) in self._done:
            return False
        if len(self._done) >= _MAX_TURNS:
            del self._done[next(iter(self._done))]
        self._done[sender, turn] = None
        return True


class Shared:
    """State that the robot's actors on the mesh share. It survives their restarts."""

    def __init__(self) -> None:
        self.clocks = Clocks()
        self.resumed_epoch = 0  # in which a hold needs no resume (``refuse_by_mode``)
        # Called with sender, command, decision, and the route of the command.
        self.audit: Callable[[str, str, str, str], None] = lambda *_: None
        self.taken = 0  # commands that were received, valid or not
        self.turns = Turns()
        self.sessions = Sessions()  # of callers of other hosts


def read_envelope(payload: bytes, limit: int = MAX_COMMAND_BYTES) -> Envelope | tuple[Sender | None, Refused]:
    """Decode an envelope. If that fails, return its sender, as far as that can be read, and a refusal."""
    try:
        envelope = _decode_envelope(payload)
    except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError) as error:
        remedy = 'send {"sender_id", "turn_id", "command": {"action", ...}}'
        return read_sender(payload), Refused(Code.MALFORMED, f"this is no command: {error}", remedy)
    if len(payload) > limit:
        remedy = f"send at most {limit} bytes"
        oversized = Refused(Code.OVERSIZED, f"{len(payload)} bytes", remedy, str(len(payload)), str(limit))
        return Sender(envelope.sender_id, envelope.turn_id), oversized
    return envelope


def read_sender(payload: bytes) -> Sender | None:
    """Return the sender of a payload; None if it cannot be read."""
    try:
        return _decode_sender(payload)
    except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError):
        return None


_TELEOP = (
    "a robot follows no input stream of another peer",
    "run the teleoperation beside the robot, or send moves under a lease: acquire, move",
)
_CALL = (
    "a robot's tool is not called over the mesh; two ways in are one too many to guard",
    "describe_tool shows the tool; an agent or an MCP client beside the robot uses it",
)
NOT_HERE: Mapping[str, tuple[str, str]] = {
    "call": _CALL,
    "sim_call": _CALL,
    "teleop_receive": _TELEOP,
    "teleop_stop": _TELEOP,
}
"""Actions of strands-robots that are missing here, with the reason and the remedy."""


def no_action(action: str, offered: Iterable[str] = tuple(ACTIONS)) -> Refused:
    """Return the refusal of an action that is not offered."""
    action = action[:64]
    if action in NOT_HERE and action not in ACTIONS:
        why, remedy = NOT_HERE[action]
        return Refused(Code.NOT_HERE, f"{action!r} is not here: {why}", remedy, action)
    return Refused(Code.UNKNOWN_ACTION, f"{action!r} is no action here", f"send {', '.join(offered)}", action)


def read_command(envelope: Envelope, offered: tuple[str, ...] = tuple(ACTIONS)) -> Command | Refused:
    """Decode the command of an envelope, if its action is one of those offered."""
    try:
        action = _decode_action(envelope.command).action
    except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError) as error:
        return Refused(Code.MALFORMED, f"the command cannot be read: {error}", 'send {"action": ...}')
    if action not in offered:
        return no_action(action, offered)
    try:
        return _decoder(ACTIONS[action]).decode(envelope.command)
    except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError) as error:
        return Refused(Code.MALFORMED, str(error), verb=action)


def to_be_asked(robot: str) -> str:
    """Return the remedy for a command that must be a query."""
    return f"ask: a zenoh query (get) on {command_key(robot, '<your name>')}"


def refuse_stale(clocks: Clocks, sender: str, command: Command, now_ns: int) -> Refused | None:
    """As ``Clocks.refuse``. A command without a deadline is never refused."""
    if isinstance(command, Dated):
        return clocks.refuse(sender, command.clock, command.deadline_ns, now_ns)
    return None
