"""Load the Crazyflies that this driver supports from ``robots.toml``."""

from __future__ import annotations

from strands_actors.contract.axis import Axis, AxisMode, Part, PartKind
from strands_actors.drivers.common.kit.robot_tables import RobotTables

TABLES = RobotTables(__package__, "Crazyflie")

AXES = ("vx", "vy", "vz", "wz", "z")
VX, VY, VZ, WZ, Z = range(5)


def part_of(robot: str) -> Part:
    """Return the axes of a robot. Raise ``ValueError`` if this driver does not support the robot."""
    table = TABLES.table(robot)
    limits = [float(table[name]) for name in ("vx_m_s", "vy_m_s", "vz_m_s", "wz_rad_s")]
    units = ("m/s", "m/s", "m/s", "rad/s")
    moving = [
        Axis(key=key, unit=unit, low=-limit, high=limit, mode=AxisMode.VELOCITY, id=number)
        for number, (key, unit, limit) in enumerate(zip(AXES[:Z], units, limits, strict=True), 1)
    ]
    low, high = table["z_m"]
    return Part(PartKind.DRONE, (*moving, Axis(key=AXES[Z], unit="m", low=low, high=high, id=5)))
