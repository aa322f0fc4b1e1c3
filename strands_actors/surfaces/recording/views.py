"""Turn the journal of a process into rows that people read. Pure."""

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

_BY_TAG = {kind.__name__: msgspec.msgpack.Decoder(kind).decode for kind in _SHOWN}


def keys_pressed(entries: Iterable[Entry]) -> Iterator[EpisodeKey]:
    """Yield the keys by which the operator of a teleoperation controls a recorder of episodes. They are in
    the root's journal."""
    for entry in entries:
        if entry.kind == Kind.NOTED and isinstance(message := _decode(entry.body), EpisodeKey):
            yield message


class View:
    """The rows of one process's journal.

    Args:
        source: The process: ``wire`` or ``root``.
        axes: The axes of the robot.
        wall_ns: Wall-clock time minus the robot's clock.
    """

    def __init__(self, source: str, axes: Sequence[str], wall_ns: int) -> None:
        self._source = source
        self._axes = axes
        self._wall_ns = wall_ns
        self._at_ns = 0
        self._asked = ""  # the newest command
        self._command: Command | None = None  # its row, while the outcome is missing
        # The sender of each acquire with a deferred answer, by actor and number.
        self._waiting: dict[tuple[str, int], str] = {}

    def rows(self, entries: Iterable[Entry]) -> Iterator[Row]:
        for entry in entries:
            if entry.kind == Kind.DEFERRED and self._command is not None and self._command.what == "acquire":
                self._waiting[entry.actor, entry.number] = self._command.by
            if entry.kind in (Kind.TOOK, Kind.DEFERRED, Kind.GAP):
                yield from self._timed(self._end_command())
            if entry.at_ns:
                self._at_ns = entry.at_ns
            yield from self._timed(self._show(entry))

    def lost(self, at_ns: int, why: str) -> Iterator[Row]:
        """Yield the rows for a source that has stopped sending. Its last entries may be missing."""
        yield from self._timed(self._end_command())
        self._at_ns = at_ns
        yield from self._timed([("gap", Gap(self._source, -1, why))])

    def end(self) -> Iterator[Row]:
        """Yield the last row, which would otherwise wait for the next entry."""
        yield from self._timed(self._end_command())

    def _timed(self, shown: Iterable[tuple[str, msgspec.Struct]]) -> Iterator[Row]:
        for channel, row in shown:
            yield channel, self._at_ns, row
            if (line := self._log(channel, row)) is not None:
                yield "log", self._at_ns, line

    def _show(self, entry: Entry) -> Iterator[tuple[str, msgspec.Struct]]:
        kind = entry.kind
        if kind == Kind.GAP:
            yield "gap", Gap(self._source, entry.number, "the recorder was slower than the robot")
            return
        message = _decode(entry.body)
        if message is None:
            return
        if kind == Kind.TOOK:
            yield from self._taken(message)
        elif kind == Kind.ANSWERED:
            yield from self._answered(message)
        elif kind == Kind.SENT:
            yield from self._sent(entry.actor, message)
        elif kind == Kind.REFUSED and isinstance(message, Refused):
            yield "refusal", _refusal(f"{entry.to} to {entry.actor}", message)
        elif kind == Kind.NOTED:
            yield from self._noted(message)
        elif kind == Kind.SETTLED:
            yield from self._settled(entry, message)

    # -- commands and their outcomes

    def _taken(self, message: Message) -> Iterator[tuple[str, msgspec.Struct]]:
        self._asked = ""
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
                yield "observation", self._seen(message.observation)
            case SafeDone():
                yield "safe", _done(message.report)
            case ArmDone():
                if message.observation is None:
                    yield "lifecycle", Lifecycle("arming failed", epoch=message.epoch, detail=message.error)
                else:
                    yield "lifecycle", Lifecycle("armed", epoch=message.epoch)
            case LinkUp():
                yield "lifecycle", Lifecycle("the link is up")
                yield "observation", self._seen(message.observation)
            case LinkLost():
                yield "lifecycle", Lifecycle("the link is down", detail=message.why)
            case Fence() | Shutdown():
                what = "fence" if isinstance(message, Fence) else "shutdown"
                yield "lifecycle", Lifecycle(what, cause=message.reason, detail=message.by)
            case Renew():
                yield "lifecycle", Lifecycle("the wire process asks for a new one", detail=message.why)
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
            yield "refusal", _refusal(self._asked, answer)

    def _settled(self, entry: Entry, answer: Message) -> Iterator[tuple[str, msgspec.Struct]]:
        holder = self._waiting.pop((entry.actor, entry.number), "")  # It is also empty after a gap.
        if isinstance(answer, Lease):
            yield "command", Command("acquire", holder, "accepted", answer.id, answer.epoch)
            yield "lifecycle", Lifecycle("lease granted", epoch=answer.epoch, detail=holder)
        elif isinstance(answer, Refused):
            yield "refusal", _refusal("resume", answer)

    def _ask(self, command: Command) -> None:
        self._asked, self._command = command.what, command

    def _end_command(self) -> Iterator[tuple[str, msgspec.Struct]]:
        if self._command is not None:
            yield "command", self._command
            self._command = None

    # -- actions without a command

    def _sent(self, actor: str, message: Message) -> Iterator[tuple[str, msgspec.Struct]]:
        if isinstance(message, MakeSafe):
            yield "safe", Safe("ordered", message.safe_state, message.reason, message.epoch, "wire", False, 0.0, [])
        elif isinstance(message, StateIs) and actor == "gate":
            yield "lifecycle", _state(message)

    def _noted(self, message: Message) -> Iterator[tuple[str, msgspec.Struct]]:
        if isinstance(message, Happened):
            yield "lifecycle", Lifecycle(message.what, detail=message.detail, pid=message.pid)
        elif isinstance(message, StateIs):
            yield "lifecycle", _state(message)
        elif isinstance(message, StopReport):
            yield "safe", _done(message)
        elif isinstance(message, EpisodeKey):
            yield "lifecycle", Lifecycle("an episode's key", detail=message.word)

    # -- rows

    def _seen(self, observation: Observation) -> Seen:
        return Seen(
            observation.t_ns,
            self._by_axis(observation.position),
            self._by_axis(observation.velocity),
            {name: list(row) for name, row in observation.sensors.items()},
            dict(observation.faults),
            min((stamp for stamp in observation.stamp_ns if stamp), default=0),
        )

    def _by_axis(self, values: Sequence[float]) -> dict[str, float | None]:
        return dict(zip(self._axes, values, strict=False))  # A target may have further values: speed, force.

    def _log(self, channel: str, row: msgspec.Struct) -> Log | None:
        line = _log_line(row)
        if line is None:
            return None
        level, text = line
        sec, nsec = divmod(self._at_ns + self._wall_ns, 1_000_000_000)
        return Log({"sec": sec, "nsec": nsec}, level, text, f"{self._source}/{channel}")


