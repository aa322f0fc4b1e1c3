"""The bus of position servos in the wire process.

A subclass has the differences of one protocol or firmware: ``handshake``, and the hooks around arming.
"""

from __future__ import annotations

import contextlib
from abc import abstractmethod
from collections.abc import Callable, Mapping, Sequence
from typing import Any, ClassVar, Generic

import msgspec
import trio

from strands_actors.contract.safe_state import SafeState
from strands_actors.contract.wire import MotorReport, Observation, Permit, PermitDenied, WireDown
from strands_actors.drivers.common.kit.session_wire import SessionWire
from strands_actors.drivers.common.ports.half_duplex import HalfDuplexBus, Health, PacketT, Quiet
from strands_actors.drivers.common.ports.port_users import users_of
from strands_actors.drivers.common.ports.serial_port import BytePort, in_use, open_serial
from strands_actors.kernel.clock import NS, Clock

from .axes import COUNTS, Axis
from .codec import Codec
from .config import ServoConfig
from .handshake import ask, command, roll_call, untold
from .readings import Readings
from .safing import Safing, safing_on, unreachable

TORQUE_CHECK_S = 0.5
HOLD_FRESH_S = 0.05
"""A position that was requested longer ago does not count as the present one."""

OUTSIDE_DEG = 5.0
"""When a servo is energised, it pulls a joint that rests outside its range back in, at full speed. Up to this
distance the joint only twitches. Beyond it, a person should move the joint by hand."""

Range = tuple[int, int]


class Handshake(msgspec.Struct, Generic[PacketT]):
    """The result of ``ServoWire.handshake``."""

    readings: Readings[PacketT]
    travel: Mapping[int, Range]  # id -> lowest and highest goal that it takes
    reach: Mapping[int, Range]  # id -> range in which the joint may rest when it is energised
    facts: dict[str, Any]  # for status


class ServoSession(Generic[PacketT]):
    """The state between ``open`` and ``close``."""

    def __init__(
        self,
        bus: HalfDuplexBus[PacketT],
        ids: Sequence[int],
        handshake: Handshake[PacketT],
        safing: Safing[PacketT],
    ) -> None:
        self.bus = bus
        self.readings = handshake.readings
        self.reach = handshake.reach
        self.safing = safing
        self.health = Health(ids)
        self.observation = self.readings.observation(bus.clock.now_ns(), (), armed=False)
        self.torque_due_ns = 0
        self.silent_since_ns: int | None = None
        self.goals: dict[int, int] = {}  # the last ones that were written
        self.aimed_ns = 0  # when they changed

    def reachable_goals(self, counts: Mapping[int, int]) -> dict[int, int]:
        """Return the goals without servos that are silent, which may have lost their torque, and without
        servos that have lost it."""
        left_out = self.readings.limp.union(self.health.mute())
        return {motor: count for motor, count in counts.items() if motor not in left_out}

    def told(self, goals: Mapping[int, int]) -> None:
        if self.goals != {**self.goals, **goals}:
            self.goals |= goals
            self.aimed_ns = self.bus.clock.now_ns()

    def known(self) -> dict[int, int]:
        """Return the present positions of servos with torque, read since their goals last changed."""
        now_ns = self.bus.clock.now_ns()
        since_ns = max(self.aimed_ns, now_ns - round(HOLD_FRESH_S * NS))
        return self.readings.known(since_ns, now_ns, self.goals, self.aimed_ns)


