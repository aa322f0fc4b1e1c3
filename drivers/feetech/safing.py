"""Making every servo safe and proving it. Shared by the wire and by the root's second path."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

import trio

from strands_actors.drivers.common.half_duplex import HalfDuplexBus
from strands_actors.runtime.clock import NS
from strands_actors.runtime.contract import MotorReport, WireDown

from . import protocol
from .axes import TOP, Axis

REPEATS = 2
REPEAT_S = 0.002
"""A servo that was just sending a reply talks over the frame: by then six have finished (6 x 17 bytes)."""

RESYNC = b"\0\0"
"""In front of the first safe frame. After a torn FF FF id its FF would be taken for a length, and 255 bytes
be waited for; a length of 0 is none, and the parser begins anew."""

ATTEMPTS = 3
ANSWER_S = 0.04
CONFIRM_S = 1.0
"""Limit of the whole confirmation. A silent servo costs the answer's time and the quiet time, 0.14 s, twice
an attempt: three attempts fit. More than ``read`` allows: here a false alarm is worse than a late one."""

Bus = HalfDuplexBus[protocol.Packet]

_STATE = protocol.TORQUE_ENABLE  # a block of four from here: torque, acceleration, goal
_STATE_SIZE = 4


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

    def reports(self) -> tuple[MotorReport, ...]:
        return tuple(
            MotorReport(
                axis=axis.key,
                id=axis.id,
                written=self.written,
                acknowledged=axis.id in self._answered,
                safe=axis.id in self._safe,
                detail=self._detail[axis.id],
            )
            for axis in self._axes
        )


def unreachable(axes: Sequence[Axis], why: str) -> tuple[MotorReport, ...]:
    tally = Tally(axes)
    tally.failed(why)
    return tally.reports()


class Safing:
    """``travel``: id -> lowest and highest goal the servo takes; it clamps the rest, and so do we, so that
    what is read back can be compared."""

    def __init__(self, bus: Bus, axes: Sequence[Axis], travel: Mapping[int, tuple[int, int]] | None = None) -> None:
        self._bus = bus
        self._axes = tuple(axes)
        self._ids = tuple(axis.id for axis in axes)
        self._travel = travel or {}
        self._longest = len(protocol.hold(dict.fromkeys(self._ids, 0)))

    def goals(self, counts: Mapping[int, int]) -> dict[int, int]:
        """The counts a servo will report as its goal when told to stay at ``counts``."""
        clamped = {}
        for motor, count in counts.items():
            low, high = self._travel.get(motor, (0, TOP))
            clamped[motor] = min(max(count, low), high)
        return clamped

    async def limp(self) -> tuple[MotorReport, ...]:
        """Torque off everywhere. Never raises."""
        tally = Tally(self._axes)
        try:
            await self._burst(protocol.LIMP, tally)
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

    async def hold(self, known: Mapping[int, int], fresh: bool) -> tuple[MotorReport, ...]:
        """Goals := positions. ``known`` goes out at once; when it is not ``fresh`` a second frame follows
        with what the servos say now. Never raises."""
        tally = Tally(self._axes)
        goals = self.goals(known)
        try:
            if goals:
                await self._burst(protocol.hold(goals), tally)
            if not goals or not (fresh or self._bus.quiet):
                now = self.goals(await self._read_positions())
                goals |= now
                if now:
                    await self._burst(protocol.hold(now), tally)
            with trio.move_on_after(CONFIRM_S):
                for attempt in range(ATTEMPTS):
                    again = {motor: goals[motor] for motor in tally.open() if motor in goals}
                    if attempt and again:
                        self._bus.send(protocol.hold(again))
                    await self._read_goals(goals, tally)
                    if not tally.open():
                        break
        except WireDown as error:
            tally.failed(str(error))
        return tally.reports()

    async def _burst(self, frame: bytes, tally: Tally) -> None:
        """What waits to leave is thrown away, which can cut a frame in two, as can the death of its writer:
        the servos then take our first bytes for its rest. ``RESYNC`` and enough copies to outlast the longest
        frame, and their parsers have found FF FF again before the last one."""
        try:
            self._bus.port.discard_output()
        except WireDown as error:
            tally.failed(str(error))  # worth writing all the same
        self._bus.send(RESYNC + frame * (self._longest // len(frame) + 2))
        tally.written = True
        for _ in range(REPEATS):
            await self._pause()
            self._bus.send(frame)

    async def _pause(self) -> None:
        clock = self._bus.clock
        await clock.sleep_until_ns(clock.now_ns() + round(REPEAT_S * NS))

    async def _read_torque(self, tally: Tally) -> None:
        register = protocol.TORQUE_ENABLE
        ids = tally.open()
        replies = await self._ask(ids, register.address, register.size)
        for motor, reply in replies.items():
            tally.answered(motor, reply.params[0] == 0, "still energised")
        self._note_missing(ids, replies, tally)

    async def _insist(self, motor: int, tally: Tally) -> None:
        """One motor alone: torque off with its acknowledgement, then read back."""
        register = protocol.TORQUE_ENABLE
        for request, size in (
            (protocol.write(motor, register, 0), 0),
            (protocol.read(motor, register.address, register.size), register.size),
        ):
            replies = await self._bus.transact(request, {motor: size}, ANSWER_S, wait=True)
            if motor not in replies:
                self._note_missing((motor,), replies, tally)
                return
        tally.answered(motor, replies[motor].params[0] == 0, "still energised")

    async def _read_positions(self) -> dict[int, int]:
        register = protocol.POSITION
        replies = await self._ask(self._ids, register.address, register.size)
        return {motor: register.decode(reply.params) for motor, reply in replies.items()}

    async def _read_goals(self, goals: Mapping[int, int], tally: Tally) -> None:
        ids = tally.open()
        replies = await self._ask(ids, _STATE.address, _STATE_SIZE)
        for motor, reply in replies.items():
            goal = protocol.GOAL_POSITION.decode(reply.params, _STATE.address)
            if motor not in goals:
                tally.answered(motor, False, "position unknown")
            elif _STATE.decode(reply.params) == 0:
                tally.answered(motor, False, "limp")
            else:
                tally.answered(motor, goal == goals[motor], f"goal is {goal}, not {goals[motor]}")
        self._note_missing(ids, replies, tally)

    async def _ask(self, ids: Sequence[int], address: int, size: int) -> dict[int, protocol.Packet]:
        request = protocol.sync_read(ids, address, size)
        return await self._bus.transact(request, dict.fromkeys(ids, size), ANSWER_S, wait=True)

    def _note_missing(self, ids: Iterable[int], replies: Mapping[int, object], tally: Tally) -> None:
        detail = "bad reply" if self._bus.stray_bytes else "silent"
        for motor in ids:
            if motor not in replies:
                tally.unanswered(motor, detail)