def _log_line(row: msgspec.Struct) -> tuple[int, str] | None:
    """Return the level and the text of a row in the log; None if it has no line."""
    match row:
        case Refusal():
            return WARNING, f"{row.what} refused ({row.code}): {row.reason}"
        case Safe(what="ordered"):
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
            return INFO, f"{row.what}{state}{pid}{f': {about}' if about else ''}"
        case Gap():
            return WARNING, f"gap: {row.why}"
        case Command() if row.what not in ("setpoint", "acquire"):
            return INFO, f"{row.what}{f' ({row.by})' if row.by else ''}"
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


def _refusal(what: str, refusal: Refused) -> Refusal:
    return Refusal(what, refusal.code, refusal.reason, refusal.remedy, refusal.offered, refusal.limit)


def _decode(body: msgspec.Raw) -> Message | None:
    """Return the message if it is shown to people; None otherwise."""
    decode: Callable[[Any], Message] | None = _BY_TAG.get(tag_of(body))
    return None if decode is None else decode(body)


def tag_of(body: msgspec.Raw) -> str:
    """Return the class name at the head of an encoded message; empty for anything else."""
    data = memoryview(body)
    if len(data) < 2:
        return ""
    head = data[0]
    at = 1 if 0x90 <= head <= 0x9F else 3 if head == 0xDC else 0  # a msgpack array of up to 15, of up to 65535
    if not at or len(data) <= at:
        return ""
    size = data[at]
    if 0xA0 <= size <= 0xBF:  # a string of up to 31 bytes
        return bytes(data[at + 1 : at + 1 + (size & 0x1F)]).decode(errors="replace")
    return ""
