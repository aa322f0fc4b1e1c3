"""The body of a legged robot: a floating base on torque motors, stepped to wall time on demand. Twins only."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import mujoco
import numpy as np

from .model_rows import build
from .physics import LONGEST_CATCH_UP_S

TIPPED = math.cos(math.radians(60.0))
"""How far upright a base still counts as standing: the cosine of its tilt."""

_TOUCHING_M = 0.001


class Walker:
    """Joints by index, in the order of ``joints``. Each motor gives ``tau + kp (q - position) + kd (dq - speed)``
    with the joint's effort at most, as motor controllers do. At first it stands at ``home_rad``, its lowest point
    on the floor, and its motors give nothing."""

    def __init__(self, table: Mapping[str, Any], joints: Sequence[str]) -> None:
        spec = build({**table, "torque_motors": True})
        base = spec.body("base")
        base.add_site(name="imu")
        for kind in (mujoco.mjtSensor.mjSENS_ACCELEROMETER, mujoco.mjtSensor.mjSENS_GYRO):
            spec.add_sensor(type=kind, objtype=mujoco.mjtObj.mjOBJ_SITE, objname="imu")
        for name in joints:
            spec.add_equality(  # switched on, it jams the joint where it is
                type=mujoco.mjtEq.mjEQ_JOINT, objtype=mujoco.mjtObj.mjOBJ_JOINT, name=f"{name}_jam", name1=name,
                active=False,
            )  # fmt: skip
        self.model: Any = spec.compile()
        self.data: Any = mujoco.MjData(self.model)
        self._step_s = float(self.model.opt.timestep)
        self._fallen_m = float(table["fallen_m"])
        self._home = np.asarray(table["home_rad"], dtype=float)
        self._bind(joints)
        self._off = np.zeros(len(joints), dtype=bool)
        self.stand_up()

    def _bind(self, joints: Sequence[str]) -> None:
        """Each joint's motor by what it turns: order says nothing."""
        model = self.model
        motor_of = {int(model.actuator_trnid[motor, 0]): motor for motor in range(model.nu)}
        ids = [model.joint(name).id for name in joints]
        self._motor = np.array([motor_of[joint] for joint in ids])
        self._qpos = np.array([int(model.jnt_qposadr[joint]) for joint in ids])
        self._dof = np.array([int(model.jnt_dofadr[joint]) for joint in ids])
        self._jam = [model.equality(f"{name}_jam").id for name in joints]

    def stand_up(self) -> None:
        """Back on its feet, as somebody would put it there."""
        data = self.data
        mujoco.mj_resetData(self.model, data)
        data.qpos[self._qpos] = self._home
        mujoco.mj_forward(self.model, data)
        data.qpos[2] -= self._lowest_m() + _TOUCHING_M
        mujoco.mj_forward(self.model, data)
        self._origin_s: float | None = None
        self.drive(*np.zeros((5, len(self._motor))))

    def _lowest_m(self) -> float:
        """Height of the lowest point of any shape."""
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
        """What every motor is to do until it is told otherwise."""
        stiffness = np.where(self._off, 0.0, kp)
        damping = np.where(self._off, 0.0, kd)
        force = np.where(self._off, 0.0, np.asarray(tau) + stiffness * q + damping * dq)
        model = self.model
        model.actuator_gainprm[self._motor, 0] = 1.0
        model.actuator_biasprm[self._motor, 1] = -stiffness
        model.actuator_biasprm[self._motor, 2] = -damping
        self.data.ctrl[self._motor] = force

    def set_off(self, index: int, off: bool) -> None:
        """A motor without supply, from the next ``drive`` on."""
        self._off[index] = off

    def set_stuck(self, index: int, on: bool) -> None:
        """A seized gearbox: the joint stays where it is whatever pulls."""
        address = self._qpos[index]
        self.model.eq_data[self._jam[index], 0] = self.data.qpos[address] - self.model.qpos0[address]
        self.data.eq_active[self._jam[index]] = on

    def catch_up(self, now_s: float) -> None:
        """Step to ``now_s``, on any clock that runs forward. The first call sets the clock."""
        if self._origin_s is None:
            self._origin_s = now_s - self.data.time
        behind_s = now_s - self._origin_s - self.data.time
        if behind_s > LONGEST_CATCH_UP_S:
            self._origin_s += behind_s - LONGEST_CATCH_UP_S
            behind_s = LONGEST_CATCH_UP_S
        steps = int(behind_s / self._step_s + 1e-6)
        if steps > 0:
            mujoco.mj_step(self.model, self.data, steps)

    # -- what it feels

    @property
    def position_rad(self) -> tuple[float, ...]:
        return tuple(self.data.qpos[self._qpos].tolist())

    @property
    def velocity_rad_s(self) -> tuple[float, ...]:
        return tuple(self.data.qvel[self._dof].tolist())

    @property
    def torque_nm(self) -> tuple[float, ...]:
        return tuple(self.data.actuator_force[self._motor].tolist())

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
