"""The Dynamixel bus in the wire process, and the root's stop channel to it."""

from __future__ import annotations

from collections.abc import Callable
from typing import ClassVar

import trio

from strands_actors.contract.safe_state import SafeState
from strands_actors.contract.wire import MotorReport, Observation, Permit, WireDown
from strands_actors.drivers.common.ports.half_duplex import HalfDuplexBus
from strands_actors.drivers.common.ports.serial_port import BytePort, open_serial
from strands_actors.drivers.common.servo.config import ServoConfig
from strands_actors.drivers.common.servo.handshake import command
from strands_actors.drivers.common.servo.identity import limits_of
from strands_actors.drivers.common.servo.safing import LIMP
from strands_actors.drivers.common.servo.stop_channel import ServoStopChannel
from strands_actors.drivers.common.servo.wire import Handshake, ServoWire
from strands_actors.kernel.clock import NS, Clock

from . import protocol, table, watchdog
from .identify import Identity, check, facts, identify, reach
from .readings import DynamixelReadings
from .safing import DynamixelSafing

_STATE = (table.TORQUE_ENABLE.address, table.BUS_WATCHDOG.address - table.TORQUE_ENABLE.address + 1)
ANSWER_EVERYTHING = 2
"""Status level, as after power on: a write is acknowledged, too."""


class DynamixelWire(ServoWire[protocol.Packet]):
    CODEC = protocol
    SAFING = DynamixelSafing
    FEEDBACK: ClassVar[tuple[int, int]] = (table.CURRENT.address, 21)
    """Current or load, velocity, position .. voltage, temperature: 126 to 146."""
    FEEDBACK_AND_TORQUE: ClassVar[tuple[int, int]] = (table.TORQUE_ENABLE.address, 83)
    """64 to 146: hardware errors and the bus watchdog, too."""

    def __init__(
        self, config: ServoConfig, clock: Clock, open_port: Callable[[str, int], BytePort] = open_serial
    ) -> None:
        super().__init__(config, clock, open_port)
        self._readings = DynamixelReadings((), {})
        self._feed_until_ns: int | None = None  # None: the arm rests or holds, and may be read for ever

    async def handshake(self, bus: HalfDuplexBus[protocol.Packet]) -> Handshake[protocol.Packet]:
        self._feed_until_ns = None
        bus.send(protocol.sync_write(table.STATUS_LEVEL, dict.fromkeys(self.config.ids, ANSWER_EVERYTHING)))
        servos: dict[int, Identity] = {}
        calibration = self.config.calibration
        for axis in self.axes:
            servo = await identify(bus, axis)
            check(axis, servo, calibration[axis.key] if calibration else None)
            servos[axis.id] = servo
        limits = limits_of(self.axes, [servos[axis.id] for axis in self.axes])
        self._readings = DynamixelReadings(self.axes, limits)
        return Handshake(
            readings=self._readings,
            travel={motor: servo.travel for motor, servo in servos.items()},
            reach={axis.id: reach(axis, servos[axis.id], calibration is not None) for axis in self.axes},
            facts=facts(self.axes, servos),
        )

    # -- arming

    async def before_arming(self, permit: Permit) -> None:
        """No latched alert, and every bus watchdog off: of one that has tripped with its torque
        off."""
        bus = self.session.bus
        replies = await self.ask_all(*_STATE, "its state")
        for axis in self.axes:
            state = replies[axis.id].params
            if alert := table.HARDWARE_ERROR.decode(state, _STATE[0]):
                raise WireDown(
                    f"arm: {axis.label} has {table.error_words(alert)} latched. "
                    "Clear the cause, then reboot it with the arm supported"
                )
            tripped = table.BUS_WATCHDOG.decode(state, _STATE[0]) == table.WATCHDOG_TRIPPED
            if tripped and table.TORQUE_ENABLE.decode(state, _STATE[0]):
                await command(bus, axis, protocol.torque(axis.id, False), "torque off")
        await self._set_watchdogs(table.WATCHDOG_OFF)

    async def after_arming(self, permit: Permit) -> None:
        permit.check()
        await self._set_watchdogs(watchdog.COUNTS)
        self._feed_until_ns = None

    async def _set_watchdogs(self, counts: int) -> None:
        """On every servo, and read back. Raise ``WireDown``."""
        register = table.BUS_WATCHDOG
        self.session.bus.send(protocol.sync_write(register, dict.fromkeys(self.config.ids, counts)))
        replies = await self.ask_all(register.address, register.size, "its bus watchdog")
        for axis in self.axes:
            found = register.decode(replies[axis.id].params)
            if found != counts:
                raise WireDown(
                    f"arm: the bus watchdog of {axis.label} is {found}, must be {counts}. "
                    "Power-cycle it and try again"
                )
        self._readings.watchdogs_are(counts)

    # -- what feeds the watchdogs is earned

    async def read(self) -> Observation:
        session = self.session
        now_ns = self.clock.now_ns()
        if self._feed_until_ns is not None and now_ns >= self._feed_until_ns:
            await trio.lowlevel.checkpoint()
            return session.observation
        if now_ns - session.bus.sent_ns >= watchdog.SECONDS * NS:
            self.check_torque_soon()  # they may have tripped in that silence
        seen = await super().read()
        if self._readings.unnamed:
            self.check_torque_soon()
        return seen

    async def write(self, values: tuple[float, ...], permit: Permit) -> None:
        await super().write(values, permit)
        self._feed_until_ns = self.clock.now_ns() + round(watchdog.FEED_S * NS)

    async def make_safe(self, safe_state: SafeState) -> tuple[MotorReport, ...]:
        reports = await super().make_safe(safe_state)
        driven = any(report.acknowledged and not report.safe and report.detail != LIMP for report in reports)
        self._feed_until_ns = self.clock.now_ns() if driven else None
        return reports


class DynamixelStopChannel(ServoStopChannel[protocol.Packet]):
    CODEC = protocol
    SAFING = DynamixelSafing
