"""The body of a simulated legged robot: a floating base whose legs have torque motors."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from .jointed import Jointed
from .lean_mujoco import mujoco
from .model_rows import build

TIPPED = math.cos(math.radians(60.0))
"""Cosine of the largest tilt at which a base still counts as standing."""

_TOUCHING_M = 0.001


class LeggedBody(Jointed):
    """A floating base with legs.

    Each motor gives ``tau + kp (q - position) + kd (dq - speed)``, up to the joint's maximum effort, as real motor
    controllers do. At the start the robot stands at ``home_rad`` with its lowest point on the floor, and the motors
    give no torque.

    Args:
        table: The robot's table in ``robots.toml``.
        joints: Names of the joints, in the order of the motors.
    """

    def __init__(self, table: Mapping[str, Any], joints: Sequence[str]) -> None:
        spec = build({**table, "torque_motors": True})
        base = spec.body("base")
        base.add_site(name="imu")
        for sensor_type in (mujoco.mjtSensor.mjSENS_ACCELEROMETER, mujoco.mjtSensor.mjSENS_GYRO):
            spec.add_sensor(type=sensor_type, objtype=mujoco.mjtObj.mjOBJ_SITE, objname="imu")
        super().__init__(spec, joints)
        self._fallen_m = float(table["fallen_m"])
        self._home = np.asarray(table["home_rad"], dtype=float)
        self._off = np.zeros(len(joints), dtype=bool)
        self.stand_up()

    def begin_anew(self) -> None:
        self.stand_up()

    def stand_up(self) -> None:
        """Set the robot back on its feet, as a person would lift it up."""
        data = self.data
        self._rewind()
        data.qpos[self._qpos] = self._home
        mujoco.mj_forward(self.model, data)
        data.qpos[2] -= self._lowest_m() + _TOUCHING_M
        mujoco.mj_forward(self.model, data)
        self.drive(*np.zeros((5, len(self._actuator))))

    def _lowest_m(self) -> float:
        """Return the height of the lowest point of the robot, in metres."""
        model, data = self.model, self.data
        lowest = math.inf
        for geom in range(model.ngeom):
            if model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_PLANE:
                continue
            down = data.geom_xmat[geom].reshape(3, 3)[2]
            size = model.geom_size[geom]
            match model.geom_type[geom]:
                case mujoco.mjtGeom.mjGEOM_BOX:
                    reach = float(np.abs(down) @ size)
                case mujoco.mjtGeom.mjGEOM_CAPSULE:
                    reach = float(size[0] + abs(down[2]) * size[1])
                case _:
                    reach = float(size[0])
            lowest = min(lowest, float(data.geom_xpos[geom, 2]) - reach)
        return lowest

    def drive(
        self,
        q: Sequence[float],
        dq: Sequence[float],
        tau: Sequence[float],
        kp: Sequence[float],
        kd: Sequence[float],
    ) -> None:
        """Set the target of every motor, in rad, rad/s, Nm, Nm/rad and Nm s/rad. It applies until the next call."""
        stiffness = np.where(self._off, 0.0, kp)
        damping = np.where(self._off, 0.0, kd)
        force = np.where(self._off, 0.0, np.asarray(tau) + stiffness * q + damping * dq)
        model = self.model
        model.actuator_gainprm[self._actuator, 0] = 1.0
        model.actuator_biasprm[self._actuator, 1] = -stiffness
        model.actuator_biasprm[self._actuator, 2] = -damping
        self.data.ctrl[self._actuator] = force

    def set_off(self, index: int, off: bool) -> None:
        """Cut or restore a motor's supply. It takes effect at the next call of ``drive``."""
        self._off[index] = off

    def carry(self, vx_m_s: float, vy_m_s: float, vyaw_rad_s: float, seconds: float) -> None:
        """Move the whole robot over the floor, at speeds in its own frame. The legs keep their pose, where a real
        robot would walk."""
        qpos = self.data.qpos
        w, x, y, z = (float(value) for value in qpos[3:7])
        heading = math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
        cos, sin = math.cos(heading), math.sin(heading)
        qpos[0] += (cos * vx_m_s - sin * vy_m_s) * seconds
        qpos[1] += (sin * vx_m_s + cos * vy_m_s) * seconds
        half = vyaw_rad_s * seconds / 2.0
        c, s = math.cos(half), math.sin(half)
        qpos[3:7] = (c * w - s * z, c * x - s * y, c * y + s * x, c * z + s * w)

    # -- sensors

    @property
    def orientation_wxyz(self) -> tuple[float, ...]:
        return tuple(self.data.qpos[3:7].tolist())

    @property
    def acceleration_m_s2(self) -> tuple[float, ...]:
        return tuple(self.data.sensordata[:3].tolist())

    @property
    def gyro_rad_s(self) -> tuple[float, ...]:
        return tuple(self.data.sensordata[3:6].tolist())

    @property
    def height_m(self) -> float:
        return float(self.data.qpos[2])

    @property
    def fallen(self) -> bool:
        _, x, y, _ = self.orientation_wxyz
        return self.height_m < self._fallen_m or 1.0 - 2.0 * (x * x + y * y) < TIPPED
