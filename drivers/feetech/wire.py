"""The Feetech bus in the wire process, and the root's second path to it."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import trio

from strands_actors.drivers.common.half_duplex import HalfDuplexBus, Health
from strands_actors.drivers.common.serial_port import BytePort, adopt_serial, open_serial
from strands_actors.runtime.clock import NS, Clock
from strands_actors.runtime.contract import MotorReport, Observation, Permit, SecondPath, Wire, WireDown

from . import protocol
from .axes import Axis
from .identify import ANSWER_S, Identity, answer_at_once, check, command, facts, identify, roll_call
from .safing import Bus, Safing, unreachable

if TYPE_CHECKING:
    from .driver import Feetech

_FEEDBACK = (protocol.POSITION.address, 11)
"""Position, velocity, load, voltage, temperature .. moving: 56 to 66."""

_FEEDBACK_AND_TORQUE = (protocol.TORQUE_ENABLE.address, 27)
"""The same with what precedes it, 40 to 66: one question, so that a torque check cannot fail on its own."""

TORQUE_CHECK_S = 0.5
LINK_SILENT_S = 0.5
HOLD_FRESH_S = 0.05

OUTSIDE_DEG = 5.0
"""A servo pulls a joint that rests outside its range back in, at full speed, the moment it is energised.
Up to here that is a twitch; beyond, somebody should move the joint by hand."""

_NAN = math.nan


class Readings:
    """The newest of everything, per axis, and the ``Observation`` made of it."""

    def __init__(self, axes: Sequence[Axis], servos: Mapping[int, Identity]) -> None:
        count = len(axes)
        self._axes = tuple(axes)
        self._position = [_NAN] * count
        self._stamp_ns = [0] * count
        self._velocity = [_NAN] * count
        self._load = [_NAN] * count
        self._voltage = [_NAN] * count
        self._temperature = [_NAN] * count
        self._limp: set[int] = set()
        self._error: dict[int, int] = {}
        ordered = [servos[axis.id] for axis in axes]
        self._limits = {
            "voltage_min_v": tuple(servo.min_voltage_v for servo in ordered),
            "voltage_max_v": tuple(servo.max_voltage_v for servo in ordered),
            "temperature_max_c": tuple(servo.max_temperature_c for servo in ordered),
        }
        self.counts: dict[int, int] = {}
        """Last measured position by id."""

    def take(self, replies: Mapping[int, protocol.Packet], base: int, now_ns: int) -> None:
        for at, axis in enumerate(self._axes):
            reply = replies.get(axis.id)
            if reply is None:
                continue
            block = reply.params
            count = protocol.POSITION.decode(block, base)
            self.counts[axis.id] = count
            self._stamp_ns[at] = now_ns
            self._position[at] = axis.value(count)
            self._velocity[at] = protocol.VELOCITY.decode(block, base) / axis.scale
            self._load[at] = protocol.LOAD.decode(block, base) / 10
            self._voltage[at] = protocol.VOLTAGE.decode(block, base) / 10
            self._temperature[at] = float(protocol.TEMPERATURE.decode(block, base))
            self._error[axis.id] = reply.code
            if base <= protocol.TORQUE_ENABLE.address:
                energised = protocol.TORQUE_ENABLE.decode(block, base)
                (self._limp.discard if energised else self._limp.add)(axis.id)

    def energised(self) -> None:
        self._limp.clear()

    def observation(self, now_ns: int, silent: Sequence[int], armed: bool) -> Observation:
        return Observation(
            t_ns=now_ns,
            position=tuple(self._position),
            stamp_ns=tuple(self._stamp_ns),
            velocity=tuple(self._velocity),
            sensors={
                "load_pct": tuple(self._load),
                "voltage_v": tuple(self._voltage),
                "temperature_c": tuple(self._temperature),
                **self._limits,
            },
            faults=self._faults(silent, armed),
        )

    def _faults(self, silent: Sequence[int], armed: bool) -> dict[str, str]:
        faults: dict[str, str] = {}
        for axis in self._axes:
            words = []
            if error := self._error.get(axis.id):
                words.append(protocol.error_words(error))
            if armed and axis.id in self._limp:
                words.append("limp")
            if axis.id in silent:
                words.append("silent")
            if words:
                faults[axis.key] = ", ".join(words)
        return faults


class _Session:
    """What exists between ``open`` and ``close``."""

    def __init__(self, bus: Bus, axes: Sequence[Axis], servos: Mapping[int, Identity]) -> None:
        self.bus = bus
        self.readings = Readings(axes, servos)
        self.health = Health(tuple(axis.id for axis in axes))
        self.safing = Safing(bus, axes, {motor: servo.travel for motor, servo in servos.items()})
        self.observation = self.readings.observation(bus.clock.now_ns(), (), armed=False)
        self.torque_due_ns = 0
        self.silent_since_ns: int | None = None


class FeetechWire(Wire):
    def __init__(
        self,
        driver: Feetech,
        clock: Clock,
        open_port: Callable[[str, int], BytePort] = open_serial,
    ) -> None:
        self._driver = driver
        self._axes = driver.joints
        self._clock = clock
        self._open_port = open_port
        self._session_or_none: _Session | None = None
        self._port: BytePort | None = None
        self._armed = False

    async def open(self) -> dict[str, Any]:
        self.close()
        driver = self._driver
        self._port = self._open_port(driver.port, driver.baud)
        bus = Bus(self._port, protocol.Decoder(), self._clock, driver.baud)
        servos: dict[int, Identity] = {}
        try:
            await roll_call(bus, driver.robot, self._axes, f"{driver.port} at {driver.baud} baud")
            for axis in self._axes:
                servo = await identify(bus, axis)
                check(axis, servo, driver.calibration[axis.key] if driver.calibration else None)
                servos[axis.id] = servo
            for axis in self._axes:
                await answer_at_once(bus, axis, servos[axis.id])
        except BaseException:
            self.close()
            raise
        self._session_or_none = _Session(bus, self._axes, servos)
        return {
            "port": driver.port,
            "baud": driver.baud,
            "calibration_source": driver.calibration_source,
            **facts(self._axes, servos),
        }

    async def arm(self, permit: Permit) -> Observation:
        session = self._session()
        bus = session.bus
        replies = await self._ask_all(_FEEDBACK, "its position")
        session.readings.take(replies, _FEEDBACK[0], self._clock.now_ns())
        positions = dict(session.readings.counts)
        goals = session.safing.goals(positions)
        self._refuse_outside(positions, goals)

        permit.check()
        bus.send(protocol.hold(goals))
        goal = protocol.GOAL_POSITION
        replies = await self._ask_all((goal.address, goal.size), "its goal")
        for axis in self._axes:
            taken = goal.decode(replies[axis.id].params)
            if taken != goals[axis.id]:
                raise WireDown(
                    f"arm: {axis.label} did not take its present position as goal "
                    f"({taken}, not {goals[axis.id]}). Try again; if it stays, check its cable"
                )
        self._armed = True
        for axis in self._axes:
            permit.check()
            await self._energise(axis)
        session.readings.energised()
        session.health = Health(self._driver.ids)
        session.observation = session.readings.observation(self._clock.now_ns(), (), armed=True)
        return session.observation

    async def read(self) -> Observation:
        session = self._session()
        if session.bus.quiet:
            await trio.lowlevel.checkpoint()  # so that a caller who reads in a loop lets others run
        else:
            await self._measure(session)
        return session.observation

    async def write(self, values: tuple[float, ...], permit: Permit) -> None:
        bus = self._session().bus
        frame = protocol.sync_write(
            protocol.GOAL_POSITION,
            {axis.id: axis.count(value) for axis, value in zip(self._axes, values, strict=True)},
        )
        permit.check()
        bus.send(frame)

    async def make_safe(self, rung: str) -> tuple[MotorReport, ...]:
        session = self._session_or_none
        if session is None:
            return unreachable(self._axes, "not connected")
        if rung == "hold":
            age_ns = self._clock.now_ns() - session.observation.t_ns
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

    async def _measure(self, session: _Session) -> None:
        now_ns = self._clock.now_ns()
        asked = session.health.to_ask(now_ns)
        block = _FEEDBACK
        if now_ns >= session.torque_due_ns:
            session.torque_due_ns = now_ns + round(TORQUE_CHECK_S * NS)
            block = _FEEDBACK_AND_TORQUE
        base, size = block
        replies = await session.bus.transact(protocol.sync_read(asked, base, size), dict.fromkeys(asked, size))
        now_ns = self._clock.now_ns()
        session.health.update(asked, replies, now_ns)
        session.readings.take(replies, base, now_ns)
        session.observation = session.readings.observation(now_ns, session.health.silent(), self._armed)
        if replies:
            session.silent_since_ns = None
        elif session.silent_since_ns is None:
            session.silent_since_ns = now_ns
        elif now_ns - session.silent_since_ns > LINK_SILENT_S * NS:
            silent_ms = (now_ns - session.silent_since_ns) / 1e6
            raise WireDown(
                f"read: no servo of {self._driver.robot} answers for {silent_ms:.0f} ms. "
                "Check power and the bus cable, then reconnect"
            )

    async def _ask_all(self, block: tuple[int, int], what: str) -> dict[int, protocol.Packet]:
        """A sync read that every servo must answer, before any of them is energised. Raise ``WireDown``."""
        address, size = block
        ids = self._driver.ids
        replies = await self._session().bus.transact(
            protocol.sync_read(ids, address, size), dict.fromkeys(ids, size), ANSWER_S, wait=True
        )
        if missing := [axis.label for axis in self._axes if axis.id not in replies]:
            raise WireDown(f"arm: {', '.join(missing)} does not tell {what}. Check its cable and power")
        return replies

    async def _energise(self, axis: Axis) -> None:
        register = protocol.TORQUE_ENABLE
        bus = self._session().bus
        try:
            await command(bus, axis, register, 1)
        except WireDown:
            raise WireDown(f"arm: {axis.label} does not confirm torque on. Check its cable and power") from None
        replies = await bus.transact(
            protocol.read(axis.id, register.address, register.size),
            {axis.id: register.size},
            ANSWER_S,
            wait=True,
        )
        if axis.id not in replies or replies[axis.id].params[0] != 1:
            raise WireDown(f"arm: {axis.label} does not stay energised. Check its load, supply and temperature")

    def _refuse_outside(self, positions: Mapping[int, int], goals: Mapping[int, int]) -> None:
        for axis in self._axes:
            outside_deg = abs(positions[axis.id] - goals[axis.id]) * 360 / protocol.COUNTS
            if outside_deg > OUTSIDE_DEG:
                raise WireDown(
                    f"arm: {axis.label} rests {outside_deg:.1f} deg outside its range and would be "
                    "pulled in. Move it inside by hand"
                )

    def _session(self) -> _Session:
        if self._session_or_none is None:
            raise WireDown("wire: not connected. Open it first")
        return self._session_or_none


class FeetechSecondPath(SecondPath):
    """The root's way to the servos: the same open port, after its owner is gone for good."""

    def __init__(self, driver: Feetech, fd: int, clock: Clock) -> None:
        self._axes = driver.joints
        self._baud = driver.baud
        self._clock = clock
        self._port: BytePort = adopt_serial(fd, driver.port)

    async def make_safe(self, rung: str) -> tuple[MotorReport, ...]:
        bus = HalfDuplexBus(self._port, protocol.Decoder(), self._clock, self._baud)
        safing = Safing(bus, self._axes)
        try:
            self._port.discard_output()
            self._port.discard_input()
        except WireDown as error:
            return unreachable(self._axes, str(error))
        # nothing is known here of where the servos are: a hold begins with asking them
        return await safing.hold({}, fresh=False) if rung == "hold" else await safing.limp()

    def close(self) -> None:
        self._port.close()
