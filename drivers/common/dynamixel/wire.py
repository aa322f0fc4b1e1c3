"""The Dynamixel bus in the process that talks to the robot, and the supervising process's own path to stop it."""

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
        # Time at which reading ends, so that the bus watchdogs can stop the servos. None: the arm is limp or holds,
        # and may be read without limit.
        self._feed_until_ns: int | None = None

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
            full_torque={motor: servo.pwm_limit for motor, servo in servos.items()},
            limits_torque=any(servo.goal_pwm < servo.pwm_limit for servo in servos.values()),
        )

    # -- arming

    async def before_arming(self, permit: Permit) -> None:
        """Refuse to energise a servo that has stored a hardware error, and switch off every bus watchdog (which
        stops a servo when its bus is silent).

        If the watchdog has stopped a servo, the servo's torque is switched off first, because its old goal might
        become active again. Raise ``WireDown`` if a servo is refused or does not answer.
        """
        bus = self.session.bus
        replies = await self.ask_all(*_STATE, "its state")
        for axis in self.axes:
            state = replies[axis.id].params
            if alert := table.HARDWARE_ERROR.decode(state, _STATE[0]):
                raise WireDown(
                    f"arming: {axis.label} has stored a hardware error ({table.error_words(alert)}). "
                    "Clear its cause, support the arm, then reboot the servo"
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
        """Write ``counts`` to the bus watchdog register of every servo (0 switches the watchdog off), and read it
        back. Raise ``WireDown`` if a servo has another value."""
        register = table.BUS_WATCHDOG
        self.session.bus.send(protocol.sync_write(register, dict.fromkeys(self.config.ids, counts)))
        replies = await self.ask_all(register.address, register.size, "its bus watchdog")
        for axis in self.axes:
            value = register.decode(replies[axis.id].params)
            if value != counts:
                raise WireDown(
                    f"arming: the bus watchdog register (98) of {axis.label} is {value}, must be {counts}. "
                    "Power-cycle the servo and try again"
                )
        self._readings.watchdogs_are(counts)

    # -- reading, which restarts the servos' bus watchdogs

    async def read(self) -> Observation:
        session = self.session
        now_ns = self.clock.now_ns()
        if self._feed_until_ns is not None and now_ns >= self._feed_until_ns:
            await trio.lowlevel.checkpoint()
            return session.observation
        if now_ns - session.bus.sent_ns >= watchdog.SECONDS * NS:
            # The bus watchdogs may have stopped the servos during this silence.
            self.check_torque_soon()
        observation = await super().read()
        if self._readings.unnamed:
            self.check_torque_soon()
        return observation

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
