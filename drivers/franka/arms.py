"""Read the supported Franka arms from ``robots.toml``, and build the model of the simulated arm from them."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Mapping
from functools import cache
from importlib import resources
from typing import Any

import msgspec

from .looks import looks_of

JOINTS = 7

HOME_RAD = (0.0, -math.pi / 4, 0.0, -3 * math.pi / 4, 0.0, math.pi / 2, math.pi / 4)
"""Joint positions in rad at which the simulated arm starts: the vendor's start pose."""

LINKS = (
    ((0.0, 0.0, 0.333), 0.0),
    ((0.0, 0.0, 0.0), -90.0),
    ((0.0, -0.316, 0.0), 90.0),
    ((0.0825, 0.0, 0.0), 90.0),
    ((-0.0825, 0.384, 0.0), -90.0),
    ((0.0, 0.0, 0.0), 90.0),
    ((0.088, 0.0, 0.0), 90.0),
)
"""Origin of each link in the previous one (m), and its roll (degrees). They are the same for all arms."""
FLANGE_M = 0.107
"""Distance of the flange from the seventh joint, along its axis."""

_SHAPES = (
    "c.06@0,0,-.14",
    "c.06@0,-.2,0",
    "c.06@.0825,0,0",
    "c.055@-.0825,.2,0",
    "c.05@0,.03,-.2",
    "c.05@.088,0,0",
    "y.045,.05@0,0,.055",
)
"""Shapes of the links, for pictures of the simulated arm [assumed]."""


class Arm(msgspec.Struct, frozen=True):
    """One Franka arm: its table in ``robots.toml``, with the FCI version and the limits of each joint."""

    fci: int
    joints: str
    low: tuple[float, ...]
    high: tuple[float, ...]
    speed: tuple[float, ...]
    acceleration: tuple[float, ...]
    jerk: tuple[float, ...]
    effort: tuple[float, ...]
    link_kg: tuple[float, ...]
    com: tuple[tuple[float, float, float], ...]
    ends: tuple[tuple[float, float, float, float], ...] = ()

    @property
    def keys(self) -> tuple[str, ...]:
        return tuple(f"{self.joints}{number}" for number in range(1, JOINTS + 1))

    def speed_at(self, joint: int, rad: float) -> tuple[float, float]:
        """Return the lowest and the highest speed (rad/s) that the controller allows a joint at this position."""
        most = self.speed[joint]
        if not self.ends:
            return -most, most
        offset, slope, lower, upper = self.ends[joint]
        up = -offset + math.sqrt(max(0.0, slope * (upper - rad)))
        down = -offset + math.sqrt(max(0.0, slope * (rad - lower)))
        return -min(most, max(0.0, down)), min(most, max(0.0, up))


@cache
def arms() -> Mapping[str, Arm]:
    """Return all Franka arms, by robot name."""
    tables = tomllib.loads(resources.files(__package__).joinpath("robots.toml").read_text("utf-8"))
    return {name: msgspec.convert(table, Arm) for name, table in tables.items()}


def arm_of(robot: str) -> Arm:
    """Return the arm with this robot name. Raise ``ValueError`` if no Franka arm has this name."""
    if robot not in arms():
        raise ValueError(f"{robot} is not a Franka arm. Use one of {', '.join(arms())}")
    return arms()[robot]


def model_table(arm: Arm) -> dict[str, Any]:
    """Return the arm as a table from which ``drivers/common/physics/model_rows`` builds the simulation model."""
    rows = [
        f"link{index + 1} {f'link{index}' if index else 'base'} {key} z {_csv(LINKS[index][0])} "
        f"{LINKS[index][1]},0,0 {arm.low[index]},{arm.high[index]} {arm.effort[index]} {arm.speed[index]} "
        f"{arm.link_kg[index]} {_csv(arm.com[index])} {_SHAPES[index]}"
        for index, key in enumerate(arm.keys)
    ]
    return {
        "joints": [{"key": key} for key in arm.keys],
        "base": {"geom": "y.07,.08@-.03,0,.08", "kg": 3.0},
        "model_rows": "\n".join(rows),
        "looks": looks_of(arm.fci),
        "home_rad": HOME_RAD,
        "gravity_compensated": True,  # A real controller compensates gravity from its own model of the arm.
        "armature": 0.2,  # The real value is not published: [assumed].
        "bandwidth": 60.0,  # The real value is not published: [assumed].
    }


def _csv(numbers: tuple[float, ...]) -> str:
    return ",".join(str(number) for number in numbers)
