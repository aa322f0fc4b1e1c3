"""Build the frames of a dataset, one per period, without I/O.

The input is the robot's journal (the list of all messages and readings) and the cameras' pictures. A frame for
the time ``t`` has:

* the newest state that was read at ``t`` or before,
* the newest pictures at ``t``,
* as its action, the robot's target at ``t`` plus one period. The operator or policy chose this action when it
  saw the state at ``t``.

So a frame waits until the journal has reached ``t`` plus one period.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Collection, Iterable, Iterator, Mapping
from typing import TypeVar

import msgspec
import numpy as np

from strands_actors.contract.sensors import ReadOnlyJoint
from strands_actors.surfaces.recording.rows import Command, Gap, Lifecycle, Safe, Seen
from strands_actors.surfaces.recording.views import Row as JournalRow

from .staging import Picture, Row

NS = 1_000_000_000
MEMORY_S = 5.0
"""Older states and targets are forgotten."""
STALE_PERIODS = 1.5
"""A frame is marked as stale if its state or a picture is older than so many periods. If the robot's state is
read less often than frames are built, the limit is so many reading cycles."""
LOST_S = 0.5
"""If the newest state is older than this, in seconds, the frame is missing."""
PATIENCE_S = 1.0
"""How long a frame waits for the journal, in seconds. Then it is built from the available entries."""
LARGEST = float(np.finfo(np.float32).max)
MOVING = ("armed",)
"""The modes in which a target is in force. In every other mode the robot stays, or is limp."""


class Axes(msgspec.Struct, frozen=True):
    """The robot's axes, in order.

    Attributes:
        keys: The names of the axes.
        velocities: The axes that are commanded by velocity.
        units: The unit of each axis. Empty if this computer does not have the robot's driver.
        optional: The axes that some robots of this type do not have.
        read_only: Joints that can be read but not commanded. Some robots of this type do not have them.
        cycle_s: Period of reading the state, in seconds; 0 if not known.
    """

    keys: tuple[str, ...]
    velocities: frozenset[str] = frozenset()
    units: tuple[str, ...] = ()
    optional: frozenset[str] = frozenset()
    read_only: tuple[ReadOnlyJoint, ...] = ()
    cycle_s: float = 0.0

    @property
    def state(self) -> tuple[str, ...]:
        """The names of the values in a state: first the axes, then the read-only joints."""
        return (*self.keys, *(joint.key for joint in self.read_only))

    @property
    def joints(self) -> tuple[str, ...]:
        return tuple(f"{key}.{'vel' if key in self.velocities else 'pos'}" for key in self.keys)

    @property
    def read_only_joints(self) -> tuple[tuple[str, str], ...]:
        """The read-only joints, each with its unit."""
        return tuple((f"{joint.key}.pos", joint.unit) for joint in self.read_only)

    def without(self, absent: Collection[str]) -> Axes:
        kept = [index for index, key in enumerate(self.keys) if key not in absent]
        units = tuple(self.units[index] for index in kept) if self.units else ()
        read_only = tuple(joint for joint in self.read_only if joint.key not in absent)
        keys = tuple(self.keys[index] for index in kept)
        return msgspec.structs.replace(self, keys=keys, units=units, read_only=read_only)


class Due(msgspec.Struct, frozen=True):
    """A frame that has to be built: its time, and the newest pictures at that time."""

    at_ns: int
    pictures: dict[str, Picture]
    age_ms: dict[str, float]  # Age of each picture at that time, in milliseconds.


class BuiltFrame(msgspec.Struct, frozen=True):
    row: Row
    pictures: dict[str, Picture]


class _Goal(msgspec.Struct, frozen=True):
    """The robot's present target, and the target that was requested. None means that the robot stays in
    place."""

    target: dict[str, float] | None
    requested: dict[str, float]


_STAYS = _Goal(None, {})
Value = TypeVar("Value")


class _History(deque[tuple[int, Value]]):
    """Values in the order of their times. A value that arrives late is inserted at its place."""

    def put(self, at_ns: int, value: Value) -> None:
        later: list[tuple[int, Value]] = []
        while self and self[-1][0] > at_ns:
            later.append(self.pop())
        self.append((at_ns, value))
        self.extend(reversed(later))
        while len(self) > 1 and self[1][0] < self[-1][0] - MEMORY_S * NS:
            self.popleft()

    def value_at(self, at_ns: int) -> tuple[int, Value] | None:
        """Return the newest value at ``at_ns`` or before, with its time. None if there is no such value."""
        return next((entry for entry in reversed(self) if entry[0] <= at_ns), None)


class Assembler:
    """Builds the frames (rows and pictures) of one recording for a dataset, one every ``period_s`` seconds."""

    def __init__(self, axes: Axes, period_s: float) -> None:
        self._axes = axes
        # Axes and joints that were never read. This robot may not have them.
        self._absent = axes.optional.intersection(axes.keys).union(joint.key for joint in axes.read_only)
        self._period_ns = round(period_s * NS)
        self._late_ms = STALE_PERIODS * period_s * 1e3
        self._state_late_ms = STALE_PERIODS * max(period_s, axes.cycle_s) * 1e3
        # Each state with the time of its oldest reading.
        self._states: _History[tuple[dict[str, float], int]] = _History()
        self._goals: _History[_Goal] = _History()
        self._lease = 0
        self._last_entry_ns = 0
        self._due: deque[Due] = deque()
        self._gap = 0
        self.unread: tuple[str, ...] = ()
        """The axes without a value in the newest observation."""

    @property
    def waiting(self) -> int:
        """Number of queued frames that are not built yet."""
        return len(self._due)

    # -- the journal

    def add_entries(self, rows: Iterable[JournalRow]) -> None:
        """Process new entries of the journal (list of messages and readings) of the wire process, which writes
        to the robot."""
        for _, at_ns, row in rows:
            match row:
                case Seen():
                    self._see(row)
                case Command():
                    self._command(at_ns, row)
                case Safe(stage="ordered"):
                    self._goals.put(at_ns, _STAYS)
                case Lifecycle(event="state") if row.mode not in MOVING:
                    self._goals.put(at_ns, _STAYS)
                case Gap():
                    # Commands in the gap of the journal are not known, so assume that the robot stays in place.
                    self._goals.put(max(at_ns, self._last_entry_ns), _STAYS)
                case _:
                    continue
            self._last_entry_ns = max(self._last_entry_ns, at_ns)

    def _see(self, row: Seen) -> None:
        rows = {joint.key: row.sensors.get(joint.sensor) for joint in self._axes.read_only}
        state = _numbers(row.position | {key: sensor[0] for key, sensor in rows.items() if sensor})
        self._absent = self._absent.difference(state)
        self.unread = tuple(key for key in self._axes.state if key not in state and key not in self._absent)
        if not self.unread:
            self._states.put(row.t_ns, (state, row.oldest_ns or row.t_ns))

    def _command(self, at_ns: int, row: Command) -> None:
        if row.type == "acquire" and row.outcome == "accepted":
            self._lease = row.lease
        if row.type != "setpoint":
            return
        # Ignore a refused setpoint of a program that does not hold the lease. An accepted setpoint always
        # counts. If its lease is not known, the lease was granted in a gap of the journal.
        if row.outcome != "accepted" and self._lease and row.lease != self._lease:
            return
        before = self._goals[-1][1] if self._goals else _STAYS
        requested = {key.removesuffix(".pos"): value for key, value in _numbers(row.action).items()}
        if row.outcome == "accepted":
            self._lease = row.lease
            target = _numbers(row.target)
            self._goals.put(at_ns, _Goal(target, target | requested))
        elif before.target is not None or requested:
            self._goals.put(at_ns, _Goal(before.target, before.requested | requested))

    @property
    def has_all(self) -> bool:
        """True if each axis was read at least once."""
        return not self._absent

    def leave_out_absent(self) -> Axes:
        """From now on, leave out the optional axes and joints that were never read. Return the remaining
        axes."""
        self._axes = self._axes.without(self._absent)
        self._absent = frozenset()
        return self._axes

    def has_state(self, now_ns: int) -> bool:
        """Return True if there is a state that is at most ``LOST_S`` old."""
        entry = self._states.value_at(now_ns)
        return entry is not None and now_ns - entry[1][1] <= LOST_S * NS

    # -- frames

    def due(self, at_ns: int, pictures: Mapping[str, Picture], age_ms: Mapping[str, float]) -> None:
        """Queue a frame.

        Args:
            at_ns: The time of the frame, in nanoseconds of CLOCK_MONOTONIC.
            pictures: The newest picture of each camera.
            age_ms: The age of each picture, in milliseconds.
        """
        self._due.append(Due(at_ns, dict(pictures), dict(age_ms)))

    def count_missing(self, count: int = 1) -> None:
        """Add ``count`` frames that cannot be built to the number of missing frames."""
        self._gap += count

    def take_gap(self) -> int:
        """Return how many frames are missing since the last built frame, and reset this number."""
        gap, self._gap = self._gap, 0
        return gap

    def frames(self, now_ns: int) -> Iterator[BuiltFrame]:
        """Yield the frames that can be built by now, in order."""
        while self._due:
            due = self._due[0]
            end_ns = due.at_ns + self._period_ns
            if self._last_entry_ns < end_ns and now_ns < end_ns + PATIENCE_S * NS:
                return
            self._due.popleft()
            frame = self._make(due, end_ns)
            if frame is None:
                self._gap += 1
            else:
                yield frame

    def _make(self, due: Due, end_ns: int) -> BuiltFrame | None:
        entry = self._states.value_at(due.at_ns)
        if entry is None or due.at_ns - entry[1][1] > LOST_S * NS:
            return None
        state, oldest_ns = entry[1]
        age_ms = {"state": (due.at_ns - oldest_ns) / 1e6} | due.age_ms
        goal = self._goals.value_at(end_ns)
        target, requested = (_STAYS.target, {}) if goal is None else (goal[1].target, goal[1].requested)
        stays = {key: 0.0 if key in self._axes.velocities else state[key] for key in self._axes.keys}
        action = stays if target is None else stays | target
        row = Row(
            tuple(state[key] for key in self._axes.state),
            self._action(action),
            self._action(action | requested),
            tuple(age_ms.values()),
            self.take_gap(),
            tuple(
                name
                for name, age in age_ms.items()
                if age > (self._state_late_ms if name == "state" else self._late_ms)
            ),
        )
        return BuiltFrame(row, due.pictures)

    def _action(self, values: Mapping[str, float]) -> tuple[float, ...]:
        return tuple(values[key] for key in self._axes.keys)

    def begin(self) -> None:
        """Begin an episode. Drop the frames of the previous episode that are still queued."""
        self._due.clear()
        self._gap = 0


def missed(at_ns: int, last_ns: int, period_ns: int) -> int:
    """Return how many frames are missing between two frames, from their times. 0 if ``last_ns`` is 0."""
    return max(0, round((at_ns - last_ns) / period_ns) - 1) if last_ns else 0


def _numbers(values: Mapping[str, object]) -> dict[str, float]:
    """Return the values that fit into float32. An axis that was never read has the value NaN, which is left
    out, because the statistics are JSON and JSON has no NaN."""
    return {
        key: float(value)
        for key, value in values.items()
        if isinstance(value, int | float) and not isinstance(value, bool) and abs(value) <= LARGEST
    }
