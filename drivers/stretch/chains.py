"""The two chains of Dynamixel servos: wrist and head. They differ from an arm of such servos in four ways:
positions in radians, a slow bus, a gripper that is not commanded, and motion profiles that the servos need."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import ClassVar

import msgspec

from strands_actors.contract.safe_state import SafeState
from strands_actors.contract.wire import MotorReport, Observation, Permit
from strands_actors.drivers.common.dynamixel import protocol, table
from strands_actors.drivers.common.dynamixel.safing import DynamixelSafing
from strands_actors.drivers.common.dynamixel.watchdog import FEED_S, UNARMED
from strands_actors.drivers.common.dynamixel.wire import DynamixelStopChannel, DynamixelWire
from strands_actors.drivers.common.ports.half_duplex import HalfDuplexBus
from strands_actors.drivers.common.ports.serial_port import BytePort, open_serial
from strands_actors.drivers.common.servo.handshake import block
from strands_actors.drivers.common.servo.safing import LIMP
from strands_actors.drivers.common.servo.wire import Handshake
from strands_actors.kernel.clock import NS, Clock

from .config import StretchConfig, ticks_per_s, ticks_per_s2
from .parameters import Chain

HOMED = table.Register(661)
"""Indirect data 56, where the vendor's homing routine notes that the joint is homed."""

RESET = frozenset((LIMP, UNARMED))
"""Words in ``faults`` of a servo that has lost our settings: torque, or its bus watchdog. A servo that was
reset has lost its count of whole turns, too."""


class ChainSafing(DynamixelSafing):
    REPEATS: ClassVar[int] = 3
    REPEAT_S: ClassVar[float] = 0.01
    """After this pause three of the longest replies have ended (3 x (94 bytes + 0.5 ms) at 115 200 baud)."""


class ChainWire(DynamixelWire):
    SAFING = ChainSafing

    def __init__(
        self,
        config: StretchConfig,
        chain: Chain,
        clock: Clock,
        open_port: Callable[[str, int], BytePort] = open_serial,
    ) -> None:
        super().__init__(config.chain_config(chain), clock, open_port)
        self._joints = chain.joints
        self._is_profiled = False
        self.homed: dict[str, bool] = {}
        """By joint: True if the joint knows its position."""

    async def handshake(self, bus: HalfDuplexBus[protocol.Packet]) -> Handshake[protocol.Packet]:
        """Connect to the servos. A joint may rest anywhere in the range that the robot's YAML gives, even
        several turns of its servo away."""
        done = await super().handshake(bus)
        for axis, joint in zip(self.axes, self._joints, strict=True):
            data = await block(bus, protocol, axis, HOMED.address, HOMED.size) if joint.needs_homing else b"\1"
            self.homed[axis.key] = bool(HOMED.decode(data))
        return msgspec.structs.replace(done, reach={axis.id: (axis.low, axis.high) for axis in self.axes})

    async def write(self, values: tuple[float, ...], permit: Permit) -> None:
        """Write a setpoint. A hold removes the servos' speed limit, so the motion profile is sent before the
        first goal after a hold."""
        if self._armed and not self._is_profiled:
            permit.check()
            joints, bus = self._joints, self.session.bus
            changes = {joint.id: ticks_per_s2(joint.acceleration_rad_s2, joint.gear) for joint in joints}
            bus.send(protocol.sync_write(table.PROFILE_ACCELERATION, changes))
            speeds = {joint.id: ticks_per_s(joint.speed_rad_s, joint.gear) for joint in joints}
            bus.send(protocol.sync_write(table.PROFILE_VELOCITY, speeds))
            self._is_profiled = True
        await super().write(values, permit)

    def feed_watchdogs(self) -> None:
        """Keep the servos' watchdogs from expiring. A setpoint for the rest of the robot has shown that its
        sender is alive."""
        if self._feed_until_ns is not None:
            self._feed_until_ns = self.clock.now_ns() + round(FEED_S * NS)

    async def before_arming(self, permit: Permit) -> None:
        """Read from the servos whether the joints are homed. A servo that was reset has lost the count of its
        turns and is not homed."""
        await super().before_arming(permit)
        for axis, joint in zip(self.axes, self._joints, strict=True):
            if joint.needs_homing:
                reply = await self._of(axis, HOMED.address, HOMED.size, "whether it is homed")
                self.homed[axis.key] = bool(HOMED.decode(reply.params))

    async def arm(self, permit: Permit) -> Observation:
        self._is_profiled = False
        return await super().arm(permit)

    async def read(self) -> Observation:
        """Read the chain. If a servo seems to have been reset, its joint counts as not homed until the next
        arming reads it again."""
        observation = await super().read()
        for axis, joint in zip(self.axes, self._joints, strict=True):
            if joint.needs_homing and not RESET.isdisjoint(observation.faults.get(axis.key, "").split(", ")):
                self.homed[axis.key] = False
        return observation

    async def make_safe(self, safe_state: SafeState) -> tuple[MotorReport, ...]:
        """Hold the joints for every safe state, because a wrist without torque would drop its load."""
        self._is_profiled = False
        return at_rest(await super().make_safe(SafeState.HOLD))

    @property
    def observation(self) -> Observation:
        return self.session.observation


class ChainStopChannel(DynamixelStopChannel):
    SAFING = ChainSafing

    def __init__(
        self,
        config: StretchConfig,
        chain: Chain,
        descriptors: Sequence[int],
        clock: Clock,
        open_port: Callable[[str, int], BytePort] = open_serial,
    ) -> None:
        super().__init__(config.chain_config(chain), descriptors, clock, open_port)

    async def make_safe(self, safe_state: SafeState) -> tuple[MotorReport, ...]:
        return at_rest(await super().make_safe(SafeState.HOLD))


def at_rest(reports: Sequence[MotorReport]) -> tuple[MotorReport, ...]:
    """Return the servos' reports on a hold. A servo without torque is reported as safe, too, because it does not
    drive its joint."""
    return tuple(
        msgspec.structs.replace(report, safe=True) if report.detail == LIMP else report for report in reports
    )
