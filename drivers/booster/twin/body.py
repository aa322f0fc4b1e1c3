"""The twin's body, from the robot's table."""

from __future__ import annotations

import math

from strands_actors.drivers.booster.robots import TABLES, Model
from strands_actors.drivers.common.legged_body import LeggedBody
from strands_actors.drivers.common.model_rows import with_limits


class T1Body(LeggedBody):
    """A legged body that is carried along where it is told to walk: its legs only stand."""

    def carry(self, vx_m_s: float, vy_m_s: float, vyaw_rad_s: float, seconds: float) -> None:
        """Shift and turn it whole, in its own frame, about the vertical."""
        qpos = self.data.qpos
        w, x, y, z = (float(value) for value in qpos[3:7])
        heading = math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
        cos, sin = math.cos(heading), math.sin(heading)
        qpos[0] += (cos * vx_m_s - sin * vy_m_s) * seconds
        qpos[1] += (sin * vx_m_s + cos * vy_m_s) * seconds
        half = vyaw_rad_s * seconds / 2.0
        c, s = math.cos(half), math.sin(half)
        qpos[3:7] = (c * w - s * z, c * x - s * y, c * y + s * x, c * z + s * w)


def body_of(model: Model) -> T1Body:
    """Limits and torque come from the motors, the rest from ``links``."""
    table = TABLES.table(model.name)
    motors = {motor.key: motor for motor in model.motors}

    def limits_of(key: str) -> str:
        motor = motors[key]
        return f"{motor.low},{motor.high} {motor.torque} {motor.speed}"

    rows = with_limits(table["links"], limits_of)
    return T1Body({**table, "model_rows": rows}, [motor.key for motor in model.motors])
