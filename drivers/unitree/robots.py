"""The robots of this wire, as data: a table of ``robots.toml`` and its joints."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from typing import Any, Literal

import msgspec

from strands_actors.contract.axis import Axis
from strands_actors.drivers.common.robot_tables import RobotTables

TABLES = RobotTables(__package__, "Unitree")


class Joint(msgspec.Struct, frozen=True):
    """One motor. Radians, newton metres, seconds."""

    key: str
    slot: int
    mode: int  # what its slot says when it is to obey
    low: float
    high: float
    torque: float
    speed: float
    kp: float
    kd: float


class Model(msgspec.Struct, frozen=True):
    """One robot: what is said to it, and what it may be told."""

    name: str
    family: Literal["hg", "go"]
    handshake: Literal["fsm", "sport mode"]
    service: str  # whose RPCs drive it at high level
    sport_mode: str  # the onboard mode the twin wakes up in
    max_kp: float
    max_kd: float
    damp_kd: float
    joints: tuple[Joint, ...]

    @property
    def axes(self) -> tuple[str, ...]:
        return tuple(joint.key for joint in self.joints)

    @property
    def table(self) -> tuple[Axis, ...]:
        return tuple(
            Axis(key=joint.key, unit="rad", low=joint.low, high=joint.high, speed=joint.speed, id=joint.slot)
            for joint in self.joints
        )

    @property
    def slots(self) -> tuple[int, ...]:
        return tuple(joint.slot for joint in self.joints)


_COLUMNS = {"key": str, "slot": int, "mode": int}


def _joint(line: str) -> Joint:
    words = line.split()
    if len(words) != len(Joint.__struct_fields__):
        raise ValueError(f"a joint has {len(Joint.__struct_fields__)} columns, this has {len(words)}: {line}")
    columns = zip(Joint.__struct_fields__, words, strict=True)
    return msgspec.convert({name: _COLUMNS.get(name, float)(word) for name, word in columns}, Joint)


@cache
def model_of(robot: str) -> Model:
    """By name or alias. Raise ``ValueError`` for a robot that is not of this wire."""
    table: Mapping[str, Any] = TABLES.table(robot)
    joints = tuple(_joint(line) for line in table["joints"].splitlines() if line.strip())
    fields = {name: table[name] for name in Model.__struct_fields__ if name in table and name != "joints"}
    return Model(**{"sport_mode": "ai", **fields, "name": TABLES.canonical(robot), "joints": joints})
