"""Whether a command from the mesh may be looked at: read, typed, fresh, not too many. Pure: no
clock, no I/O."""

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
    action: str = "status"  # as strands-robots reads a command that names none


_decode_action = msgspec.json.Decoder(_Action).decode


@functools.cache
def _decoder(kind: type[Command]) -> msgspec.json.Decoder[Command]:
    return msgspec.json.Decoder(kind)


class Limit:
    """At most ``rate`` a second, and ``burst`` at once."""

    def __init__(self, rate: int, burst: int) -> None:
        self._rate = rate
        self._burst = float(burst)
        self._left = float(burst)
        self._at_ns = 0

    def admits(self, now_ns: int) -> bool:
        passed_s = (now_ns - self._at_ns) / NS if self._at_ns else 0.0
        self._at_ns = now_ns
        self._left = min(self._burst, self._left + passed_s * self._rate)
        if self._left < 1.0:
            return False
        self._left -= 1.0
        return True

    def refuse(self, now_ns: int) -> Refused | None:
        """Return why a command comes too soon after others; None: it does not."""
        if self.admits(now_ns):
            return None
        return Refused(Code.RATE, f"more than {self._rate} commands a second", "send fewer", limit=f"{self._rate}")


class Limits:
    """A ``Limit`` for each sender: nobody's flood has the commands of another refused.

    The one who has been silent longest is forgotten first, and begins anew.
    """

    def __init__(self, rate: int, burst: int) -> None:
        self._rate = rate
        self._burst = burst
        self._of: dict[str, Limit] = {}

    def refuse(self, sender: str, now_ns: int) -> Refused | None:
        """As ``Limit.refuse``, of this sender."""
        limit = self._of.pop(sender, None) or Limit(self._rate, self._burst)
        if len(self._of) >= _MAX_SENDERS:
            del self._of[next(iter(self._of))]
        self._of[sender] = limit
        return limit.refuse(now_ns)


class Clocks:
    """Who has read our clock. A command names the reading it is dated by. That name is told to the
    sender alone, so it says who sends, too."""

    def __init__(self) -> None:
        self._read: dict[str, tuple[str, int]] = {}  # by sender: the reading's name, when it expires

    def read(self, sender: str, now_ns: int) -> str:
        name = secrets.token_hex(16)
        self._read.pop(sender, None)
        if len(self._read) >= _MAX_CLOCKS:
            del self._read[next(iter(self._read))]
        self._read[sender] = name, now_ns + round(CLOCK_TTL_S * NS)
        return name

    def refuse(self, sender: str, clock: str, deadline_ns: int, now_ns: int) -> Refused | None:
        """None when the command is dated by our clock and its time has neither passed nor is far
        away."""
        name, expires_ns = self._read.get(sender, ("", 0))
        if clock != name or now_ns >= expires_ns:
            why = f"{plain(sender)} has not read this robot's clock in the last {CLOCK_TTL_S:g} s"
            return Refused(Code.CLOCK, why, "send sync first")
        return refuse_by_deadline(deadline_ns, now_ns)


class Turns:
    """Commands that moved the robot for longer than they live themselves: one that comes again is
    done once."""

    def __init__(self) -> None:
        self._done: dict[tuple[str, str], None] = {}

    def is_new(self, sender: str, turn: str) -> bool:
        if (sender, turn) in self._done:
            return False
        if len(self._done) >= _MAX_TURNS:
            del self._done[next(iter(self._done))]
        self._done[sender, turn] = None
        return True


class Shared:
    """What the robot's actors on the mesh have in common; it outlives their restarts."""

    def __init__(self) -> None:
        self.clocks = Clocks()
        self.resumed_epoch = 0  # in which the robot was last resumed over the mesh
        self.audit: Callable[[str, str, str, str], None] = lambda *_: None  # who, what, how, over
        self.taken = 0  # commands that were read, good and bad
        self.turns = Turns()
        self.sessions = Sessions()  # of callers of other hosts


def read_envelope(payload: bytes, limit: int = MAX_COMMAND_BYTES) -> Envelope | tuple[Sender | None, Refused]:
    """Or whom to tell (when that could be read), and what is wrong."""
    try:
        envelope = _decode_envelope(payload)
    except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError) as error:
        remedy = 'send {"sender_id", "turn_id", "command": {"action", ...}}'
        return read_sender(payload), Refused(Code.MALFORMED, f"this is no command: {error}", remedy)
    if len(payload) > limit:
        told = f"send at most {limit} bytes"
        oversized = Refused(Code.OVERSIZED, f"{len(payload)} bytes", told, str(len(payload)), str(limit))
        return Sender(envelope.sender_id, envelope.turn_id), oversized
    return envelope


def read_sender(payload: bytes) -> Sender | None:
    """Return whom to tell what is wrong, when that can be read."""
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
"""Actions of strands-robots that robots of ours do not have: why, and what to do instead."""


def no_action(action: str, offered: Iterable[str] = tuple(ACTIONS)) -> Refused:
    """Return what is told of an action that is none of those offered."""
    action = action[:64]
    if action in NOT_HERE and action not in ACTIONS:
        why, remedy = NOT_HERE[action]
        return Refused(Code.NOT_HERE, f"{action!r} is not here: {why}", remedy, action)
    return Refused(Code.UNKNOWN_ACTION, f"{action!r} is no action here", f"send {', '.join(offered)}", action)


def read_command(envelope: Envelope, offered: tuple[str, ...] = tuple(ACTIONS)) -> Command | Refused:
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
    """Return how a command is asked."""
    return f"ask: a zenoh query (get) on {command_key(robot, '<your name>')}"


def refuse_stale(clocks: Clocks, sender: str, command: Command, now_ns: int) -> Refused | None:
    if isinstance(command, Dated):
        return clocks.refuse(sender, command.clock, command.deadline_ns, now_ns)
    return None
