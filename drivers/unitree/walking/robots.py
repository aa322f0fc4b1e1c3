"""Derive the velocity axes and the walking service of a robot from its table in ``robots.toml``."""

from __future__ import annotations

from strands_actors.contract.axis import Axis, AxisMode, Part, PartKind
from strands_actors.drivers.unitree.robots import Walks

from .dialect import Dialect
from .loco import G1, H1
from .sport import B2, GO2

BASE = ("vx", "vy", "wz")


def base_of(walks: Walks) -> Part:
    """Return the axes vx (forward), vy (to the left) and wz (turning to the left), with their limits."""
    ranges = zip(BASE, ("m/s", "m/s", "rad/s"), (walks.vx_m_s, walks.vy_m_s, walks.wz_rad_s), strict=True)
    return Part(
        PartKind.BASE,
        tuple(
            Axis(key=key, unit=unit, low=low, high=high, mode=AxisMode.VELOCITY, id=number)
            for number, (key, unit, (low, high)) in enumerate(ranges, 1)
        ),
    )


def dialect_of(walks: Walks) -> Dialect:
    """Return the requests and modes of the service by which a robot walks."""
    if walks.by == "sport":
        return GO2 if walks.sits else B2
    return G1 if walks.sits else H1
