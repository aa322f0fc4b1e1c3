"""Store the newest values that each servo has reported, and make an ``Observation`` of them."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from typing import Generic, NamedTuple

from strands_actors.contract.wire import Observation
from strands_actors.drivers.common.ports.half_duplex import PacketT
from strands_actors.kernel.clock import NS

from .axes import Axis

STILL_COUNTS = 11
"""One degree. A joint that may have moved further since it was read counts as having an unknown position."""

SET_OFF_NS = 50_000_000
"""For so long after a new goal, the reported speed is not the one that the servo will have [assumed: by
then the servo has reached it]."""

STANDING = 20.0
"""Counts per second, 2 degrees per second. A joint that is no faster stands."""

_NAN = math.nan


class Sample(NamedTuple):
    """The values in one servo's reply."""

    position: int  # encoder counts
    velocity: float  # counts per second
    sensors: tuple[float, ...]  # values in the order of ``Readings.SENSORS``
    words: str = ""  # names of the faults that the servo reports
    energised: bool | None = None  # True if the servo has torque; None if the reply does not contain it


class Readings(ABC, Generic[PacketT]):
    """The newest values of all servos of a bus.

    A subclass lists the names of its sensor rows in ``SENSORS``, and decodes a reply in ``sample``.

    Args:
        axes: The axes.
        limits: Constant rows that each observation also contains, in axis order.
    """

    SENSORS: tuple[str, ...]
    """Names of the rows of sensors, each with its unit."""

    def __init__(self, axes: Sequence[Axis], limits: Mapping[str, tuple[float, ...]]) -> None:
        count = len(axes)
        self._axes = tuple(axes)
        self._position = [_NAN] * count
        self._stamp_ns = [0] * count
        self._velocity = [_NAN] * count
        self._sensors = [[_NAN] * count for _ in self.SENSORS]
        self._limits = dict(limits)
        self._words: dict[int, str] = {}
        self._requested_ns: dict[int, int] = {}
        self._speed: dict[int, float] = {}
        # Start of the time during which all readings showed the joint at rest: time of the first such request, by
        # id.
        self._stands_since_ns: dict[int, int] = {}
        self.counts: dict[int, int] = {}
        """The last measured position by id, of any age."""
        self.limp: set[int] = set()
        """Ids of servos without torque, by their last report."""

    @abstractmethod
    def sample(self, axis: Axis, reply: PacketT, base: int) -> Sample:
        """Decode a servo's reply to a read of a block. ``base`` is the address of the block's first register."""

    def store(
        self,
        replies: Mapping[int, PacketT],
        base: int,
        requested_ns: int,
        now_ns: int,
        refusals: Mapping[int, str] | None = None,
    ) -> None:
        """Store the values of the replies to one request.

        Args:
            replies: The replies, by servo id.
            base: The address of the first register that was read.
            requested_ns: Time at which the request was sent. The servos have measured later than that.
            now_ns: The present time.
            refusals: The errors that servos have reported instead, by id.
        """
        for index, axis in enumerate(self._axes):
            if refusals and axis.id in refusals:
                self._words[axis.id] = refusals[axis.id]
            reply = replies.get(axis.id)
            if reply is None:
                continue
            sample = self.sample(axis, reply, base)
            self.counts[axis.id] = sample.position
            self._requested_ns[axis.id] = requested_ns
            self._speed[axis.id] = sample.velocity
            if abs(sample.velocity) > STANDING or sample.energised is False:
                self._stands_since_ns.pop(axis.id, None)
            else:
                self._stands_since_ns.setdefault(axis.id, requested_ns)
            self._stamp_ns[index] = now_ns
            self._position[index] = axis.value(sample.position)
            self._velocity[index] = sample.velocity / axis.scale
            for row, value in zip(self._sensors, sample.sensors, strict=True):
                row[index] = value
            self._words[axis.id] = sample.words
            if sample.energised is not None:
                (self.limp.discard if sample.energised else self.limp.add)(axis.id)

    def store_faults(self, replies: Mapping[int, PacketT], base: int) -> None:
        """Store the faults that the replies report, and no other value. ``base`` is the address of the first
        register that was read."""
        for axis in self._axes:
            if axis.id in replies:
                self._words[axis.id] = self.sample(axis, replies[axis.id], base).words

    def recent_positions(
        self, since_ns: int, now_ns: int, goals: Mapping[int, int], aimed_ns: int
    ) -> dict[int, int]:
        """Return the positions of servos that have torque and cannot have moved far since they were read, by id.

        Two kinds of servo are left out, because they may be moving. The first was read before it had started
        towards a new goal. The second has just come to rest far from its goal: it may have been reset, and a
        repeated goal then energises it again. A blocked servo has been at rest for longer, so it is not left out.

        Args:
            since_ns: Leave out servos whose last read request is older than this.
            now_ns: The present time.
            goals: The last goals, in counts by id.
            aimed_ns: Time at which the goals were sent.
        """
        return {
            motor: count
            for motor, count in self.counts.items()
            if (requested_ns := self._requested_ns[motor]) >= since_ns
            and motor not in self.limp
            and abs(self._speed[motor]) * (now_ns - requested_ns) <= STILL_COUNTS * NS
            and not (
                requested_ns < max(aimed_ns, self._stands_since_ns.get(motor, 0)) + SET_OFF_NS
                and abs(goals.get(motor, count) - count) > STILL_COUNTS
            )
        }

    @property
    def speeds(self) -> Mapping[int, float]:
        """The last measured speed by id, in counts per second."""
        return self._speed

    @property
    def has_faults(self) -> bool:
        """True if a servo reported a fault in its last reply."""
        return any(self._words.values())

    def energised(self) -> None:
        """Note that the torque of all servos was read back, and is on."""
        self.limp.clear()

    def observation(self, now_ns: int, silent: Sequence[int], armed: bool) -> Observation:
        return Observation(
            t_ns=now_ns,
            position=tuple(self._position),
            stamp_ns=tuple(self._stamp_ns),
            velocity=tuple(self._velocity),
            sensors={name: tuple(row) for name, row in zip(self.SENSORS, self._sensors, strict=True)}
            | self._limits,
            faults=self._faults(silent, armed),
        )

    def _faults(self, silent: Sequence[int], armed: bool) -> dict[str, str]:
        faults: dict[str, str] = {}
        for axis in self._axes:
            words = [self._words[axis.id]] if self._words.get(axis.id) else []
            if armed and axis.id in self.limp:
                words.append("limp")
            if axis.id in silent:
                words.append("silent")
            if words:
                faults[axis.key] = ", ".join(words)
        return faults
