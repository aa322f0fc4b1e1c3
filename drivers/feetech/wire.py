"""Drive the Feetech bus from the wire process, and stop the servos by the root's stop channel."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import ClassVar

from strands_actors.contract.wire import Permit
from strands_actors.drivers.common.ports.half_duplex import HalfDuplexBus
from strands_actors.drivers.common.servo.axes import Axis
from strands_actors.drivers.common.servo.identity import limits_of
from strands_actors.drivers.common.servo.readings import Readings, Sample
from strands_actors.drivers.common.servo.stop_channel import ServoStopChannel
from strands_actors.drivers.common.servo.wire import Handshake, ServoWire

from . import protocol
from .identify import Identity, answer_at_once, check, facts, identify, lift_speed_limit
from .safing import FeetechSafing


class FeetechReadings(Readings[protocol.Packet]):
    """The newest values of the servos.

    Args:
        axes: The axes.
        limits: Constant rows that each observation also contains, in axis order.
        speed_units: Counts/s of one unit in a servo's registers of speeds, by id.
    """

    SENSORS = ("load_pct", "voltage_v", "temperature_c")

    def __init__(
        self, axes: Sequence[Axis], limits: Mapping[str, tuple[float, ...]], speed_units: Mapping[int, int]
    ) -> None:
        super().__init__(axes, limits)
        self._speed_units = speed_units

    def sample(self, axis: Axis, reply: protocol.Packet, base: int) -> Sample:
        block = reply.params
        torque: bool | None = None
        if base <= protocol.TORQUE_ENABLE.address:
            torque = bool(protocol.TORQUE_ENABLE.decode(block, base))
        return Sample(
            position=protocol.POSITION.decode(block, base),
            velocity=float(protocol.VELOCITY.decode(block, base) * self._speed_units[axis.id]),
            sensors=(
                protocol.LOAD.decode(block, base) / 10,
                protocol.VOLTAGE.decode(block, base) / 10,
                float(protocol.TEMPERATURE.decode(block, base)),
            ),
            words=protocol.error_words(reply.code),
            energised=torque,
        )


class FeetechWire(ServoWire[protocol.Packet]):
    CODEC = protocol
    SAFING = FeetechSafing
    FEEDBACK: ClassVar[tuple[int, int]] = (protocol.TORQUE_ENABLE.address, 24)
    """First register and number of registers of every reading: torque to temperature, 40 to 63. The torque is read
    before each write, because a goal would switch on a servo that has lost its torque."""
    FEEDBACK_AND_TORQUE: ClassVar[tuple[int, int]] = FEEDBACK
    _limited: list[Axis]
    """Axes with a speed limit that another program has set."""

    async def handshake(self, bus: HalfDuplexBus[protocol.Packet]) -> Handshake[protocol.Packet]:
        servos: dict[int, Identity] = {}
        calibration = self.config.calibration
        for axis in self.axes:
            servo = await identify(bus, axis)
            check(axis, servo, calibration[axis.key] if calibration else None)
            servos[axis.id] = servo
        for axis in self.axes:
            await answer_at_once(bus, axis, servos[axis.id])
        self._limited = [axis for axis in self.axes if servos[axis.id].speed_limit]
        limits = limits_of(self.axes, [servos[axis.id] for axis in self.axes])
        travel = {motor: servo.travel for motor, servo in servos.items()}
        return Handshake(
            FeetechReadings(self.axes, limits, {motor: servo.speed_unit for motor, servo in servos.items()}),
            travel,
            travel,
            facts(self.axes, servos),
            full_torque={motor: servo.max_torque for motor, servo in servos.items()},
            limits_torque=any(servo.torque_limit < servo.max_torque for servo in servos.values()),
        )

    async def before_arming(self, permit: Permit) -> None:
        """Clear speed limits that another program has set. This is not done when connecting: if a servo moves
        slowly under a limit at that time, it would suddenly move at full speed."""
        while self._limited:
            permit.check()
            await lift_speed_limit(self.session.bus, self._limited[-1])
            self._limited.pop()

    async def after_arming(self, permit: Permit) -> None:
        """Read the faults again. Torque on clears the error of a servo that had switched itself off, and with the
        earlier reading the first setpoint would be refused for it. The positions stay those that became the
        goals."""
        replies = await self.ask_all(*self.FEEDBACK, "whether it has a fault")
        self.session.readings.store_faults(replies, self.FEEDBACK[0])


class FeetechStopChannel(ServoStopChannel[protocol.Packet]):
    CODEC = protocol
    SAFING = FeetechSafing
