"""The arms of this wire, as data: a row of ``robots.toml``, its joints, and the twin's model made of it."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Mapping
from functools import cache
from importlib import resources
from typing import Any

import msgspec

JOINTS = (
    "shoulder_pan_joint",
    "shoulder_lift_joint",
    "elbow_joint",
    "wrist_1_joint",
    "wrist_2_joint",
    "wrist_3_joint",
)
"""In the order of the wire."""

DH_ALPHA_RAD = (math.pi / 2, 0.0, 0.0, math.pi / 2, -math.pi / 2, 0.0)


class Arm(msgspec.Struct, frozen=True):
    """One row."""

    dh_m: tuple[float, float, float, float, float, float]
    range_deg: tuple[float, ...]
    speed_deg_s: tuple[float, ...]
    effort_nm: tuple[float, ...]
    link_kg: tuple[float, ...]
    radius_m: float

    @property
    def reach_rad(self) -> tuple[float, ...]:
        """How far each joint turns to either side."""
        return tuple(math.radians(degrees) for degrees in self.range_deg)

    @property
    def speed_rad_s(self) -> tuple[float, ...]:
        return tuple(math.radians(degrees) for degrees in self.speed_deg_s)


@cache
def arms() -> Mapping[str, Arm]:
    """The rows of ``robots.toml`` by robot name."""
    tables = tomllib.loads(resources.files(__package__).joinpath("robots.toml").read_text("utf-8"))
    return {name: msgspec.convert(table, Arm) for name, table in tables.items()}


def arm_of(robot: str) -> Arm:
    """Raise ``ValueError`` for a robot that is not of this wire."""
    if robot not in arms():
        raise ValueError(f"{robot} is not a UR arm. Use one of {', '.join(arms())}")
    return arms()[robot]


HOME_RAD = (0.0, -math.pi / 2, math.pi / 2, -math.pi / 2, -math.pi / 2, 0.0)
"""Where a twin wakes up: upright, the elbow bent."""


def model_table(arm: Arm) -> dict[str, Any]:
    """The arm as ``drivers/common/model_rows`` takes it: the wrist_3 body is the flange of the DH chain.
    Centres of mass: after the vendor's description, rounded."""
    d1, a2, a3, d4, d5, d6 = arm.dh_m
    bodies = ("shoulder", "upper_arm", "forearm", "wrist_1", "wrist_2", "wrist_3")
    places = ((0, 0, d1), (0, 0, 0), (a2, 0, 0), (a3, 0, d4), (0, -d5, 0), (0, d6, 0))
    turns = ("0", "90,0,0", "0", "0", "90,0,0", "90,180,180")
    centres = (
        (0, -0.0019, -0.0256),
        (a2 / 2, 0, 0.85 * d4),
        (0.6 * a3, 0, 0.2 * d4),
        (0, -0.016, -0.002),
        (0, 0.016, -0.002),
        (0, 0, -0.02),
    )
    radius = arm.radius_m
    shapes = (
        f"s{radius}",
        f"c{radius}@{a2},0,{0.85 * d4}",
        f"c{0.8 * radius}@{a3},0,{0.2 * d4}",
        f"s{0.8 * radius}",
        f"s{0.8 * radius}",
        f"y{0.7 * radius},0.02",
    )
    rows = [
        " ".join(
            (
                body,
                bodies[at - 1] if at else "base",
                JOINTS[at],
                "z",
                _triple(places[at]),
                turns[at],
                f"{-arm.reach_rad[at]},{arm.reach_rad[at]}",
                str(arm.effort_nm[at]),
                str(arm.speed_rad_s[at]),
                str(arm.link_kg[at]),
                _triple(centres[at]),
                shapes[at],
            )
        )
        for at, body in enumerate(bodies)
    ]
    return {
        "joints": [{"key": joint} for joint in JOINTS],
        "model_rows": "\n".join(rows),
        "home_rad": HOME_RAD,
        "gravity_compensated": True,  # the controller knows its arm, and brakes hold it without power
        "armature": 0.1 * arm.effort_nm[0] / 150,  # [assumed]
        "bandwidth": 40.0,
    }


def _triple(numbers: tuple[float, ...]) -> str:
    return ",".join(str(number) for number in numbers)
