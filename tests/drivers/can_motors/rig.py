"""The wire of an arm of CAN motors on its twin's motors, in memory and virtual time."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import trio

from strands_actors.drivers.can_motors.adapters import ADAPTERS, Slcan
from strands_actors.drivers.can_motors.driver import CanMotors
from strands_actors.drivers.can_motors.protocol import Frame, State
from strands_actors.drivers.can_motors.robots import arm_of, table_of
from strands_actors.drivers.can_motors.stop_channel import CanStopChannel
from strands_actors.drivers.can_motors.twin import BusSession, CanRobot
from strands_actors.drivers.can_motors.wire import CanWire
from strands_actors.drivers.common.kit.motor_targets import KD, KP
from strands_actors.kernel.clock import VirtualClock
from tests.drivers.common.memory_port import MemoryPort, Permission

ROBSTRIDE = {
    "joints": [
        {
            "key": f"joint{number}",
            "motor": "rs02",
            "id": number,
            "sign": -1,
            "offset": 0.5,
            "low": -1.0,
            "high": 1.0,
            "speed": 2.0,
            "torque": 10.0,
            "kp": 60.0,
            "kd": 3.0,
        }
        for number in (1, 2, 3)
    ]
}
"""An arm of RobStride motors that turn against their joints."""


class CanBusPort(MemoryPort):
    """One bus in memory. It notes the kind of each frame and the safe state of the arm."""

    def __init__(self, robot: CanRobot, bus: int, notes: list[tuple[float, str, str | None]]) -> None:
        self._session = BusSession(robot, bus)
        self._notes = notes
        super().__init__(self._answers)

    def _answers(self, data: bytes) -> Iterable[tuple[float, bytes]]:
        at_s = 0.0
        for exchange in self._session.receive(data, None):
            self._notes.append((trio.current_time(), exchange.kind, exchange.safe_state))
            for reply in exchange.replies:
                at_s += reply.delay_s
                yield at_s + reply.late_s, reply.data


class Rig:
    """A wire on the motors of its twin. ``notes`` has time, kind and safe state of each received frame."""

    def __init__(self, robot: str = "openarm", table: dict[str, Any] | None = None, **options: Any) -> None:
        # A slow stream, because each command of it costs a test 10 ms.
        chosen = {"control_frequency": 50.0, **options, **({} if table is None else {"table": table})}
        resolved = CanMotors.resolve(robot, chosen)
        arm = arm_of(robot, resolved["table"])
        names = ",".join(f"/dev/can{bus}" for bus in range(arm.buses))
        self.driver = CanMotors(robot, names, resolved)
        self.robot = CanRobot(arm, resolved["table"], trio.current_time)
        self.notes: list[tuple[float, str, str | None]] = []
        self.opened: list[CanBusPort] = []
        self.clock = VirtualClock()
        self.wire = CanWire(self.driver.config, self.clock, self.open_port)

    def open_port(self, path: str, baud: int) -> CanBusPort:
        port = CanBusPort(self.robot, self.driver.config.ports.index(path), self.notes)
        self.opened.append(port)
        return port

    def stop_channel(self) -> CanStopChannel:
        return CanStopChannel(self.driver.config, (), self.clock, self.open_port)

    async def armed(self) -> Rig:
        await self.wire.open()
        await self.wire.arm(Permission())
        self.forget()
        return self

    async def put(self, **joints: float) -> None:
        """Put the armed arm into a pose, and hold it there by setpoints for a moment."""
        plant = self.robot.plant
        self.robot.pass_time()
        plant.data.qpos[plant._qpos] = [joints.get(motor.key, 0.0) for motor in self.driver.arm.motors]
        plant.data.qvel[:] = 0.0
        await self.stream(0.1, **joints)
        self.forget()

    def forget(self) -> None:
        self.notes.clear()
        for port in self.opened:
            port.written.clear()

    def sent(self) -> list[Frame]:
        """Return the frames that the wire has sent since ``forget``, on all buses."""
        adapter = ADAPTERS["slcan"]()
        return [
            frame
            for port in self.opened
            for _, data in port.written
            for frame in (adapter.feed(data) if isinstance(adapter, Slcan) else ())
        ]

    def kinds(self) -> list[str]:
        return [kind for _, kind, _ in self.notes]

    def states(self) -> set[State]:
        self.robot.pass_time()
        return {motor.state for motor in self.robot.motors}

    def target(self, **joints: float) -> tuple[float, ...]:
        """Return a setpoint: these positions, and 0 for the other joints."""
        motors = self.driver.arm.motors
        nothing = (0.0,) * len(motors)
        rows = [tuple(joints.get(motor.key, 0.0) for motor in motors), nothing, nothing]
        rows += [tuple(motor.kp for motor in motors), tuple(motor.kd for motor in motors)]
        assert len(rows) == max(KP, KD) + 1
        return tuple(value for row in rows for value in row)

    async def stream(self, seconds: float, **joints: float) -> None:
        """Send a setpoint in each control period, as the transport does."""
        until = trio.current_time() + seconds
        while trio.current_time() < until:
            await self.wire.write(self.target(**joints), Permission())
            await self.wire.read()
            await trio.sleep(self.driver.config.control_s)

    async def rest(self, seconds: float) -> None:
        """Run cycles without setpoints, as the transport does."""
        until = trio.current_time() + seconds
        while trio.current_time() < until:
            await self.wire.feed()
            await self.wire.read()
            await trio.sleep(self.driver.config.control_s)


def openarm() -> dict[str, Any]:
    return table_of("openarm")
