"""Run an M3 Pro as a twin: rosbridge with its topics, a base with a watchdog in its firmware, and an arm."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from functools import cached_property
from typing import Annotated, Any, Unpack

from strands_actors.contract.options import option
from strands_actors.drivers.common.physics.body import TIMESTEP_S, Felt, Hand
from strands_actors.drivers.common.twin import (
    Fault,
    Faults,
    NetworkOptions,
    Start,
    TcpServer,
    WireLog,
    read_twin_options,
    run_server,
)
from strands_actors.drivers.common.twin.websocket import serving_websocket
from strands_actors.drivers.yahboom.messages import REST, Twist
from strands_actors.drivers.yahboom.robots import ARM_JOINTS, BASE, TABLES, table_of

from .bridge import BridgeSession, Graph, serving
from .mechanism import Mechanism


class M3ProTwinOptions(NetworkOptions, frozen=True):
    watchdog_s: Annotated[
        float | None,
        option("seconds without a command after which the base's firmware zeroes it; 0: never; None: the robot's"),
    ] = None
    joints: Annotated[bool, option("whether /joint_states is published, as the robot itself does not")] = True


class M3ProTwin:
    """One robot for all clients of its rosbridge."""

    def __init__(
        self,
        robot: str,
        now_s: Callable[[], float] = time.monotonic,
        *,
        watchdog_s: float | None = None,
        joints: bool = True,
    ) -> None:
        table = table_of(robot)
        servos = table.servos_by((1.0,) * ARM_JOINTS)
        self.mechanism = Mechanism(table, table.watchdog_s if watchdog_s is None else float(watchdog_s), now_s)
        self.faults = Faults()
        self.graph = Graph(table, self.mechanism, self.faults, servos, joints=joints)
        self.body = M3ProBody(self.mechanism, robot)

    def set_fault(self, fault: Fault, unit: int | None = None) -> None:
        """Set a fault. ``unit`` has no meaning here: the robot is the only sender."""
        self.mechanism.pass_time()
        self.graph.freeze_readings(fault is Fault.STUCK)
        self.mechanism.stuck = fault is Fault.STUCK
        self.faults.set(fault)
        if fault is Fault.OFF:
            self.mechanism.reset()

    def power_cycle(self) -> None:
        self.mechanism.reset()


class M3ProBody:
    """The robot in a simulation. Parts that the wire drives follow the wire."""

    def __init__(self, mechanism: Mechanism, robot: str) -> None:
        table = table_of(robot)
        self._mechanism = mechanism
        self._robot = robot
        self._servos = table.servos
        self.axes = (*BASE, *(servo.key for servo in table.servos))
        self.pass_time = mechanism.pass_time

    @cached_property
    def spec(self) -> Any:
        from strands_actors.drivers.common.physics.model_rows import build  # MuJoCo, for its looks only

        return build(TABLES.table(self._robot))

    @property
    def hands(self) -> Sequence[Hand]:
        mechanism = self._mechanism
        return (mechanism.base_hand,) * len(BASE) + (mechanism.arm_hand,) * len(self._servos)

    def felt(self) -> Felt:
        mechanism = self._mechanism
        still = (0.0,) * len(self.axes)
        return Felt(mechanism.time_s, (*mechanism.runs, *self._arm_rad()), still, still, self.hands)

    def pose(self) -> Sequence[float]:
        mechanism = self._mechanism
        return [mechanism.x_m, mechanism.y_m, mechanism.yaw_rad, *self._arm_rad()]

    def take(self, on: bool) -> None:
        mechanism, free, taken = self._mechanism, Hand.NONE, Hand.SIM
        if mechanism.base_hand is (free if on else taken):
            mechanism.drive(REST, taken if on else free)
        if mechanism.arm_hand is (free if on else taken):
            mechanism.hold_arm()
            mechanism.arm_hand = taken if on else free

    def aim(self, values: Sequence[float]) -> None:
        mechanism = self._mechanism
        if mechanism.base_hand is Hand.SIM:
            mechanism.drive(Twist(*values[: len(BASE)]), Hand.SIM)
        if mechanism.arm_hand is Hand.SIM:
            degrees = [servo.degrees(value) for servo, value in zip(self._servos, values[len(BASE) :], strict=True)]
            mechanism.aim_arm(degrees, 0.0, Hand.SIM)

    def hold(self) -> None:
        mechanism = self._mechanism
        if mechanism.base_hand is Hand.SIM:
            mechanism.drive(REST, Hand.SIM)
        if mechanism.arm_hand is Hand.SIM:
            mechanism.hold_arm()

    def step(self, steps: int) -> None:
        self._mechanism.run(steps * TIMESTEP_S)

    def reset(self) -> None:
        self._mechanism.reset()

    def _arm_rad(self) -> tuple[float, ...]:
        degrees = zip(self._servos, self._mechanism.degrees, strict=True)
        return tuple(servo.radians(value) for servo, value in degrees)


def main(robot: str, *, options: Mapping[str, Any] | None = None, **start: Unpack[Start]) -> None:
    """Serve a robot of ``robots.toml`` until interrupted (see ``common.twin.run``)."""
    given = read_twin_options(robot, M3ProTwinOptions, options)
    twin = M3ProTwin(robot, watchdog_s=given.watchdog_s, joints=given.joints)

    def build(wire_log: WireLog) -> TcpServer:
        serve = serving(twin.graph)
        return TcpServer(twin, {given.port: serving_websocket(lambda path: serve)}, wire_log, given.host)

    run_server(build, **start)


__all__ = ["BridgeSession", "Graph", "M3ProTwin", "Mechanism", "main"]
