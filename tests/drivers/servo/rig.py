"""A wire of servos on its twin's servos, in memory and virtual time, for the tests of all such wires."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from typing import Any, TypeVar

import mujoco
import pytest
import trio

from strands_actors.contract.wire import MotorReport, Observation, WireDown
from strands_actors.drivers.common.dynamixel import protocol as dynamixel
from strands_actors.drivers.common.dynamixel import table
from strands_actors.drivers.common.dynamixel.wire import DynamixelWire
from strands_actors.drivers.common.servo.driver import ServoDriver
from strands_actors.drivers.common.servo.wire import ServoWire
from strands_actors.drivers.common.twin.servo_bus import ServoBus
from strands_actors.drivers.dynamixel.driver import Dynamixel
from strands_actors.drivers.dynamixel.twin import DynamixelBus
from strands_actors.drivers.feetech import protocol as feetech
from strands_actors.drivers.feetech.driver import Feetech
from strands_actors.drivers.feetech.twin import FeetechBus
from strands_actors.drivers.feetech.wire import FeetechWire
from strands_actors.kernel.clock import VirtualClock
from tests.drivers.common.memory_port import MemoryPort, Permission, servos

JOINTS = ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll", "gripper")
VICTIM = 3  # elbow_flex
MOVED = (20.0, -10.0, 15.0, 10.0, -20.0, 40.0)

RigT = TypeVar("RigT", bound="Rig")


class Rig:
    """A wire on its servos. ``protocol`` is the wire's own module of that name."""

    def __init__(
        self,
        bus: ServoBus[Any, Any],
        driver: ServoDriver,
        wire_class: Callable[..., ServoWire[Any]],
        protocol: Any,
        torque: Any,
    ) -> None:
        self.bus = bus
        self.port = MemoryPort(servos(bus))
        self.driver = driver
        self.clock = VirtualClock()
        self.wire = wire_class(driver.config, self.clock, lambda path, baud: self.port)
        self.protocol = protocol
        self._torque = torque

    async def armed(self: RigT) -> RigT:
        await self.wire.open()
        await self.wire.arm(Permission())
        self.port.written.clear()
        return self

    def servo(self, motor: int = VICTIM) -> Any:
        return next(servo for servo in self.bus.servos if servo.id == motor)

    def filter(self, passes: Callable[[Any], bool]) -> None:
        """Drop requests that do not pass on the way to the servos."""
        inner, decoder = self.port.peer, self.protocol.Decoder()

        def peer(data: bytes) -> Iterable[tuple[float, bytes]]:
            for packet in decoder.feed(data):
                if passes(packet):
                    yield from inner(self.protocol.frame(*packet))

        self.port.peer = peer

    def requests(self, *kinds: str) -> list[Any]:
        """Return the written packets of the given kinds, in order."""
        packets = self.protocol.Decoder().feed(b"".join(data for _, data in self.port.written))
        return [packet for packet in packets if not kinds or self.protocol.classify(packet) in kinds]

    def all_of(self, register: Any) -> list[int]:
        self.bus.pass_time()
        return [servo.get(register) for servo in self.bus.servos]

    def torque(self) -> list[int]:
        return self.all_of(self._torque)

    async def cycles(self, count: int, write: bool = False) -> Observation:
        """Run cycles as the tree does at 30 Hz."""
        for _ in range(count):
            if write:
                await self.wire.write(MOVED, Permission())
            seen = await self.wire.read()
            await trio.sleep(1 / 30)
        return seen


class FeetechRig(Rig):
    def __init__(self, robot: str = "so101", goal_energises: bool = True, **options: Any) -> None:
        bus = FeetechBus.for_robot(robot, trio.current_time, goal_energises)
        driver = Feetech(robot, "memory", Feetech.resolve(robot, options))
        super().__init__(bus, driver, FeetechWire, feetech, feetech.TORQUE_ENABLE)


class DynamixelRig(Rig):
    def __init__(self, **options: Any) -> None:
        bus = DynamixelBus.for_robot("koch", now_s=trio.current_time)
        driver = Dynamixel("koch", "memory", Dynamixel.resolve("koch", options))
        super().__init__(bus, driver, DynamixelWire, dynamixel, table.TORQUE_ENABLE)


async def refused(rig: Rig) -> str:
    """Return why the wire does not open."""
    with pytest.raises(WireDown) as down:
        await rig.wire.open()
    assert rig.port.closed, "a wire that did not open keeps no port"
    assert rig.torque() == [0] * 6
    return str(down.value)


async def read_until(wire: ServoWire[Any], true: Callable[[Observation], bool]) -> Observation:
    """Read until the condition holds. Return that observation."""
    with trio.fail_after(20):
        while True:
            seen = await wire.read()
            if true(seen):
                return seen
            await trio.sleep(0.01)


def verdicts(reports: Iterable[MotorReport]) -> dict[str, bool]:
    return {report.axis: report.safe for report in reports}


MakeRig = Callable[..., Rig]


async def raised(make: MakeRig, pose: Sequence[float], **options: Any) -> Rig:
    """Return an armed arm that a setpoint holds in a pose (radians), and that is lowered by a stop.

    The arm is put into the pose, since it would fall while it is connected.
    """
    rig = make(**{"on_exit": "lower", **options})

    def put() -> None:
        rig.bus.pass_time()
        plant = rig.bus.plant
        plant.data.qpos[plant._qpos], plant.data.qvel[:] = pose, 0.0
        mujoco.mj_forward(plant.model, plant.data)

    put()
    await rig.wire.open()
    put()
    await rig.wire.arm(Permission())
    put()
    values = tuple(
        axis.value(round(2048 + rad * 4096 / math.tau)) for axis, rad in zip(rig.driver.joints, pose, strict=True)
    )
    for _ in range(50):
        await rig.wire.write(values, Permission())
        await rig.wire.read()
        await trio.sleep(0.02)
    rig.bus.plant.take_touches()
    rig.port.written.clear()
    return rig
