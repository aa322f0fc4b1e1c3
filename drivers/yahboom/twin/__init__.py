"""Simulate an M3 Pro: rosbridge with its topics, a base with a watchdog in its firmware, and an
arm."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Annotated

from strands_actors.contract.options import option
from strands_actors.drivers.common.physics.body import Commander, Felt
from strands_actors.drivers.common.physics.stepped import DrawnBody
from strands_actors.drivers.common.twin import (
    Fault,
    NetworkOptions,
    TcpServer,
    TwinRobot,
    WireLog,
    main_of,
)
from strands_actors.drivers.common.twin.websocket import serving_websocket
from strands_actors.drivers.yahboom.messages import REST, Twist
from strands_actors.drivers.yahboom.robots import ARM_JOINTS, BASE, TABLES, table_of

from .bridge import OPERATIONS, SERVICES, TOPICS, BridgeSession, Graph, serving
from .mechanism import Mechanism

MODELLED = (OPERATIONS, TOPICS, SERVICES)


class M3ProTwinOptions(NetworkOptions, frozen=True):
    watchdog_s: Annotated[
        float | None,
        option("seconds without a command after which the base's firmware zeroes it; 0: never; None: the robot's"),
    ] = None
    joints: Annotated[bool, option("whether /joint_states is published, which the robot itself does not")] = False


class M3ProTwin(TwinRobot):
    """One simulated robot, which all clients of its rosbridge share."""

    def __init__(
        self,
        robot: str,
        now_s: Callable[[], float] = time.monotonic,
        *,
        watchdog_s: float | None = None,
        joints: bool = False,
    ) -> None:
        super().__init__()
        table = table_of(robot)
        servos = table.servos_by((1.0,) * ARM_JOINTS)
        self.mechanism = Mechanism(table, table.watchdog_s if watchdog_s is None else float(watchdog_s), now_s)
        self.graph = Graph(table, self.mechanism, self.faults, servos, joints=joints)
        self.body = M3ProBody(self.mechanism, robot)

    def begin_fault(self, fault: Fault) -> None:
        self.mechanism.pass_time()
        self.graph.freeze_readings(fault is Fault.STUCK)
        self.mechanism.stuck = fault is Fault.STUCK

    def power_cycle(self) -> None:
        self.mechanism.reset()


class M3ProBody(DrawnBody):
    """Let a simulation (another program on this computer) move the simulated robot. Parts that a
    client commands follow the client."""

    def __init__(self, mechanism: Mechanism, robot: str) -> None:
        super().__init__(TABLES.table(robot), mechanism)
        self._mechanism = mechanism
        self._servos = table_of(robot).servos
        self.axes = (*BASE, *(servo.key for servo in self._servos))

    @property
    def commanders(self) -> Sequence[Commander]:
        mechanism = self._mechanism
        return (mechanism.commander,) * len(BASE) + (mechanism.arm_commander,) * len(self._servos)

    def felt(self) -> Felt:
        return self._felt((*self._mechanism.runs, *self._arm_rad()))

    def pose(self) -> Sequence[float]:
        mechanism = self._mechanism
        return [mechanism.x_m, mechanism.y_m, mechanism.yaw_rad, *self._arm_rad()]

    def energise(self, on: bool) -> None:
        mechanism, free, driven = self._mechanism, Commander.NONE, Commander.SIM
        if mechanism.commander is (free if on else driven):
            mechanism.drive(REST, driven if on else free)
        if mechanism.arm_commander is (free if on else driven):
            mechanism.hold_arm()
            mechanism.arm_commander = driven if on else free

    def set_targets(self, values: Sequence[float]) -> None:
        mechanism = self._mechanism
        if mechanism.commander is Commander.SIM:
            mechanism.drive(Twist(*values[: len(BASE)]), Commander.SIM)
        if mechanism.arm_commander is Commander.SIM:
            degrees = [servo.degrees(value) for servo, value in zip(self._servos, values[len(BASE) :], strict=True)]
            mechanism.aim_arm(degrees, 0.0, Commander.SIM)

    def hold(self) -> None:
        mechanism = self._mechanism
        if mechanism.commander is Commander.SIM:
            mechanism.drive(REST, Commander.SIM)
        if mechanism.arm_commander is Commander.SIM:
            mechanism.hold_arm()

    def reset(self) -> None:
        self._mechanism.reset()

    def _arm_rad(self) -> tuple[float, ...]:
        degrees = zip(self._servos, self._mechanism.degrees, strict=True)
        return tuple(servo.radians(value) for servo, value in degrees)


def build(robot: str, options: M3ProTwinOptions, log: WireLog) -> TcpServer:
    """Return the server of a robot of ``robots.toml``."""
    twin = M3ProTwin(robot, watchdog_s=options.watchdog_s, joints=options.joints)
    serve = serving(twin.graph)
    return TcpServer(twin, {options.port: serving_websocket(lambda path: serve)}, log, options.host)


main = main_of(M3ProTwinOptions, build)

__all__ = ["MODELLED", "BridgeSession", "Graph", "M3ProTwin", "Mechanism", "build", "main"]
