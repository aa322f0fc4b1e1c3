"""The newest of everything that servos report, per axis, and the ``Observation`` made of it."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from typing import Generic, NamedTuple

from strands_actors.contract.wire import Observation
from strands_actors.drivers.common.half_duplex import PacketT
from strands_actors.kernel.clock import NS

from .axes import Axis

STILL_COUNTS = 11
"""One degree: a joint that may have gone further since it was read is not where it was."""

SET_OFF_NS = 50_000_000
"""Until then after a new goal the speed that a servo tells is not the one it will have [assumed: it
is up to speed by then]."""

STANDING = 20.0
"""Counts a second: a joint that is no faster stands, 2 degrees a second."""

_NAN = math.nan


class Sample(NamedTuple):
    """What one reply says."""

    position: int  # counts
    velocity: float  # counts per second
    sensors: tuple[float, ...]  # as ``Readings.SENSORS``
    words: str = ""  # what the servo complains of
    energised: bool | None = None  # None: the reply does not say


class Readings(ABC, Generic[PacketT]):
    """``limits``: rows of constants that go with every observation, in axis order."""

    SENSORS: tuple[str, ...]
    """Names of the rows, with their unit."""

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
        self._stands_since_ns: dict[int, int] = {}  # when it was first asked of those readings that say so
        self.counts: dict[int, int] = {}
        """Last measured position by id, however old."""
        self.limp: set[int] = set()
        """Ids of those that had no torque when they last said so."""

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
        """``asked_ns``: when they were asked, so not before that did they measure."""
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
        """Return positions by id of those that have torque, were asked since then, and cannot have
        gone far meanwhile. ``goals``: what they were last told, at ``aimed_ns``: who was asked
        before it had set off is on its way now. So is who has just begun to stand far from its goal:
        a servo that was reset, and is energised again by a goal that was re-sent. One that is blocked
        stands for longer."""
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
        """All of them, as was read back."""
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
