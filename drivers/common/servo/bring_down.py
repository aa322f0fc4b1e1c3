"""Lower the arm of a servo bus: send goals and torque limits, and watch the arm meanwhile.

``lowering`` decides the next goals and limits. This module reads the servos, writes to them, and ends at once when
something is wrong. Its caller then switches the torque off in any case.
"""

from __future__ import annotations

import enum
from collections.abc import Awaitable, Callable, Mapping, Sequence
from typing import Generic

from strands_actors.drivers.common.kinematics.chain import Chain
from strands_actors.drivers.common.ports.half_duplex import HalfDuplexBus, PacketT, Quiet
from strands_actors.kernel.clock import NS

from .axes import COUNTS, COUNTS_PER_RADIAN, MIDDLE, Axis
from .codec import Codec
from .lowering import FALL_S, RELEASE_S, FallingTorque, LoweringConfig, RestPath, pace
from .readings import Readings

PERIOD_S = 0.01
ANSWER_S = 0.025
"""A servo that has not answered after this time counts as mute."""
STAND_S = 0.4
STANDING_PACE = 0.1
STANDING_LOOKS = 3
BEHIND_DEG = 25.0
"""A joint that is so far behind its goal has met something."""
FULL_SHARE = 1.0
"""Torque limit on the way to the rest pose, as a share of the full torque. A weak servo needs all of it."""


class LoweringEnd(enum.StrEnum):
    """How a lowering ended. Any end but ``DOWN`` is early, and the rest of the arm's way is a fall."""

    DOWN = "down"  # the torque limits have fallen to zero
    TIME = "the time is over"
    MUTE = "a servo does not answer"
    FAULT = "a servo reports a fault"
    LIMP = "a servo has lost its torque"
    BLOCKED = "a joint is not where it should be"


class BringDown(Generic[PacketT]):
    """Lower the arm once.

    Args:
        bus: The bus.
        codec: The protocol of the bus.
        axes: The axes, in the order of the model's joints.
        chain: The model of the arm.
        config: How the arm is lowered.
        readings: The newest readings of the servos. ``measure`` updates them.
        measure: Read all servos once. It returns False if a servo does not answer.
        full_torque: The value of each servo's torque limit register for its full torque, by id.
        end_ns: The time at which the torque is switched off, wherever the arm is.
    """

    def __init__(
        self,
        bus: HalfDuplexBus[PacketT],
        codec: Codec[PacketT],
        axes: Sequence[Axis],
        chain: Chain,
        config: LoweringConfig,
        readings: Readings[PacketT],
        measure: Callable[[], Awaitable[bool]],
        full_torque: Mapping[int, int],
        end_ns: int,
    ) -> None:
        self._bus = bus
        self._codec = codec
        self._ids = tuple(axis.id for axis in axes)
        self._chain = chain
        self._config = config
        self._readings = readings
        self._measure = measure
        self._full_torque = full_torque
        self._end_ns = end_ns

    async def run(self) -> LoweringEnd:
        """Lower the arm, which holds its position now. Raise ``WireDown`` if the port is lost."""
        try:
            return await self._follow_path() or await self._let_sink()
        except Quiet:
            return LoweringEnd.MUTE

    async def _follow_path(self) -> LoweringEnd | None:
        """Go to the rest pose, if there is one. Return None when the arm is there, or when the time for it is
        over."""
        rest = self._config.rest
        if rest is None:
            return None
        if (end := await self._look()) is not None:
            return end
        path = RestPath(self._chain, self._rad(self._readings.counts), self._rad(rest))
        clock, shares = self._bus.clock, dict.fromkeys(self._ids, FULL_SHARE)
        began_ns = clock.now_ns()
        while True:
            passed_s = (clock.now_ns() - began_ns) / NS
            if passed_s >= path.seconds or clock.now_ns() >= self._end_ns - round(RELEASE_S * NS):
                return None
            goals = self._counts(path.pose_after(passed_s + PERIOD_S))
            self._send(goals, shares)
            if (end := await self._next_look()) is not None:
                return end
            behind = max(abs(goals[motor] - self._readings.counts[motor]) for motor in self._ids)
            if behind > BEHIND_DEG / 360 * COUNTS:
                return LoweringEnd.BLOCKED

    async def _let_sink(self) -> LoweringEnd:
        """Let the torque limits fall to zero, more slowly while the arm is fast."""
        if (end := await self._stand()) is not None:
            return end
        effort = self._codec.EFFORT
        request = self._codec.sync_read(self._ids, effort.address, effort.size)
        replies = await self._bus.transact(request, dict.fromkeys(self._ids, effort.size), ANSWER_S)
        if len(replies) < len(self._ids):
            return LoweringEnd.MUTE
        efforts = {motor: effort.decode(reply.params) / self._codec.FULL_EFFORT for motor, reply in replies.items()}
        torque = FallingTorque(efforts, FALL_S if self._config.rest is None else RELEASE_S)
        goals = {motor: self._readings.counts[motor] for motor in self._ids}
        before_ns = self._bus.clock.now_ns()
        while not torque.done:
            self._send(goals, torque.shares)
            if (end := await self._next_look()) is not None:
                return end
            now_ns = self._bus.clock.now_ns()
            torque.step(self._pace(), (now_ns - before_ns) / NS)
            before_ns = now_ns
        return LoweringEnd.DOWN

    async def _stand(self) -> LoweringEnd | None:
        """Wait until the arm stands, for at most ``STAND_S``. Its servos then need just the torque that carries it.

        Immediately after a hold they need none: their goals are the present positions, below which the arm sags
        first.
        """
        clock = self._bus.clock
        until_ns = clock.now_ns() + round(STAND_S * NS)
        looks = 0
        end = await self._look()
        while end is None and looks < STANDING_LOOKS and clock.now_ns() < until_ns:
            end = await self._next_look()
            looks = looks + 1 if self._pace() < STANDING_PACE else 0
        return end

    def _send(self, goals: Mapping[int, int], shares: Mapping[int, float]) -> None:
        limits = {motor: round(shares[motor] * full) for motor, full in self._full_torque.items()}
        self._bus.send(self._codec.lower(goals, limits))

    async def _next_look(self) -> LoweringEnd | None:
        """Wait for the next period, and look at the arm then."""
        clock = self._bus.clock
        await clock.sleep_until_ns(clock.now_ns() + round(PERIOD_S * NS))
        return await self._look()

    async def _look(self) -> LoweringEnd | None:
        """Read all servos. Return why the lowering must end now; None if it may go on."""
        if not await self._measure():
            return LoweringEnd.MUTE
        if self._readings.limp:
            return LoweringEnd.LIMP
        if self._readings.has_faults:
            return LoweringEnd.FAULT
        return LoweringEnd.TIME if self._bus.clock.now_ns() >= self._end_ns else None

    def _pace(self) -> float:
        speeds = self._readings.speeds
        return pace(
            self._chain,
            self._rad(self._readings.counts),
            [speeds[motor] / COUNTS_PER_RADIAN for motor in self._ids],
        )

    def _rad(self, counts: Mapping[int, int]) -> list[float]:
        return [(counts[motor] - MIDDLE) / COUNTS_PER_RADIAN for motor in self._ids]

    def _counts(self, rad: Sequence[float]) -> dict[int, int]:
        return {
            motor: round(MIDDLE + angle * COUNTS_PER_RADIAN) for motor, angle in zip(self._ids, rad, strict=True)
        }