class ServoWire(SessionWire[ServoSession[PacketT]], Generic[PacketT]):
    """The wire of a servo bus.

    A subclass sets the class variables and ``handshake``, and may override the hooks around arming.
    """

    interruptible: ClassVar[bool] = True
    CODEC: Codec[PacketT]
    SAFING: type[Safing[PacketT]]
    FEEDBACK: ClassVar[Range]
    """Address and size of the block that is read in every cycle."""
    FEEDBACK_AND_TORQUE: ClassVar[Range]
    """The same block with the registers before it. It is one request, so that a check of torque cannot fail
    alone."""

    def __init__(
        self, config: ServoConfig, clock: Clock, open_port: Callable[[str, int], BytePort] = open_serial
    ) -> None:
        self.config = config
        self.axes = config.joints
        self.clock = clock
        self._open_port = open_port
        self._port: BytePort | None = None
        self._armed = False

    # -- parts of a protocol

    @abstractmethod
    async def handshake(self, bus: HalfDuplexBus[PacketT]) -> Handshake[PacketT]:
        """Identify, check and set up the servos, after all ids have answered. Raise ``WireDown``."""

    async def before_arming(self, permit: Permit) -> None:
        """Raise ``WireDown`` for a robot that must not be energised."""

    async def after_arming(self, permit: Permit) -> None:
        """Arm the firmware's watchdogs, after every servo was energised. Raise ``WireDown``."""

    # -- the contract

    async def open(self) -> dict[str, Any]:
        self.close()
        config = self.config
        self._port = self._open_port(config.port, config.baud)
        codec = self.CODEC
        bus = HalfDuplexBus(self._port, codec.Decoder(), self.clock, config.baud, overhead=codec.OVERHEAD)
        try:
            where = f"{config.port} at {config.baud} baud"
            await roll_call(bus, codec, config.robot, self.axes, where, config.others)
            handshake = await self.handshake(bus)
        except BaseException as error:
            self.close()
            if isinstance(error, WireDown) and (users := users_of(config.port)):
                raise WireDown(in_use(config.port, users)) from error  # The other program garbles the replies.
            raise
        safing = self.SAFING(bus, codec, self.axes, handshake.travel)
        self.session_or_none = ServoSession(bus, config.ids, handshake, safing)
        return {
            "port": config.port,
            "baud": config.baud,
            "calibration_source": config.calibration_source,
            **handshake.facts,
        }

    async def arm(self, permit: Permit) -> Observation:
        """Energise motor by motor, each at its present position: a goal alone energises a Feetech servo."""
        self._refuse_passive("arm")
        session = self.session
        await self.before_arming(permit)
        replies = await self.ask_all(*self.FEEDBACK, "its position")
        session.readings.take(replies, self.FEEDBACK[0], session.bus.sent_ns, self.clock.now_ns())
        for axis in self.axes:
            self._refuse_outside(axis, session.readings.counts[axis.id])
        self._armed = True
        for axis in self.axes:
            await self._energise(axis, permit)
        await self.after_arming(permit)
        session.readings.energised()
        session.health = Health(self.config.ids)
        session.observation = session.readings.observation(self.clock.now_ns(), (), armed=True)
        return session.observation

    async def read(self) -> Observation:
        session = self.session
        if session.bus.quiet:
            await trio.lowlevel.checkpoint()  # A caller that reads in a loop must let other tasks run.
        else:
            # A request that a stop has cut short, and that no servo answered, begins the quiet time here.
            with contextlib.suppress(Quiet):
                await self._measure(session)
        return session.observation

    async def write(self, values: tuple[float, ...], permit: Permit) -> None:
        """Write a setpoint to servos that answer and have torque. A goal would give torque back to a servo
        that has lost it."""
        self._refuse_passive("write")
        session = self.session
        if not self._armed:
            raise PermitDenied("not armed")
        requested = {axis.id: axis.count(value) for axis, value in zip(self.axes, values, strict=True)}
        counts = session.reachable_goals(requested)
        if not counts:  # If no servo could take this setpoint in time, drop it.
            raise PermitDenied("no servo is heard that has torque")
        frame = self.CODEC.goals(counts)
        permit.check()
        session.bus.send(frame)
        session.told(counts)

    async def make_safe(self, safe_state: SafeState) -> tuple[MotorReport, ...]:
        session = self.session_or_none
        if session is None:
            return unreachable(self.axes, "not connected")
        if safe_state == SafeState.HOLD:
            return await self._hold(session)
        self._armed = False
        return await session.safing.limp()

    async def reach(self, safe_state: SafeState) -> tuple[MotorReport, ...]:
        """The old descriptor may still take a frame that no servo answers. A new descriptor reaches an
        adapter that was plugged in again."""
        old, config = self._port, self.config
        shouted = False
        try:
            if old is not None and safe_state != SafeState.HOLD:
                shouted = await self._safing_on(old).shout()
        finally:
            self.close()
        try:
            port = self._open_port(config.port, config.baud)
        except WireDown as error:
            return unreachable(self.axes, str(error), shouted)
        try:
            safing = self._safing_on(port)
            return await safing.hold({}) if safe_state == SafeState.HOLD else await safing.limp()
        finally:
            port.close()

    def _safing_on(self, port: BytePort) -> Safing[PacketT]:
        return safing_on(port, self.config, self.CODEC, self.SAFING, self.clock)

    def handover(self) -> Sequence[int]:
        return () if self._port is None else (self._port.fileno(),)

    def close(self) -> None:
        if self._port is not None:
            self._port.close()
        self._port = None
        self.session_or_none = None
        self._armed = False

    # -- for the hooks

    def check_torque_soon(self) -> None:
        """Make the next reading include the torque."""
        self.session.torque_due_ns = 0

    async def ask_all(self, address: int, size: int, what: str) -> dict[int, PacketT]:
        """Read a block that every servo must return, before any servo is energised.

        Args:
            address: The first register.
            size: Bytes of the block.
            what: The name of the value for messages.

        Raises:
            WireDown: A servo did not answer.
        """
        ids, bus = self.config.ids, self.session.bus
        replies = await ask(bus, self.CODEC.sync_read(ids, address, size), dict.fromkeys(ids, size))
        if missing := [axis.label for axis in self.axes if axis.id not in replies]:
            raise WireDown(untold(bus, ", ".join(missing), what))
        return replies

    # -- details

    async def _hold(self, session: ServoSession[PacketT]) -> tuple[MotorReport, ...]:
        if not self._armed:
            return await session.safing.hold({})  # Servos that have torque all the same are asked.
        kept = session.reachable_goals(session.goals)
        reports = await session.safing.hold(session.known(), kept, session.told)
        session.told(
            {
                axis.id: axis.count(report.target)
                for axis, report in zip(self.axes, reports, strict=True)
                if report.target is not None
            }
        )
        return reports

    async def _measure(self, session: ServoSession[PacketT]) -> None:
        now_ns = self.clock.now_ns()
        asked = session.health.to_ask(now_ns)
        base, size = self.FEEDBACK
        if now_ns >= session.torque_due_ns:
            session.torque_due_ns = now_ns + round(TORQUE_CHECK_S * NS)
            base, size = self.FEEDBACK_AND_TORQUE
        bus = session.bus
        replies = await bus.transact(self.CODEC.sync_read(asked, base, size), dict.fromkeys(asked, size))
        now_ns = self.clock.now_ns()
        session.health.update(asked, {*replies, *bus.refusals}, now_ns)
        session.readings.take(replies, base, bus.sent_ns, now_ns, bus.refusals)
        session.observation = session.readings.observation(now_ns, session.health.silent(), self._armed)
        if replies or bus.refusals:
            session.silent_since_ns = None
        elif session.silent_since_ns is None:
            session.silent_since_ns = now_ns
        elif now_ns - session.silent_since_ns > self.config.timeout_s * NS:
            silent_ms = (now_ns - session.silent_since_ns) / 1e6
            raise WireDown(
                f"read: no servo of {self.config.robot} answers for {silent_ms:.0f} ms. "
                "Check power and the bus cable, then reconnect"
            )

    async def _energise(self, axis: Axis, permit: Permit) -> None:
        """Energise one servo, without a jump. Raise ``WireDown`` if it fails.

        First its position is written as the goal, which may energise it already. Torque follows only when the
        goal was read back, because an old goal would be a jump. Then the torque is read back.
        """
        codec, session = self.CODEC, self.session
        goal_register, torque = codec.GOAL_POSITION, codec.TORQUE_ENABLE
        reply = await self._of(axis, *self.FEEDBACK, "its position")
        session.readings.take({axis.id: reply}, self.FEEDBACK[0], session.bus.sent_ns, self.clock.now_ns())
        position = session.readings.counts[axis.id]
        self._refuse_outside(axis, position)
        goal = session.safing.goals({axis.id: position})[axis.id]
        permit.check()
        session.bus.send(codec.hold({axis.id: goal}))
        session.told({axis.id: goal})
        reply = await self._of(axis, goal_register.address, goal_register.size, "its goal")
        taken = goal_register.decode(reply.params)
        if taken != goal:
            raise WireDown(
                f"arm: {axis.label} did not take its present position as goal "
                f"({taken}, not {goal}). Try again; if it stays, check its cable"
            )
        permit.check()
        try:
            await command(session.bus, axis, codec.torque(axis.id, True), "torque on")
        except WireDown:
            refusals = session.bus.refusals
            why = f" ({refusals[axis.id]})" if axis.id in refusals else ""
            raise WireDown(
                f"arm: {axis.label} does not confirm torque on{why}. Check its cable and power"
            ) from None
        reply = await self._of(axis, torque.address, torque.size, "whether it has torque")
        if torque.decode(reply.params) != 1:
            raise WireDown(f"arm: {axis.label} does not stay energised. Check its load, supply and temperature")

    async def _of(self, axis: Axis, address: int, size: int, what: str) -> PacketT:
        """Return a block of one servo. Raise ``WireDown`` if it does not answer."""
        bus = self.session.bus
        replies = await ask(bus, self.CODEC.read(axis.id, address, size), {axis.id: size})
        if axis.id not in replies:
            raise WireDown(untold(bus, axis.label, what))
        return replies[axis.id]

    def _refuse_passive(self, what: str) -> None:
        if self.config.passive:
            raise WireDown(
                f"{what}: {self.config.robot} is a leader arm, which is never energised. Move it by hand"
            )

    def _refuse_outside(self, axis: Axis, count: int) -> None:
        low, high = self.session.reach[axis.id]
        outside_deg = (count - min(max(count, low), high)) * 360 / COUNTS
        if abs(outside_deg) > OUTSIDE_DEG:
            raise WireDown(
                f"arm: {axis.label} rests {abs(outside_deg):.1f} deg outside its range and would be "
                "pulled in. Move it inside by hand"
            )
