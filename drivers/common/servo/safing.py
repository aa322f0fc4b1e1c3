"""Making every servo safe and proving it. Shared by the wire and by the root's stop channel."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import ClassVar, Generic

import trio

from strands_actors.contract.wire import MotorReport, WireDown
from strands_actors.drivers.common.half_duplex import HalfDuplexBus, PacketT
from strands_actors.drivers.common.serial_port import BytePort
from strands_actors.kernel.clock import NS, Clock

from .axes import Axis
from .codec import Codec
from .config import ServoConfig
from .readings import STILL_COUNTS

LIMP = "limp"
"""Detail of a motor that was to hold and has no torque: not safe, nor driven."""

ATTEMPTS = 3
ANSWER_S = 0.04
AT_ONCE_S = 0.005
"""What servos (0.5 ms each) and a quick adapter add to the time that bytes need. A joint at 5.8
rad/s turns by 1.7 degrees meanwhile."""
CONFIRM_S = 1.0
"""Limit of the whole confirmation. A silent servo costs the answer's time and the quiet time, 0.14
s, twice an attempt: three attempts fit. More than ``read`` allows: here a false alarm is worse than
a late one."""


class Tally:
    """What is known so far of each motor."""

    def __init__(self, axes: Sequence[Axis]) -> None:
        self._axes = axes
        self.written = False
        self._answered: set[int] = set()
        self._safe: set[int] = set()
        self._detail = {axis.id: "silent" for axis in axes}

    def open(self) -> tuple[int, ...]:
        """Ids not yet confirmed."""
        return tuple(axis.id for axis in self._axes if axis.id not in self._safe)

    def answered(self, motor: int, safe: bool, detail: str) -> None:
        self._answered.add(motor)
        self._detail[motor] = "" if safe else detail
        if safe:
            self._safe.add(motor)

    def unanswered(self, motor: int, detail: str) -> None:
        if motor not in self._answered:
            self._detail[motor] = detail

    def failed(self, why: str) -> None:
        for motor in self.open():
            self._detail[motor] = why

    def reports(self, goals: Mapping[int, int] | None = None) -> tuple[MotorReport, ...]:
        """``goals``: what each was told to hold, counts by id."""
        held = goals or {}
        return tuple(
            MotorReport(
                axis=axis.key,
                id=axis.id,
                written=self.written,
                acknowledged=axis.id in self._answered,
                safe=axis.id in self._safe,
                detail=self._detail[axis.id],
                target=axis.value(held[axis.id]) if axis.id in held else None,
            )
            for axis in self._axes
        )


def unreachable(axes: Sequence[Axis], why: str, written: bool = False) -> tuple[MotorReport, ...]:
    tally = Tally(axes)
    tally.written = written
    tally.failed(why)
    return tally.reports()


class Safing(Generic[PacketT]):
    """``travel``: id -> lowest and highest goal the servo takes. We clamp to it, so that what is
    read back can be compared."""

    REPEATS: ClassVar[int]
    REPEAT_S: ClassVar[float]
    """The first safe frame is sent again, so often and so far apart: a servo that was just sending
    its reply talked over it, and by the last one all have finished."""

    ANYWHERE: ClassVar[tuple[int, int]]
    """The travel of a servo that has not said its own."""

    def __init__(
        self,
        bus: HalfDuplexBus[PacketT],
        codec: Codec[PacketT],
        axes: Sequence[Axis],
        travel: Mapping[int, tuple[int, int]] | None = None,
    ) -> None:
        self._bus = bus
        self._codec = codec
        self._axes = tuple(axes)
        self._ids = tuple(axis.id for axis in axes)
        self._travel = travel or {}
        self._longest = len(codec.hold(dict.fromkeys(self._ids, 0)))
        goal, torque = codec.GOAL_POSITION, codec.TORQUE_ENABLE
        self._state = torque.address, goal.address + goal.size - torque.address

    @property
    def port_took_a_frame(self) -> bool:
        """Return whether the port took anything, be it a question: then it is not the port that fails."""
        return self._bus.sent > 0

    def goals(self, counts: Mapping[int, int]) -> dict[int, int]:
        """Return the counts a servo will report as its goal when told to stay at ``counts``."""
        clamped = {}
        for motor, count in counts.items():
            low, high = self._travel.get(motor, self.ANYWHERE)
            clamped[motor] = min(max(count, low), high)
        return clamped

    def holds(self, block: bytes, base: int, goal: int | None) -> str:
        """Empty when a servo with these registers, from torque to goal, stays where it is; else
        what it does."""
        if self._codec.TORQUE_ENABLE.decode(block, base) == 0:
            return LIMP
        if goal is None:
            return "position unknown"
        there = self._codec.GOAL_POSITION.decode(block, base)
        return "" if there == goal else f"goal is {there}, not {goal}"

    async def shout(self) -> bool:
        """Torque off everywhere, to whoever hears it: nothing is asked. Whether it left. Never
        raises."""
        tally = Tally(self._axes)
        with contextlib.suppress(WireDown):  # of a dead port; a part of it may have left
            await self._burst(self._codec.LIMP, tally)
        return tally.written

    async def limp(self) -> tuple[MotorReport, ...]:
        """Torque off everywhere. Never raises."""
        tally = Tally(self._axes)
        try:
            await self._burst(self._codec.LIMP, tally)
            with trio.move_on_after(CONFIRM_S):
                for _ in range(ATTEMPTS):
                    await self._read_torque(tally)
                    for motor in tally.open():
                        await self._insist(motor, tally)
                    if not tally.open():
                        break
        except WireDown as error:
            tally.failed(str(error))
        return tally.reports()

    async def hold(
        self,
        known: Mapping[int, int],
        kept: Mapping[int, int] | None = None,
        tell: Callable[[Mapping[int, int]], None] = lambda _: None,
    ) -> tuple[MotorReport, ...]:
        """Goals := positions. ``known``: where those that have torque are now. ``kept``: the last
        goals of those that have torque, told again to the others, since a goal from an older
        reading would move them. Both go out at once; then the others are asked where they are, and
        held there. One that does not answer keeps its last goal, and one without torque gets none:
        a goal may energise it. ``tell`` hears of all goals that leave, since a hold that is cut
        short makes no report. Never raises."""
        tally = Tally(self._axes)
        goals = self.goals(known)
        told = {**(kept or {}), **goals}
        try:
            if told:
                tell(told)
                await self._burst(self._codec.hold(told), tally)
            with trio.move_on_after(CONFIRM_S):
                for attempt in range(ATTEMPTS):
                    await self._hold_others(goals, tally, tell)
                    if attempt and (again := {motor: goals[motor] for motor in tally.open() if motor in goals}):
                        self._bus.send(self._codec.hold(again))
                    await self._read_goals(goals, tally)
                    if not tally.open():
                        break
        except WireDown as error:
            tally.failed(str(error))
        return tally.reports({**told, **goals})

    async def _hold_others(
        self, goals: dict[int, int], tally: Tally, tell: Callable[[Mapping[int, int]], None]
    ) -> None:
        """Ask those without a goal where they are, and hold them there."""
        if lacking := [motor for motor in tally.open() if motor not in goals]:
            found = self.goals(await self._read_places(lacking, tally))
            goals |= found
            if found:
                tell(found)
                await self._burst(self._codec.hold(found), tally)

    async def _burst(self, frame: bytes, tally: Tally) -> None:
        """What waits to leave is thrown away, which can cut a frame in two, as can the death of its
        writer: the servos then take our first bytes for its rest. RESYNC and enough copies to
        outlast the longest frame, and their parsers have found a header again before the last
        one."""
        try:
            self._bus.port.discard_output()
        except WireDown as error:
            tally.failed(str(error))  # worth writing all the same
        self._bus.send(self._codec.RESYNC + frame * (self._longest // len(frame) + 2))
        tally.written = True
        for _ in range(self.REPEATS):
            await self._pause()
            self._bus.send(frame)

    async def _pause(self) -> None:
        clock = self._bus.clock
        await clock.sleep_until_ns(clock.now_ns() + round(self.REPEAT_S * NS))

    async def _read_torque(self, tally: Tally) -> None:
        register = self._codec.TORQUE_ENABLE
        ids = tally.open()
        replies = await self._ask(ids, register.address, register.size)
        for motor, reply in replies.items():
            tally.answered(motor, reply.params[0] == 0, "still energised")
        self._note_missing(ids, replies, tally)

    async def _insist(self, motor: int, tally: Tally) -> None:
        """One motor alone: torque off with its acknowledgement, then read back."""
        register = self._codec.TORQUE_ENABLE
        for request, size in (
            (self._codec.torque(motor, False), 0),
            (self._codec.read(motor, register.address, register.size), register.size),
        ):
            replies = await self._bus.transact(request, {motor: size}, ANSWER_S, wait=True)
            if motor not in replies:
                self._note_missing((motor,), replies, tally)
                return
        tally.answered(motor, replies[motor].params[0] == 0, "still energised")

    async def _read_places(self, ids: Sequence[int], tally: Tally) -> dict[int, int]:
        """Return where they are. An answer that was long on its way tells where a joint was: then
        who has gone on since, by a second answer, is left out."""
        found = await self._read_positions(ids, tally)
        if found and self._bus.delay_s > AT_ONCE_S:
            again = await self._read_positions(list(found), tally)
            return {motor: at for motor, at in again.items() if abs(at - found[motor]) <= STILL_COUNTS}
        return found

    async def _read_positions(self, ids: Sequence[int], tally: Tally) -> dict[int, int]:
        """Of those that have torque."""
        torque, position = self._codec.TORQUE_ENABLE, self._codec.POSITION
        base = torque.address
        replies = await self._ask(ids, base, position.address + position.size - base)
        for motor, reply in replies.items():
            if not torque.decode(reply.params, base):
                tally.answered(motor, False, LIMP)
        return {
            motor: position.decode(reply.params, base)
            for motor, reply in replies.items()
            if torque.decode(reply.params, base)
        }

    async def _read_goals(self, goals: dict[int, int], tally: Tally) -> None:
        ids = tally.open()
        address, size = self._state
        replies = await self._ask(ids, address, size)
        for motor, reply in replies.items():
            detail = self.holds(reply.params, address, goals.get(motor))
            tally.answered(motor, not detail, detail)
            if detail == LIMP:
                goals.pop(motor, None)  # it is not told again
        self._note_missing(ids, replies, tally)

    async def _ask(self, ids: Sequence[int], address: int, size: int) -> dict[int, PacketT]:
        request = self._codec.sync_read(ids, address, size)
        return await self._bus.transact(request, dict.fromkeys(ids, size), ANSWER_S, wait=True)

    def _note_missing(self, ids: Iterable[int], replies: Mapping[int, object], tally: Tally) -> None:
        detail = "bad reply" if self._bus.stray_bytes else "silent"
        for motor in ids:
            if motor in self._bus.refusals:
                tally.answered(motor, False, f"refuses: {self._bus.refusals[motor]}")
            elif motor not in replies:
                tally.unanswered(motor, detail)


def safing_on(
    port: BytePort, config: ServoConfig, codec: Codec[PacketT], safing: type[Safing[PacketT]], clock: Clock
) -> Safing[PacketT]:
    """Return the safing on a port about which nothing is known."""
    bus = HalfDuplexBus(port, codec.Decoder(), clock, config.baud, overhead=codec.OVERHEAD)
    return safing(bus, codec, config.joints)
