"""Command and read a bus of position servos. Runs in the only process that writes to the robot.

A subclass adds the steps that depend on the protocol or firmware: ``handshake``, ``before_arming`` and
``after_arming``.
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
from strands_actors.drivers.common.kinematics.chain import Chain
from strands_actors.drivers.common.kit.session_wire import SessionWire
from strands_actors.drivers.common.ports.half_duplex import HalfDuplexBus, Health, PacketT, Quiet
from strands_actors.drivers.common.ports.port_users import users_of
from strands_actors.drivers.common.ports.serial_port import BytePort, in_use, open_serial
from strands_actors.kernel.clock import NS, Clock

from .axes import COUNTS, Axis
from .bring_down import BringDown, LoweringEnd
from .codec import Codec
from .config import ServoConfig
from .handshake import ask, command, not_reported, roll_call
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
    """The values that ``ServoWire.handshake`` has read from the servos."""

    readings: Readings[PacketT]
    travel: Mapping[int, Range]  # lowest and highest goal that each servo accepts, by id
    reach: Mapping[int, Range]  # range of counts in which each joint may be when it is energised, by id
    facts: dict[str, Any]  # properties of the servos that ``status`` shows
    full_torque: Mapping[int, int]  # value of the torque limit register for full torque, by id
    limits_torque: bool  # True if another program, or a lowering that was cut off, has left a lower limit


class ServoSession(Generic[PacketT]):
    """The state of one connection, from ``open`` to ``close``."""

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
        self.full_torque = handshake.full_torque
        self.limits_torque = handshake.limits_torque
        self.health = Health(ids)
        self.observation = self.readings.observation(bus.clock.now_ns(), (), armed=False)
        self.torque_due_ns = 0
        self.silent_since_ns: int | None = None
        self.goals: dict[int, int] = {}  # last goal that was written to each servo, by id
        self.aimed_ns = 0  # time at which a goal last changed

    def reachable_goals(self, counts: Mapping[int, int]) -> dict[int, int]:
        """Return the goals of servos that answer and have torque. The others are left out, because a goal could
        energise them."""
        excluded = self.readings.limp.union(self.health.mute())
        return {motor: count for motor, count in counts.items() if motor not in excluded}

    def note_sent(self, goals: Mapping[int, int]) -> None:
        if self.goals != {**self.goals, **goals}:
            self.goals |= goals
            self.aimed_ns = self.bus.clock.now_ns()

    def recent_positions(self) -> dict[int, int]:
        """Return the present positions of servos with torque, as far as they were read after the last change of a
        goal."""
        now_ns = self.bus.clock.now_ns()
        since_ns = max(self.aimed_ns, now_ns - round(HOLD_FRESH_S * NS))
        return self.readings.recent_positions(since_ns, now_ns, self.goals, self.aimed_ns)


class ServoWire(SessionWire[ServoSession[PacketT]], Generic[PacketT]):
    """The connection to a robot of position servos on one bus.

    A subclass sets the class variables and ``handshake``, and may override ``before_arming`` and ``after_arming``.
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
        self.lowered: LoweringEnd | None = None
        """How the last lowering ended; None if it was cut off, could not begin, or if there was none."""
        # When a lowering must end; None if there is none. A lowering that was cut off and is begun anew has no
        # more time than the first one.
        self._lowering_end_ns: int | None = None
        lowering = config.lowering
        self._chain = None if lowering is None else Chain(lowering.model, [axis.key for axis in self.axes])

    @property
    def seen(self) -> Observation | None:
        session = self.session_or_none
        return None if session is None or self._lowering_end_ns is None else session.observation

    # -- steps that depend on the protocol

    @abstractmethod
    async def handshake(self, bus: HalfDuplexBus[PacketT]) -> Handshake[PacketT]:
        """Identify, check and set up the servos. All ids have answered before. Raise ``WireDown``."""

    async def before_arming(self, permit: Permit) -> None:
        """Raise ``WireDown`` if the robot must not be energised. ``arm`` calls this before it energises a
        servo."""

    async def after_arming(self, permit: Permit) -> None:
        """Switch on the firmware's watchdogs, if there are any. ``arm`` calls this after every servo was
        energised. Raise ``WireDown``."""

    # -- the contract

    async def open(self) -> dict[str, Any]:
        self.close()
        config = self.config
        self._port = self._open_port(config.port, config.baud)
        codec = self.CODEC
        bus = HalfDuplexBus(self._port, codec.Decoder(), self.clock, config.baud, overhead=codec.OVERHEAD)
        try:
            port_name = f"{config.port} at {config.baud} baud"
            await roll_call(bus, codec, config.robot, self.axes, port_name, config.others)
            handshake = await self.handshake(bus)
        except BaseException as error:
            self.close()
            if isinstance(error, WireDown) and (users := users_of(config.port)):
                # The other program's frames damage the replies, so it is the likely cause of the error.
                raise WireDown(in_use(config.port, users)) from error
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
        """Energise motor after motor, each with its present position as goal. Raise ``WireDown`` if it fails. A
        Feetech servo is energised by a goal alone."""
        self._refuse_passive("arm")
        session = self.session
        await self.before_arming(permit)
        if session.limits_torque:
            await self._lift_torque_limits(session)
        replies = await self.ask_all(*self.FEEDBACK, "its position")
        session.readings.store(replies, self.FEEDBACK[0], session.bus.sent_ns, self.clock.now_ns())
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
            # Let other tasks run, even if the caller reads in a loop.
            await trio.lowlevel.checkpoint()
        else:
            # ``Quiet`` is raised if a stop has cancelled a request that no servo answered: the bus must then be
            # silent for a while.
            with contextlib.suppress(Quiet):
                await self._measure(session)
        return session.observation

    async def write(self, values: tuple[float, ...], permit: Permit) -> None:
        """Send a setpoint to the servos that answer and have torque. The others get no goal, because a goal could
        energise a servo that has lost its torque."""
        self._refuse_passive("write")
        session = self.session
        if not self._armed:
            raise PermitDenied("not armed")
        requested = {axis.id: axis.count(value) for axis, value in zip(self.axes, values, strict=True)}
        counts = session.reachable_goals(requested)
        # Servos that are silent or have no torque get no goal. If no servo is left, drop the setpoint.
        if not counts:
            raise PermitDenied("no servo is heard that has torque")
        frame = self.CODEC.goals(counts)
        permit.check()
        session.bus.send(frame)
        session.note_sent(counts)

    async def make_safe(self, safe_state: SafeState) -> tuple[MotorReport, ...]:
        session = self.session_or_none
        if session is None:
            return unreachable(self.axes, "not connected")
        if safe_state == SafeState.HOLD:
            return await self._hold(session)
        if safe_state == SafeState.LOWERED and (self._armed or self._lowering_end_ns is not None):
            await self._lower(session)
            if self.lowered is not LoweringEnd.DOWN:
                self.ended_in = SafeState.LIMP
        was_lowering = self._lowering_end_ns is not None
        self._armed, self._lowering_end_ns = False, None
        reports = await session.safing.limp()
        if was_lowering:
            # The limits would weaken the arm for the next program. Arming checks them again.
            with contextlib.suppress(WireDown):
                session.bus.send(self.CODEC.full_torque(session.full_torque))
        return reports

    async def reach(self, safe_state: SafeState) -> tuple[MotorReport, ...]:
        """Make the servos safe after the connection was lost.

        For any safe state but ``hold``, the torque is first switched off over the old port, which may still send.
        Then the port is opened again, in case the adapter was unplugged and plugged in again.
        """
        old, config = self._port, self.config
        written = False
        try:
            if old is not None and safe_state != SafeState.HOLD:
                written = await self._safing_on(old).limp_unconfirmed()
        finally:
            self.close()
        try:
            port = self._open_port(config.port, config.baud)
        except WireDown as error:
            return unreachable(self.axes, str(error), written)
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

    # -- for subclasses

    def check_torque_soon(self) -> None:
        """Let the next reading also read whether the servos have torque."""
        self.session.torque_due_ns = 0

    async def ask_all(self, address: int, size: int, label: str) -> dict[int, PacketT]:
        """Read a block of registers from every servo.

        Args:
            address: The address of the first register.
            size: Number of bytes.
            label: The name of the value, for messages.

        Raises:
            WireDown: A servo did not answer.
        """
        ids, bus = self.config.ids, self.session.bus
        replies = await ask(bus, self.CODEC.sync_read(ids, address, size), dict.fromkeys(ids, size))
        if missing := [axis.label for axis in self.axes if axis.id not in replies]:
            raise WireDown(not_reported(bus, ", ".join(missing), label))
        return replies

    # -- details

    async def _hold(self, session: ServoSession[PacketT]) -> tuple[MotorReport, ...]:
        if not self._armed:
            # Some servos may have torque although the robot is not armed. Their positions are read first.
            return await session.safing.hold({})
        last_goals = session.reachable_goals(session.goals)
        reports = await session.safing.hold(session.recent_positions(), last_goals, session.note_sent)
        session.note_sent(
            {
                axis.id: axis.count(report.target)
                for axis, report in zip(self.axes, reports, strict=True)
                if report.target is not None
            }
        )
        return reports

    async def _lower(self, session: ServoSession[PacketT]) -> None:
        """Hold the arm where it is, then lower it. Return when it is down, or when something is wrong."""
        config, chain = self.config.lowering, self._chain
        if config is None or chain is None:
            return

        async def measure() -> bool:
            await self._measure(session)
            return not session.health.silent()

        if self._lowering_end_ns is None:
            self._lowering_end_ns = self.clock.now_ns() + round(config.seconds * NS)
        session.limits_torque = True
        self.lowered = None
        with contextlib.suppress(WireDown):
            goals = session.safing.goals(session.reachable_goals(session.goals) | session.recent_positions())
            if not goals:
                return
            session.note_sent(goals)
            await session.safing.hold_unconfirmed(goals)
            bring_down = BringDown(
                session.bus,
                self.CODEC,
                self.axes,
                chain,
                config,
                session.readings,
                measure,
                session.full_torque,
                self._lowering_end_ns,
            )
            self.lowered = await bring_down.run()

    async def _lift_torque_limits(self, session: ServoSession[PacketT]) -> None:
        """Give each servo its full torque again, and read it back. Raise ``WireDown`` if a servo does not take
        it."""
        register = self.CODEC.TORQUE_LIMIT
        session.bus.send(self.CODEC.full_torque(session.full_torque))
        replies = await self.ask_all(register.address, register.size, "its torque limit")
        for axis in self.axes:
            limit = register.decode(replies[axis.id].params)
            if limit != session.full_torque[axis.id]:
                raise WireDown(
                    f"arming: {axis.label} keeps the torque limit {limit}, must be "
                    f"{session.full_torque[axis.id]}. Power-cycle the servo and try again"
                )
        session.limits_torque = False

    async def _measure(self, session: ServoSession[PacketT]) -> None:
        now_ns = self.clock.now_ns()
        ids = session.health.to_ask(now_ns)
        base, size = self.FEEDBACK
        if now_ns >= session.torque_due_ns:
            session.torque_due_ns = now_ns + round(TORQUE_CHECK_S * NS)
            base, size = self.FEEDBACK_AND_TORQUE
        bus = session.bus
        replies = await bus.transact(self.CODEC.sync_read(ids, base, size), dict.fromkeys(ids, size))
        now_ns = self.clock.now_ns()
        session.health.update(ids, {*replies, *bus.refusals}, now_ns)
        session.readings.store(replies, base, bus.sent_ns, now_ns, bus.refusals)
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
        """Energise one servo without a jump. Raise ``WireDown`` if it fails.

        An old goal would make the servo jump. So its position is first written as the goal, which may energise it
        already. The goal is read back before the torque is switched on. Then the torque is read back.
        """
        codec, session = self.CODEC, self.session
        goal_register, torque = codec.GOAL_POSITION, codec.TORQUE_ENABLE
        reply = await self._of(axis, *self.FEEDBACK, "its position")
        session.readings.store({axis.id: reply}, self.FEEDBACK[0], session.bus.sent_ns, self.clock.now_ns())
        position = session.readings.counts[axis.id]
        self._refuse_outside(axis, position)
        goal = session.safing.goals({axis.id: position})[axis.id]
        permit.check()
        session.bus.send(codec.hold({axis.id: goal}))
        session.note_sent({axis.id: goal})
        reply = await self._of(axis, goal_register.address, goal_register.size, "its goal")
        stored_goal = goal_register.decode(reply.params)
        if stored_goal != goal:
            raise WireDown(
                f"arming: {axis.label} did not take its present position as goal "
                f"({stored_goal}, not {goal}). Check its cable, then try again"
            )
        permit.check()
        try:
            await command(session.bus, axis, codec.torque(axis.id, True), "torque on")
        except WireDown:
            refusals = session.bus.refusals
            detail = f" ({refusals[axis.id]})" if axis.id in refusals else ""
            raise WireDown(
                f"arming: {axis.label} does not confirm torque on{detail}. Check its cable and power"
            ) from None
        reply = await self._of(axis, torque.address, torque.size, "whether it has torque")
        if torque.decode(reply.params) != 1:
            raise WireDown(f"arming: {axis.label} does not stay energised. Check its load, supply and temperature")

    async def _of(self, axis: Axis, address: int, size: int, label: str) -> PacketT:
        """Read a block of registers of one servo. Raise ``WireDown`` if the servo does not answer."""
        bus = self.session.bus
        replies = await ask(bus, self.CODEC.read(axis.id, address, size), {axis.id: size})
        if axis.id not in replies:
            raise WireDown(not_reported(bus, axis.label, label))
        return replies[axis.id]

    def _refuse_passive(self, action: str) -> None:
        if self.config.passive:
            raise WireDown(
                f"{action}: {self.config.robot} is a leader arm, which is never energised. Move the arm by hand"
            )

    def _refuse_outside(self, axis: Axis, count: int) -> None:
        low, high = self.session.reach[axis.id]
        outside_deg = (count - min(max(count, low), high)) * 360 / COUNTS
        if abs(outside_deg) > OUTSIDE_DEG:
            raise WireDown(
                f"arming: {axis.label} is {abs(outside_deg):.1f} deg outside its range and would jump "
                "back. Move it inside its range by hand"
            )
