"""Turn the journal (internal messages) of a robot's process into rows for people, without I/O."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any

import msgspec

from strands_actors.contract.wire import Observation
from strands_actors.kernel.messages import Message, Refused
from strands_actors.supervisors.gate.messages import (
    Accepted,
    Acquire,
    ArmDone,
    Lease,
    LinkLost,
    LinkUp,
    Observed,
    Release,
    Resume,
    SafeDone,
    Setpoint,
    Stop,
    StopReport,
)
from strands_actors.supervisors.instrument import Entry, Kind
from strands_actors.supervisors.root.messages import (
    EpisodeKey,
    Fence,
    Happened,
    Renew,
    Shutdown,
    StartTask,
    StateIs,
    StopTask,
)
from strands_actors.supervisors.wire.messages import MakeSafe

from .rows import Command, Gap, Lifecycle, Log, Motor, Refusal, Safe, Seen

INFO, WARNING, ERROR = 2, 3, 4

decode_entries = msgspec.msgpack.Decoder(list[Entry]).decode

Row = tuple[str, int, msgspec.Struct]
"""Channel, time in CLOCK_MONOTONIC nanoseconds, and the row."""

_COMMANDS = (Setpoint, Stop, Resume, Acquire, Release)
_SHOWN = (
    *_COMMANDS, Observed, SafeDone, ArmDone, LinkUp, LinkLost, MakeSafe, StateIs, Fence, Shutdown, Renew, StartTask,
    StopTask, Happened, StopReport, Refused, Accepted, Lease, EpisodeKey,
)  # fmt: skip

_BY_TAG = {message_type.__name__: msgspec.msgpack.Decoder(message_type).decode for message_type in _SHOWN}


def keys_pressed(entries: Iterable[Entry]) -> Iterator[EpisodeKey]:
    """Yield the operator's keys that begin and end episodes of a dataset, from the journal of the root process.
    The operator presses them on the page of a teleoperation."""
    for entry in entries:
        if entry.kind == Kind.NOTED and isinstance(message := _decode(entry.body), EpisodeKey):
            yield message


class View:
    """Builds the rows of a recording from the journal (internal messages) of one process.

    Args:
        source: The process: ``wire`` or ``root``.
        axes: The axes of the robot.
        wall_ns: Wall-clock time minus the robot's clock, in nanoseconds.
    """

    def __init__(self, source: str, axes: Sequence[str], wall_ns: int) -> None:
        self._source = source
        self._axes = axes
        self._wall_ns = wall_ns
        self._at_ns = 0
        self._last_command = ""  # The kind of the newest command.
        self._command: Command | None = None  # The row of the newest command, until its outcome is known.
        # The senders that have asked for a lease and still wait, by actor and number of the deferred answer.
        self._waiting: dict[tuple[str, int], str] = {}

    def rows(self, entries: Iterable[Entry]) -> Iterator[Row]:
        for entry in entries:
            if entry.kind == Kind.DEFERRED and self._command is not None and self._command.type == "acquire":
                self._waiting[entry.actor, entry.number] = self._command.by
            if entry.kind in (Kind.TOOK, Kind.DEFERRED, Kind.GAP):
                yield from self._timed(self._end_command())
            if entry.at_ns:
                self._at_ns = entry.at_ns
            yield from self._timed(self._show(entry))

    def lost(self, at_ns: int, reason: str) -> Iterator[Row]:
        """Yield a gap for a process that has stopped sending, because its last entries may be missing."""
        yield from self._timed(self._end_command())
        self._at_ns = at_ns
        yield from self._timed([("gap", Gap(self._source, -1, reason))])

    def end(self) -> Iterator[Row]:
        """Yield the row of the last command, if its outcome is still missing at the end of the recording."""
        yield from self._timed(self._end_command())

    def _timed(self, shown: Iterable[tuple[str, msgspec.Struct]]) -> Iterator[Row]:
        for channel, row in shown:
            yield channel, self._at_ns, row
            if (line := self._log(channel, row)) is not None:
                yield "log", self._at_ns, line

    def _show(self, entry: Entry) -> Iterator[tuple[str, msgspec.Struct]]:
        entry_kind = entry.kind
        if entry_kind == Kind.GAP:
            yield "gap", Gap(self._source, entry.number, "the recorder was slower than the robot")
            return
        message = _decode(entry.body)
        if message is None:
            return
        if entry_kind == Kind.TOOK:
            yield from self._received(message)
        elif entry_kind == Kind.ANSWERED:
            yield from self._answered(message)
        elif entry_kind == Kind.SENT:
            yield from self._sent(entry.actor, message)
        elif entry_kind == Kind.REFUSED and isinstance(message, Refused):
            yield "refusal", _refusal(f"{entry.to} to {entry.actor}", message)
        elif entry_kind == Kind.NOTED:
            yield from self._noted(message)
        elif entry_kind == Kind.SETTLED:
            yield from self._settled(entry, message)

    # -- commands and their outcomes

    def _received(self, message: Message) -> Iterator[tuple[str, msgspec.Struct]]:
        self._last_command = ""
        match message:
            case Setpoint():
                self._ask(_setpoint(message, self._axes))
            case Acquire():
                self._ask(Command("acquire", message.holder, "later", message.over))
            case Stop():
                by = f"{message.reason} by {message.by}" if message.by else str(message.reason)
                self._ask(Command("e-stop" if message.lock else "stop", by, "later"))
                yield from self._end_command()
            case Resume():
                self._ask(Command("resume", message.by, "later"))
                yield from self._end_command()
            case Release():
                self._ask(Command("release", "", "accepted", message.lease))
                yield from self._end_command()
            case Observed():
                yield "observation", self._observation(message.observation)
            case SafeDone():
                yield "safe", _done(message.report)
            case ArmDone():
                if message.observation is None:
                    yield "lifecycle", Lifecycle("arming failed", epoch=message.epoch, detail=message.error)
                else:
                    yield "lifecycle", Lifecycle("armed", epoch=message.epoch)
            case LinkUp():
                yield "lifecycle", Lifecycle("the link is up")
                yield "observation", self._observation(message.observation)
            case LinkLost():
                yield "lifecycle", Lifecycle("the link is down", detail=message.cause)
            case Fence() | Shutdown():
                event = "fence" if isinstance(message, Fence) else "shutdown"
                yield "lifecycle", Lifecycle(event, cause=message.reason, detail=message.by)
            case Renew():
                yield "lifecycle", Lifecycle("the wire process asks for a new one", detail=message.cause)
            case StartTask():
                yield "lifecycle", Lifecycle("task started", detail=message.provider)
            case StopTask():
                yield "lifecycle", Lifecycle("task stopped")
            case _:
                pass

    def _answered(self, answer: Message) -> Iterator[tuple[str, msgspec.Struct]]:
        command = self._command
        if command is not None:
            match answer:
                case Refused():
                    command.outcome = "refused"
                    command.code, command.reason, command.remedy = answer.code, answer.reason, answer.remedy
                case Accepted():
                    command.outcome, command.target = "accepted", self._by_axis(answer.values)
                case Lease():
                    command.outcome, command.lease, command.epoch = "accepted", answer.id, answer.epoch
                    yield "lifecycle", Lifecycle("lease granted", epoch=answer.epoch, detail=command.by)
                case _:
                    pass
        yield from self._end_command()
        if isinstance(answer, Refused):
            yield "refusal", _refusal(self._last_command, answer)

    def _settled(self, entry: Entry, answer: Message) -> Iterator[tuple[str, msgspec.Struct]]:
        # The sender is unknown ("") if the request was in a gap of the journal.
        holder = self._waiting.pop((entry.actor, entry.number), "")
        if isinstance(answer, Lease):
            yield "command", Command("acquire", holder, "accepted", answer.id, answer.epoch)
            yield "lifecycle", Lifecycle("lease granted", epoch=answer.epoch, detail=holder)
        elif isinstance(answer, Refused):
            yield "refusal", _refusal("resume", answer)

    def _ask(self, command: Command) -> None:
        self._last_command, self._command = command.type, command

    def _end_command(self) -> Iterator[tuple[str, msgspec.Struct]]:
        if self._command is not None:
            yield "command", self._command
            self._command = None

    # -- messages and notes of the robot that are not commands

    def _sent(self, actor: str, message: Message) -> Iterator[tuple[str, msgspec.Struct]]:
        if isinstance(message, MakeSafe):
            yield (
                "safe",
                Safe("ordered", message.safe_state, message.reason, message.epoch, "wire", False, 0.0, []),
            )
        elif isinstance(message, StateIs) and actor == "gate":
            yield "lifecycle", _state(message)

    def _noted(self, message: Message) -> Iterator[tuple[str, msgspec.Struct]]:
        if isinstance(message, Happened):
            yield "lifecycle", Lifecycle(message.event, detail=message.detail, pid=message.pid)
        elif isinstance(message, StateIs):
            yield "lifecycle", _state(message)
        elif isinstance(message, StopReport):
            yield "safe", _done(message)
        elif isinstance(message, EpisodeKey):
            yield "lifecycle", Lifecycle("an episode's key", detail=message.word)

    # -- rows

    def _observation(self, observation: Observation) -> Seen:
        return Seen(
            observation.t_ns,
            self._by_axis(observation.position),
            self._by_axis(observation.velocity),
            {name: list(row) for name, row in observation.sensors.items()},
            dict(observation.faults),
            min((stamp for stamp in observation.stamp_ns if stamp), default=0),
        )

    def _by_axis(self, values: Sequence[float]) -> dict[str, float | None]:
        return dict(
            zip(self._axes, values, strict=False)
        )  # Ignore values after the axes, such as a speed or a force.

    def _log(self, channel: str, row: msgspec.Struct) -> Log | None:
        line = _log_line(row)
        if line is None:
            return None
        level, text = line
        sec, nsec = divmod(self._at_ns + self._wall_ns, 1_000_000_000)
        return Log({"sec": sec, "nsec": nsec}, level, text, f"{self._source}/{channel}")


def _log_line(row: msgspec.Struct) -> tuple[int, str] | None:
    """Return the level and the text of a row for the log. None if the row is not logged."""
    match row:
        case Refusal():
            return WARNING, f"{row.request} refused ({row.code}): {row.reason}"
        case Safe(stage="ordered"):
            return WARNING, f"{row.safe_state} ordered: {row.reason}, epoch {row.epoch}"
        case Safe():
            missing = ", ".join(motor.axis for motor in row.motors if not motor.safe)
            if row.confirmed:
                return INFO, f"{row.safe_state} confirmed in {row.took_ms:.1f} ms by the {row.path} path"
            return ERROR, f"{row.safe_state} NOT CONFIRMED by {missing or 'the robot'}"
        case Lifecycle():
            about = ", ".join(text for text in (row.cause, row.detail) if text)
            pid = f" (process {row.pid})" if row.pid else ""
            state = f" {row.mode}, epoch {row.epoch}" if row.mode else ""
            return INFO, f"{row.event}{state}{pid}{f': {about}' if about else ''}"
        case Gap():
            return WARNING, f"gap: {row.reason}"
        case Command() if row.type not in ("setpoint", "acquire"):
            return INFO, f"{row.type}{f' ({row.by})' if row.by else ''}"
        case _:
            return None


def _setpoint(message: Setpoint, axes: Sequence[str]) -> Command:
    return Command(
        "setpoint",
        "",
        "later",
        message.lease,
        message.epoch,
        message.deadline_ns,
        message.latched,
        message.action,
    )


def _state(message: StateIs) -> Lifecycle:
    return Lifecycle("state", message.mode, message.epoch, message.locked_by, message.cause)


def _done(report: StopReport) -> Safe:
    motors = [Motor(m.axis, m.id, m.written, m.acknowledged, m.safe, m.detail) for m in report.motors]
    return Safe(
        "done",
        report.safe_state,
        report.reason,
        report.epoch,
        report.path,
        report.confirmed,
        report.took_ms,
        motors,
    )


def _refusal(request: str, refusal: Refused) -> Refusal:
    return Refusal(request, refusal.code, refusal.reason, refusal.remedy, refusal.offered, refusal.limit)


def _decode(body: msgspec.Raw) -> Message | None:
    """Return the decoded message if its class has rows for people, otherwise None."""
    decode: Callable[[Any], Message] | None = _BY_TAG.get(tag_of(body))
    return None if decode is None else decode(body)


def tag_of(body: msgspec.Raw) -> str:
    """Return the class name at the beginning of an encoded message. Empty if the bytes are not a message."""
    data = memoryview(body)
    if len(data) < 2:
        return ""
    head = data[0]
    # In msgpack, 0x90 to 0x9F begin an array of at most 15 elements, and 0xDC one of at most 65535.
    position = 1 if 0x90 <= head <= 0x9F else 3 if head == 0xDC else 0
    if not position or len(data) <= position:
        return ""
    size = data[position]
    if 0xA0 <= size <= 0xBF:  # In msgpack, 0xA0 to 0xBF begin a string of at most 31 bytes.
        return bytes(data[position + 1 : position + 1 + (size & 0x1F)]).decode(errors="replace")
    return ""
