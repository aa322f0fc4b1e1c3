"""Keep the newest value of everything that servos report, per axis, and make an ``Observation`` of it."""

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
    """The values in one reply."""

    position: int  # counts
    velocity: float  # counts per second
    sensors: tuple[float, ...]  # in the order of ``Readings.SENSORS``
    words: str = ""  # faults that the servo reports
    energised: bool | None = None  # None: not in the reply


class Readings(ABC, Generic[PacketT]):
    """The newest values of all servos of a bus.

    A subclass names its rows in ``SENSORS`` and decodes a reply in ``sample``.

    Args:
        axes: The axes.
        limits: Rows of constants for every observation, in axis order.
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
        self._asked_ns: dict[int, int] = {}
        self._speed: dict[int, float] = {}
        # Request time of the first of the latest readings in which the joint stands.
        self._stands_since_ns: dict[int, int] = {}
        self.counts: dict[int, int] = {}
        """The last measured position by id, of any age."""
        self.limp: set[int] = set()
        """Ids of servos without torque, by their last report."""

    @abstractmethod
    def sample(self, axis: Axis, reply: PacketT, base: int) -> Sample:
        """Decode a block that was read from address ``base``."""

    def take(
        self,
        replies: Mapping[int, PacketT],
        base: int,
        asked_ns: int,
        now_ns: int,
        refusals: Mapping[int, str] | None = None,
    ) -> None:
        """Take the replies to one request.

        Args:
            replies: By id.
            base: The address of the block that was read.
            asked_ns: When the request was sent. The servos have measured after that.
            now_ns: The time.
            refusals: Errors by id.
        """
        for at, axis in enumerate(self._axes):
            if refusals and axis.id in refusals:
                self._words[axis.id] = refusals[axis.id]
            reply = replies.get(axis.id)
            if reply is None:
                continue
            sample = self.sample(axis, reply, base)
            self.counts[axis.id] = sample.position
            self._asked_ns[axis.id] = asked_ns
            self._speed[axis.id] = sample.velocity
            if abs(sample.velocity) > STANDING or sample.energised is False:
                self._stands_since_ns.pop(axis.id, None)
            else:
                self._stands_since_ns.setdefault(axis.id, asked_ns)
            self._stamp_ns[at] = now_ns
            self._position[at] = axis.value(sample.position)
            self._velocity[at] = sample.velocity / axis.scale
            for row, value in zip(self._sensors, sample.sensors, strict=True):
                row[at] = value
            self._words[axis.id] = sample.words
            if sample.energised is not None:
                (self.limp.discard if sample.energised else self.limp.add)(axis.id)

    def known(self, since_ns: int, now_ns: int, goals: Mapping[int, int], aimed_ns: int) -> dict[int, int]:
        """Return the positions, by id, of servos that have torque and cannot have moved far since.

        A servo that was asked before it had started towards its goal is on its way now. So is a servo that
        has just begun to stand far from its goal, because it was reset and a repeated goal has energised it
        again. A blocked servo stands for longer.

        Args:
            since_ns: Leave out servos that were asked before.
            now_ns: The time.
            goals: The last goals, counts by id.
            aimed_ns: When they were sent.
        """
        return {
            motor: count
            for motor, count in self.counts.items()
            if (asked_ns := self._asked_ns[motor]) >= since_ns
            and motor not in self.limp
            and abs(self._speed[motor]) * (now_ns - asked_ns) <= STILL_COUNTS * NS
            and not (
                asked_ns < max(aimed_ns, self._stands_since_ns.get(motor, 0)) + SET_OFF_NS
                and abs(goals.get(motor, count) - count) > STILL_COUNTS
            )
        }

    def energised(self) -> None:
        """Note that all servos have torque, as was read back."""
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
