"""Find out what happened to a robot between two samples of its telemetry. Pure: no clock, no I/O.

The topic ``state`` has the state of the robot, the counts of its refusals and the result of its last stop, ten
times a second. An event is a difference between one sample and the next, so an event is not lost if a sample is.
The topic ``strands/safety/event`` reports a change of the state earlier, and the name of the operator.
"""

from __future__ import annotations

import enum
from collections.abc import Iterator, Mapping

import msgspec

from strands_actors.supervisors.gate.failsafe import Mode

from .samples import Health, LastStop, Presence, SafetyEvent, State


class Kind(enum.StrEnum):
    """What happened."""

    STATE = "state"
    STOP = "stop"
    ORDER = "order"  # an operator's stop, e-stop or resume over the mesh
    REFUSED = "refused"
    FAULT = "fault"
    LEASE = "lease"
    TASK = "task"
    SILENT = "silent"  # no telemetry arrives
    PROBLEM = "problem"  # of the view itself


class Level(enum.IntEnum):
    """The levels of Foxglove's log."""

    INFO = 2
    WARNING = 3
    ERROR = 4


class Event(msgspec.Struct, frozen=True):
    """One event.

    Attributes:
        t: Wall-clock time in seconds.
        kind: What happened.
        level: How serious it is.
        code: The new state, the code of a refusal, the safe state of a stop, or the order; programs may use it.
        text: The event for people.
        count: How often it happened since the last sample.
    """

    t: float
    kind: Kind
    level: Level
    code: str
    text: str
    count: int = 1


LEVELS: Mapping[str, Level] = {
    Mode.DOWN: Level.INFO,
    Mode.LOST: Level.ERROR,
    Mode.DISARMED: Level.INFO,
    Mode.ARMING: Level.INFO,
    Mode.ARMED: Level.INFO,
    Mode.HOLDING: Level.WARNING,
    Mode.STOPPING: Level.WARNING,
    Mode.UNCONFIRMED: Level.ERROR,
    Mode.FAILED: Level.ERROR,
    Mode.ENDING: Level.WARNING,
    Mode.ENDED: Level.INFO,
}
"""The level of each state. A state that is not listed, such as "unreachable", is an error."""


class EventFinder:
    """Compares each sample with the last one. The first sample of each topic is the state from which events are
    counted."""

    def __init__(self) -> None:
        self._state: tuple[str, int] | None = None
        self._state_t = 0.0
        self._sample: State | None = None
        self._presence: Presence | None = None
        self._faults: Mapping[str, str] = {}

    def state(self, sample: State) -> Iterator[Event]:
        """Yield the events of a sample of ``state``."""
        last, self._sample = self._sample, sample
        yield from self._new_state(sample.t, sample.state, sample.epoch, sample.cause)
        if last is None:
            return
        # A robot that was started again counts from zero.
        before = {} if _restarted(last, sample) else last.refused
        for code, count in sample.refused.items():
            if (more := count - before.get(code, 0)) > 0:
                yield Event(sample.t, Kind.REFUSED, Level.WARNING, code, sample.last_refusal, more)
        if sample.last_stop is not None and sample.last_stop != last.last_stop:
            yield _stop(sample.t, sample.last_stop)
        if sample.task.status != last.task.status:
            instruction = sample.task.instruction or last.task.instruction
            about = f": {instruction}" if instruction else ""
            yield Event(sample.t, Kind.TASK, Level.INFO, sample.task.status, f"task {sample.task.status}{about}")

    def presence(self, sample: Presence) -> Iterator[Event]:
        """Yield the events of a sample of ``presence``."""
        last, self._presence = self._presence, sample
        if last is not None and sample.lease != last.lease:
            text = f"lease of {sample.lease}" if sample.lease else f"{last.lease} has no lease any more"
            yield Event(sample.timestamp, Kind.LEASE, Level.INFO, "held" if sample.lease else "free", text)

    def health(self, sample: Health) -> Iterator[Event]:
        """Yield the events of a sample of ``health``."""
        last, self._faults = self._faults, sample.faults
        for axis, fault in sample.faults.items():
            if last.get(axis) != fault:
                yield Event(sample.t, Kind.FAULT, Level.ERROR, axis, f"{axis}: {fault}")

    def safety(self, sample: SafetyEvent) -> Iterator[Event]:
        """Yield the events of a message on ``strands/safety/event``."""
        if sample.event == "state":
            yield from self._new_state(sample.t, sample.state, sample.epoch, sample.cause)
            return
        by = f" by {sample.by}" if sample.by else ""
        result = f": {sample.outcome}" if sample.outcome else ""
        level = Level.INFO if sample.outcome in ("", "safe") else Level.ERROR
        yield Event(sample.t, Kind.ORDER, level, sample.event, f"{sample.event}{by}{result}")

    def _new_state(self, t: float, state: str, epoch: int, cause: str) -> Iterator[Event]:
        # A sample may have been made before a message about a newer state, and arrive after it.
        if self._state == (state, epoch) or t < self._state_t:
            return
        self._state, self._state_t = (state, epoch), t
        about = f": {cause}" if cause else ""
        yield Event(t, Kind.STATE, LEVELS.get(state, Level.ERROR), state, f"{state}, epoch {epoch}{about}")


def _restarted(last: State, sample: State) -> bool:
    return sum(sample.refused.values()) < sum(last.refused.values())


def _stop(t: float, stop: LastStop) -> Event:
    if stop.confirmed:
        text = f"{stop.safe_state} confirmed in {stop.took_ms:.1f} ms ({stop.reason})"
        return Event(t, Kind.STOP, Level.WARNING, stop.safe_state, text)
    axes = ", ".join(stop.unconfirmed) or "the robot"
    return Event(t, Kind.STOP, Level.ERROR, stop.safe_state, f"{stop.safe_state} NOT CONFIRMED by {axes}")
