"""Read the supported Unitree robots and their joints from ``robots.toml``."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from typing import Any, Literal

import msgspec

from strands_actors.contract.axis import Axis
from strands_actors.drivers.common.kit.motor_targets import Joint, parse_joints
from strands_actors.drivers.common.kit.robot_tables import RobotTables

TABLES = RobotTables(__package__, "Unitree")


class Walks(msgspec.Struct, frozen=True):
    """How the onboard controller of a robot can walk: its service, and the limits of its speeds."""

    by: Literal["sport", "loco"]  # The robot's service for walking: ``walking/sport.py`` or ``walking/loco.py``.
    vx_m_s: tuple[float, float]  # Lowest (backward) and highest (forward) speed in m/s.
    vy_m_s: tuple[float, float]
    wz_rad_s: tuple[float, float]
    sits: bool = False
    lie_rad: tuple[float, ...] = ()  # Joint positions of the simulated robot while it lies or squats, in rad.


class Model(msgspec.Struct, frozen=True):
    """One robot type: its family of frames, its services, and the limits of its joints."""

    name: str
    family: Literal["hg", "go"]
    handshake: Literal["fsm", "sport mode"]
    service: str  # Name of the service that receives requests to walk.
    sport_mode: str  # Name of the onboard mode in which the simulated robot starts.
    max_kp: float
    max_kd: float
    damp_kd: float
    joints: tuple[Joint, ...]
    walks: Walks | None = None  # None if this package cannot make the robot walk.

    @property
    def axes(self) -> tuple[str, ...]:
        return tuple(joint.key for joint in self.joints)

    @property
    def table(self) -> tuple[Axis, ...]:
        return tuple(joint.axis for joint in self.joints)

    @property
    def slots(self) -> tuple[int, ...]:
        return tuple(joint.slot for joint in self.joints)


@cache
def model_of(robot: str) -> Model:
    """Return a robot by name or alias.

    Raises:
        ValueError: No supported Unitree robot has this name.
    """
    table: Mapping[str, Any] = TABLES.table(robot)
    joints = parse_joints(table["joints"])
    fields = {name: table[name] for name in Model.__struct_fields__ if name in table and name != "joints"}
    if "walks" in table:
        fields["walks"] = msgspec.convert(table["walks"], Walks)
    return Model(**{"sport_mode": "ai", **fields, "name": TABLES.canonical(robot), "joints": joints})
