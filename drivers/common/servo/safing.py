"""Bring every servo to a safe state (limp or holding its position), and confirm it by reading back. The process
that commands the robot and the process that supervises it share this code."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import ClassVar, Generic

import trio

from strands_actors.contract.wire import MotorReport, WireDown
from strands_actors.drivers.common.ports.half_duplex import HalfDuplexBus, PacketT
from strands_actors.drivers.common.ports.serial_port import BytePort
from strands_actors.kernel.clock import NS, Clock

from .axes import Axis
from .codec import Codec
from .config import ServoConfig
from .readings import STILL_COUNTS

LIMP = "limp"
"""Detail of a motor that should hold and has no torque. It is not safe, but not driven either."""

ATTEMPTS = 3
ANSWER_S = 0.04
AT_ONCE_S = 0.005
"""Time that servos (0.5 ms each) and a quick adapter need beyond the bytes on the line. A joint at 5.8 rad/s
turns by 1.7 degrees meanwhile."""
CONFIRM_S = 1.0
"""Longest time of the whole confirmation. A silent servo costs the time of an answer and the quiet time, 0.14
s, twice per attempt, so three attempts fit. It is more than ``read`` allows, since a false alarm is worse
here than a late one."""


class Tally:
    """The results of a stop so far, for each motor."""

    def __init__(self, axes: Sequence[Axis]) -> None:
        self._axes = axes
        self.written = False
        self._answered: set[int] = set()
        self._safe: set[int] = set()
        self._detail = {axis.id: "silent" for axis in axes}

    def open(self) -> tuple[int, ...]:
        """Return the ids of motors that are not confirmed as safe yet."""
        return tuple(axis.id for axis in self._axes if axis.id not in self._safe)

    def answered(self, motor: int, safe: bool, detail: str) -> None:
        self._answered.add(motor)
        self._detail[motor] = "" if safe else detail
        if safe:
            self._safe.add(motor)

    def unanswered(self, motor: int, detail: str) -> None:
        if motor not in self._answered:
            self._detail[motor] = detail

    def failed(self, reason: str) -> None:
        for motor in self.open():
            self._detail[motor] = reason

    def reports(self, goals: Mapping[int, int] | None = None) -> tuple[MotorReport, ...]:
        """Return one ``MotorReport`` per motor, with its result so far. ``goals`` are the positions at which the
        motors should hold, in counts by id."""
        targets = goals or {}
        return tuple(
            MotorReport(
                axis=axis.key,
                id=axis.id,
                written=self.written,
                acknowledged=axis.id in self._answered,
                safe=axis.id in self._safe,
                detail=self._detail[axis.id],
                target=axis.value(targets[axis.id]) if axis.id in targets else None,
            )
            for axis in self._axes
        )


def unreachable(axes: Sequence[Axis], reason: str, written: bool = False) -> tuple[MotorReport, ...]:
    tally = Tally(axes)
    tally.written = written
    tally.failed(reason)
    return tally.reports()


class Safing(Generic[PacketT]):
    """Bring the servos of one bus to a safe state: no torque (limp), or torque at the present position (hold). A
    subclass sets the class variables for its protocol.

    Args:
        bus: The bus.
        codec: The protocol of the bus.
        axes: The axes.
        travel: Lowest and highest goal that each servo accepts, by id. Goals are limited to this range, so that
            they equal the goals that are read back.
    """

    REPEATS: ClassVar[int]
    REPEAT_S: ClassVar[float]
    """How often and how far apart the first safe frame is sent again. A servo that is just sending its reply
    misses the frame; by the last repetition all have finished."""

    ANYWHERE: ClassVar[tuple[int, int]]
    """The travel of a servo that has not reported one."""

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
        """True if the serial port has accepted any frame from this object, even a read request. Then the port
        works."""
        return self._bus.sent > 0

    def goals(self, counts: Mapping[int, int]) -> dict[int, int]:
        """Return the goals that servos will have after ``counts`` are sent: each is limited to the servo's
        range."""
        clamped = {}
        for motor, count in counts.items():
            low, high = self._travel.get(motor, self.ANYWHERE)
            clamped[motor] = min(max(count, low), high)
        return clamped

    def holds(self, block: bytes, base: int, goal: int | None) -> str:
        """Return why a servo does not hold; empty if it does.

        Args:
            block: The servo's registers from torque to goal.
            base: The address of the block's first register.
            goal: The goal that the servo should have; None if its position is unknown.
        """
        if self._codec.TORQUE_ENABLE.decode(block, base) == 0:
            return LIMP
        if goal is None:
            return "position unknown"
        stored_goal = self._codec.GOAL_POSITION.decode(block, base)
        return "" if stored_goal == goal else f"goal is {stored_goal}, not {goal}"

    async def limp_unconfirmed(self) -> bool:
        """Switch off the torque of all servos, without confirmation. Never raises.

        Returns:
            True if the frame was sent.
        """
        tally = Tally(self._axes)
        # If the port does not work, a part of the frame may have been sent even so.
        with contextlib.suppress(WireDown):
            await self._burst(self._codec.LIMP, tally)
        return tally.written

    async def hold_unconfirmed(self, goals: Mapping[int, int]) -> None:
        """Send these goals as a hold, without confirmation. Raise ``WireDown`` if the port is lost."""
        await self._burst(self._codec.hold(goals), Tally(self._axes))

    async def limp(self) -> tuple[MotorReport, ...]:
        """Switch off the torque of all servos, and confirm it for each servo. Never raises."""
        tally = Tally(self._axes)
        try:
            await self._burst(self._codec.LIMP, tally)
            with trio.move_on_after(CONFIRM_S):
                for _ in range(ATTEMPTS):
                    await self._read_torque(tally)
                    for motor in tally.open():
                        await self._limp_one(motor, tally)
                    if not tally.open():
                        break
        except WireDown as error:
            tally.failed(str(error))
        return tally.reports()

    async def hold(
        self,
        positions: Mapping[int, int],
        last_goals: Mapping[int, int] | None = None,
        before_send: Callable[[Mapping[int, int]], None] = lambda _: None,
    ) -> tuple[MotorReport, ...]:
        """Set the goal of each servo to its position, and confirm it. Never raises.

        The goals from ``positions`` and ``last_goals`` are sent at once. Then the positions of the other servos are
        read, and become their goals. A servo that does not answer keeps its last goal. A servo without torque gets
        no goal, because a goal may energise it.

        Args:
            positions: Present positions of servos with torque, in counts by id.
            last_goals: Last goals of servos with torque. A servo that is not in ``positions`` gets its last goal
                again, because a goal from an old reading would move it.
            before_send: Called with all goals before they are sent, because a cancelled hold returns no report.
        """
        tally = Tally(self._axes)
        goals = self.goals(positions)
        sent = {**(last_goals or {}), **goals}
        try:
            if sent:
                before_send(sent)
                await self._burst(self._codec.hold(sent), tally)
            with trio.move_on_after(CONFIRM_S):
                for attempt in range(ATTEMPTS):
                    await self._hold_others(goals, tally, before_send)
                    if attempt and (again := {motor: goals[motor] for motor in tally.open() if motor in goals}):
                        self._bus.send(self._codec.hold(again))
                    await self._read_goals(goals, tally)
                    if not tally.open():
                        break
        except WireDown as error:
            tally.failed(str(error))
        return tally.reports({**sent, **goals})

    async def _hold_others(
        self, goals: dict[int, int], tally: Tally, before_send: Callable[[Mapping[int, int]], None]
    ) -> None:
        """Read the positions of servos that have no goal yet, and set them as their goals."""
        if lacking := [motor for motor in tally.open() if motor not in goals]:
            new_goals = self.goals(await self._read_places(lacking, tally))
            goals |= new_goals
            if new_goals:
                before_send(new_goals)
                await self._burst(self._codec.hold(new_goals), tally)

    async def _burst(self, frame: bytes, tally: Tally) -> None:
        """Send a stop frame (for limp or hold) so often that each servo reads it, even after an incomplete frame.

        Output that was not sent yet is dropped first. This may leave an incomplete frame on the bus, as does the
        death of a process while it writes. A servo then takes the following bytes for the rest of that frame.
        RESYNC and enough copies of the stop frame (more bytes than the longest frame has) let its parser find a
        header before the last copy.
        """
        try:
            self._bus.port.discard_output()
        except WireDown as error:
            # Dropping the unsent output has failed. Even so, try to write the stop frame.
            tally.failed(str(error))
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

    async def _limp_one(self, motor: int, tally: Tally) -> None:
        """Switch off the torque of one motor with an acknowledged write, and read it back."""
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
        """Return the present positions of the servos that answer and have torque, in counts by id.

        If the replies took long, their positions may be old. Then the positions are read again, and joints that
        have moved between the readings are left out.
        """
        positions = await self._read_positions(ids, tally)
        if positions and self._bus.delay_s > AT_ONCE_S:
            again = await self._read_positions(list(positions), tally)
            return {
                motor: position
                for motor, position in again.items()
                if abs(position - positions[motor]) <= STILL_COUNTS
            }
        return positions

    async def _read_positions(self, ids: Sequence[int], tally: Tally) -> dict[int, int]:
        """Read the positions of servos, and return those of servos with torque, by id."""
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
                # A servo without torque gets no goal, because a goal may energise it.
                goals.pop(motor, None)
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
    """Return a ``Safing`` for a port whose servos were not read yet."""
    bus = HalfDuplexBus(port, codec.Decoder(), clock, config.baud, overhead=codec.OVERHEAD)
    return safing(bus, codec, config.joints)
