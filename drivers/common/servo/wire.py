"""The bus of position servos in the wire process, and the root's second path to it.

What one protocol or firmware does differently is in its subclass: ``hello``, and the hooks around arming.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Mapping, Sequence
from typing import Any, ClassVar, Generic

import msgspec
import trio

from strands_actors.drivers.common.half_duplex import HalfDuplexBus, Health, PacketT
from strands_actors.drivers.common.serial_port import BytePort, adopt_serial, open_serial
from strands_actors.runtime.clock import NS, Clock
from strands_actors.runtime.contract import MotorReport, Observation, Permit, SecondPath, Wire, WireDown

from .axes import COUNTS, Axis
from .codec import Codec
from .driver import ServoDriver
from .hello import ANSWER_S, command, roll_call
from .readings import Readings
from .safing import Safing, unreachable

TORQUE_CHECK_S = 0.5
LINK_SILENT_S = 0.5
HOLD_FRESH_S = 0.05

OUTSIDE_DEG = 5.0
"""A servo pulls a joint that rests outside its range back in, at full speed, the moment it is energised.
Up to here that is a twitch; beyond, somebody should move the joint by hand."""

Range = tuple[int, int]


class Hello(msgspec.Struct, Generic[PacketT]):
    """What the servos said when the wire was opened."""

    readings: Readings[PacketT]
    travel: Mapping[int, Range]  # id -> lowest and highest goal it takes
    reach: Mapping[int, Range]  # id -> where the joint may rest when it is energised
    facts: dict[str, Any]  # for status


class _Session(Generic[PacketT]):
    """What exists between ``open`` and ``close``."""

    def __init__(
        self, bus: HalfDuplexBus[PacketT], ids: Sequence[int], hello: Hello[PacketT], safing: Safing[PacketT]
    ) -> None:
        self.bus = bus
        self.readings = hello.readings
        self.reach = hello.reach
        self.safing = safing
        self.health = Health(ids)
        self.observation = self.readings.observation(bus.clock.now_ns(), (), armed=False)
        self.torque_due_ns = 0
        self.silent_since_ns: int | None = None


class ServoWire(Wire, Generic[PacketT]):
    CODEC: Codec[PacketT]
    SAFING: type[Safing[PacketT]]
    FEEDBACK: ClassVar[Range]
    """Address and size of what is read in every cycle."""
    FEEDBACK_AND_TORQUE: ClassVar[Range]
    """The same with what precedes it: one question, so that a torque check cannot fail on its own."""

    def __init__(
        self, driver: ServoDriver, clock: Clock, open_port: Callable[[str, int], BytePort] = open_serial
    ) -> None:
        self.driver = driver
        self.axes = driver.joints
        self.clock = clock
        self._open_port = open_port
        self._session_or_none: _Session[PacketT] | None = None
        self._port: BytePort | None = None
        self._armed = False

    # -- what a protocol adds

    @abstractmethod
    async def hello(self, bus: HalfDuplexBus[PacketT]) -> Hello[PacketT]:
        """All ids have answered: identify them, check them, set them up. Raise ``WireDown``."""

    async def before_arming(self, permit: Permit) -> None:
        """Refuse what must not be energised. Raise ``WireDown``."""

    async def after_arming(self, permit: Permit) -> None:
        """Every servo is energised: arm what the firmware watches by itself. Raise ``WireDown``."""

    # -- the contract

    async def open(self) -> dict[str, Any]:
        self.close()
        driver = self.driver
        self._port = self._open_port(driver.port, driver.baud)
        codec = self.CODEC
        bus = HalfDuplexBus(self._port, codec.Decoder(), self.clock, driver.baud, overhead=codec.OVERHEAD)
        try:
            await roll_call(bus, codec, driver.robot, self.axes, f"{driver.port} at {driver.baud} baud")
            hello = await self.hello(bus)
        except BaseException:
            self.close()
            raise
        safing = self.SAFING(bus, codec, self.axes, hello.travel)
        self._session_or_none = _Session(bus, driver.ids, hello, safing)
        return {
            "port": driver.port,
            "baud": driver.baud,
            "calibration_source": driver.calibration_source,
            **hello.facts,
        }

    async def arm(self, permit: Permit) -> Observation:
        session = self.session
        bus = session.bus
        await self.before_arming(permit)
        replies = await self.ask_all(*self.FEEDBACK, "its position")
        session.readings.take(replies, self.FEEDBACK[0], self.clock.now_ns())
        positions = dict(session.readings.counts)
        goals = session.safing.goals(positions)
        self._refuse_outside(positions)

        permit.check()
        bus.send(self.CODEC.hold(goals))
        goal = self.CODEC.GOAL_POSITION
        replies = await self.ask_all(goal.address, goal.size, "its goal")
        for axis in self.axes:
            taken = goal.decode(replies[axis.id].params)
            if taken != goals[axis.id]:
                raise WireDown(
                    f"arm: {axis.label} did not take its present position as goal "
                    f"({taken}, not {goals[axis.id]}). Try again; if it stays, check its cable"
                )
        self._armed = True
        for axis in self.axes:
            permit.check()
            await self._energise(axis)
        await self.after_arming(permit)
        session.readings.energised()
        session.health = Health(self.driver.ids)
        session.observation = session.readings.observation(self.clock.now_ns(), (), armed=True)
        return session.observation

    async def read(self) -> Observation:
        session = self.session
        if session.bus.quiet:
            await trio.lowlevel.checkpoint()  # so that a caller who reads in a loop lets others run
        else:
            await self._measure(session)
        return session.observation

    async def write(self, values: tuple[float, ...], permit: Permit) -> None:
        bus = self.session.bus
        frame = self.CODEC.goals(
            {axis.id: axis.count(value) for axis, value in zip(self.axes, values, strict=True)}
        )
        permit.check()
        bus.send(frame)

    async def make_safe(self, rung: str) -> tuple[MotorReport, ...]:
        session = self._session_or_none
        if session is None:
            return unreachable(self.axes, "not connected")
        if rung == "hold":
            age_ns = self.clock.now_ns() - session.observation.t_ns
            return await session.safing.hold(session.readings.counts, fresh=age_ns <= HOLD_FRESH_S * NS)
        self._armed = False
        return await session.safing.limp()

    def handover(self) -> Sequence[int]:
        return () if self._port is None else (self._port.fileno(),)

    def close(self) -> None:
        if self._port is not None:
            self._port.close()
        self._port = None
        self._session_or_none = None
        self._armed = False

    # -- for the hooks

    @property
    def session(self) -> _Session[PacketT]:
        if self._session_or_none is None:
            raise WireDown("wire: not connected. Open it first")
        return self._session_or_none

    def check_torque_soon(self) -> None:
        """The next reading asks for everything."""
        self.session.torque_due_ns = 0

    async def ask_all(self, address: int, size: int, what: str) -> dict[int, PacketT]:
        """A sync read that every servo must answer, before any of them is energised. Raise ``WireDown``."""
        ids, bus = self.driver.ids, self.session.bus
        request = self.CODEC.sync_read(ids, address, size)
        replies = await bus.transact(request, dict.fromkeys(ids, size), ANSWER_S, wait=True)
        if missing := [axis.label for axis in self.axes if axis.id not in replies]:
            why = f" ({', '.join(bus.refusals.values())})" if bus.refusals else ""
            raise WireDown(f"arm: {', '.join(missing)} does not tell {what}{why}. Check its cable and power")
        return replies

    # -- details

    async def _measure(self, session: _Session[PacketT]) -> None:
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
        session.readings.take(replies, base, now_ns, bus.refusals)
        session.observation = session.readings.observation(now_ns, session.health.silent(), self._armed)
        if replies or bus.refusals:
            session.silent_since_ns = None
        elif session.silent_since_ns is None:
            session.silent_since_ns = now_ns
        elif now_ns - session.silent_since_ns > LINK_SILENT_S * NS:
            silent_ms = (now_ns - session.silent_since_ns) / 1e6
            raise WireDown(
                f"read: no servo of {self.driver.robot} answers for {silent_ms:.0f} ms. "
                "Check power and the bus cable, then reconnect"
            )

    async def _energise(self, axis: Axis) -> None:
        register = self.CODEC.TORQUE_ENABLE
        bus = self.session.bus
        try:
            await command(bus, axis, self.CODEC.torque(axis.id, True), "torque on")
        except WireDown:
            why = f" ({bus.refusals[axis.id]})" if axis.id in bus.refusals else ""
            raise WireDown(
                f"arm: {axis.label} does not confirm torque on{why}. Check its cable and power"
            ) from None
        request = self.CODEC.read(axis.id, register.address, register.size)
        replies = await bus.transact(request, {axis.id: register.size}, ANSWER_S, wait=True)
        if axis.id not in replies or replies[axis.id].params[0] != 1:
            raise WireDown(f"arm: {axis.label} does not stay energised. Check its load, supply and temperature")

    def _refuse_outside(self, positions: Mapping[int, int]) -> None:
        for axis in self.axes:
            low, high = self.session.reach[axis.id]
            count = positions[axis.id]
            outside_deg = (count - min(max(count, low), high)) * 360 / COUNTS
            if abs(outside_deg) > OUTSIDE_DEG:
                raise WireDown(
                    f"arm: {axis.label} rests {abs(outside_deg):.1f} deg outside its range and would be "
                    "pulled in. Move it inside by hand"
                )


class ServoSecondPath(SecondPath, Generic[PacketT]):
    """The root's way to the servos: the same open port, after its owner is gone for good."""

    def __init__(
        self, driver: ServoDriver, codec: Codec[PacketT], safing: type[Safing[PacketT]], fd: int, clock: Clock
    ) -> None:
        self._axes = driver.joints
        self._baud = driver.baud
        self._clock = clock
        self._codec = codec
        self._safing = safing
        self._port: BytePort = adopt_serial(fd, driver.port)

    async def make_safe(self, rung: str) -> tuple[MotorReport, ...]:
        codec = self._codec
        bus = HalfDuplexBus(self._port, codec.Decoder(), self._clock, self._baud, overhead=codec.OVERHEAD)
        safing = self._safing(bus, codec, self._axes)
        try:
            self._port.discard_output()
            self._port.discard_input()
        except WireDown as error:
            return unreachable(self._axes, str(error))
        # nothing is known here of where the servos are: a hold begins with asking them
        return await safing.hold({}, fresh=False) if rung == "hold" else await safing.limp()

    def close(self) -> None:
        self._port.close()
