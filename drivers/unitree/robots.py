"""The robots of this wire, as data: a table of ``robots.toml`` and its joints."""

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
    """How a robot walks by its onboard controller."""

    by: Literal["sport", "loco"]  # the service that it walks by: ``walking/sport.py``, ``walking/loco.py``
    vx_m_s: tuple[float, float]  # backward, forward
    vy_m_s: tuple[float, float]
    wz_rad_s: tuple[float, float]
    sits: bool = False
    lie_rad: tuple[float, ...] = ()  # pose of the twin when it lies or squats, in the order of its joints


class Model(msgspec.Struct, frozen=True):
    """One robot: the frames and services that it speaks, and its limits."""

    name: str
    family: Literal["hg", "go"]
    handshake: Literal["fsm", "sport mode"]
    service: str  # the service of its high-level requests
    sport_mode: str  # the onboard mode that the twin starts in
    max_kp: float
    max_kd: float
    damp_kd: float
    joints: tuple[Joint, ...]
    walks: Walks | None = None  # None: this package does not know its requests for walking

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
        ValueError: It is not a robot of this wire.
    """
    table: Mapping[str, Any] = TABLES.table(robot)
    joints = parse_joints(table["joints"])
    fields = {name: table[name] for name in Model.__struct_fields__ if name in table and name != "joints"}
    if "walks" in table:
        fields["walks"] = msgspec.convert(table["walks"], Walks)
    return Model(**{"sport_mode": "ai", **fields, "name": TABLES.canonical(robot), "joints": joints})
