"""The axes of a robot that walks by its onboard controller."""

from __future__ import annotations

from strands_actors.contract.axis import Axis, AxisMode, Part, PartKind
from strands_actors.drivers.unitree.robots import Walks

BASE = ("vx", "vy", "wz")


def base_of(walks: Walks) -> Part:
    """Return its velocities: forward, to the left, turning to the left."""
    ranges = zip(BASE, ("m/s", "m/s", "rad/s"), (walks.vx_m_s, walks.vy_m_s, walks.wz_rad_s), strict=True)
    return Part(
        PartKind.BASE,
        tuple(
            Axis(key=key, unit=unit, low=low, high=high, mode=AxisMode.VELOCITY, id=number)
            for number, (key, unit, (low, high)) in enumerate(ranges, 1)
        ),
    )
