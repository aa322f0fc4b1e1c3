"""Simulate the body of the drone: a rigid body in MuJoCo, with cascaded controllers like those of the firmware.

A speed error leads to a tilt, and a tilt error to a torque. The motors' thrust and torque are bounded. The
gains are [assumed]: they make it fly, but are not the firmware's.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

from strands_actors.drivers.common.physics.body import TIMESTEP_S
from strands_actors.drivers.common.physics.lean_mujoco import mujoco
from strands_actors.drivers.common.physics.model_rows import build

GRAVITY_M_S2 = 9.81
LONGEST_S = 0.25
"""Longest time that is simulated at once after a pause. The rest of a longer pause is skipped."""

_SPEED_GAIN, _CLIMB_GAIN, _HEIGHT_GAIN, _TURN_GAIN = 4.0, 8.0, 2.0, 10.0
_TILT_GAIN, _TILT_DAMPING = 400.0, 36.0
_MOST_TILT_RAD = math.radians(25.0)
_MOST_CLIMB_M_S = 1.0  # as posCtlPid.zVelMax of the firmware
_MOST_LIFT_M_S2 = 5.0


class Target(NamedTuple):
    """A setpoint for the simulated flight controllers.

    ``level`` keeps roll and pitch at zero for any speed. ``z_m`` is the height to hold; None if only the climb
    speed ``vz_m_s`` counts.
    """

    vx_m_s: float = 0.0
    vy_m_s: float = 0.0
    vz_m_s: float = 0.0
    wz_rad_s: float = 0.0
    z_m: float | None = None
    level: bool = False
    world: bool = True  # True if speeds are in the world's frame, False for the robot's own


class FlyingBody:
    """The simulated body. It starts on the floor with its motors off. ``target`` is its setpoint; None while
    the motors are off."""

    def __init__(self, table: Mapping[str, Any]) -> None:
        self.spec = build(table)
        self.model = self.spec.compile()
        self.data = mujoco.MjData(self.model)
        self._base = int(self.model.body("base").id)
        self._kg = float(self.model.body_subtreemass[self._base])
        self._inertia = [float(value) for value in self.model.body_inertia[self._base]]
        self._thrust_n = float(table["thrust_n"])
        self._torque_nm = [float(value) for value in table["torque_nm"]]
        self._drag = float(table["drag_n_s_m"])
        self._rest_m = float(self.data.qpos[2])
        self.target: Target | None = None
        self.reset()

    def reset(self) -> None:
        """Put the body back at its start: on the floor, upright, at rest."""
        mujoco.mj_resetData(self.model, self.data)
        mujoco.mj_forward(self.model, self.data)
        self.target = None

    # -- values that the simulated estimator reports

    @property
    def time_s(self) -> float:
        return float(self.data.time)

    @property
    def xyz_m(self) -> tuple[float, float, float]:
        """Return the position. The height is measured at the feet."""
        x, y, z = self.data.qpos[:3].tolist()
        return x, y, z - self._rest_m

    @property
    def velocity_m_s(self) -> tuple[float, float, float]:
        vx, vy, vz = self.data.qvel[:3].tolist()
        return vx, vy, vz

    @property
    def wz_rad_s(self) -> float:
        return float(self.data.qvel[5])

    @property
    def rpy_rad(self) -> tuple[float, float, float]:
        w, x, y, z = self.data.qpos[3:7].tolist()
        roll = math.atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
        pitch = math.asin(max(-1.0, min(1.0, 2 * (w * y - z * x))))
        yaw = math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
        return roll, pitch, yaw

    @property
    def tilt_rad(self) -> float:
        """Return the angle between the body's own axis and the vertical."""
        _, x, y, _ = self.data.qpos[3:7].tolist()
        return math.acos(max(-1.0, min(1.0, 1 - 2 * (x * x + y * y))))

    def tip_over(self) -> None:
        """Put the body on its back on the floor, as after a collision with a wall."""
        self.data.qpos[2:7] = (2 * self._rest_m, 0.0, 1.0, 0.0, 0.0)
        self.data.qvel[:] = 0.0
        mujoco.mj_forward(self.model, self.data)

    # -- time

    def step(self) -> None:
        """Advance the simulated body by one time step."""
        data = self.data
        vx, vy, vz = self.velocity_m_s
        force = [-self._drag * vx, -self._drag * vy, -self._drag * vz]
        torque = (0.0, 0.0, 0.0)
        if self.target is not None:
            thrust_n, torque = self._control(self.target)
            up = data.xmat[self._base][2::3].tolist()
            force = [drag + thrust_n * axis for drag, axis in zip(force, up, strict=True)]
        rotation = data.xmat[self._base].tolist()
        turned = [sum(rotation[3 * row + column] * torque[column] for column in range(3)) for row in range(3)]
        data.xfrc_applied[self._base] = (*force, *turned)
        mujoco.mj_step(self.model, data)

    def _control(self, target: Target) -> tuple[float, tuple[float, float, float]]:
        """Return thrust and torques in the body's frame, within the limits of the motors."""
        roll, pitch, yaw = self.rpy_rad
        vx, vy, vz = self.velocity_m_s
        cos, sin = math.cos(yaw), math.sin(yaw)
        forward, sideways = cos * vx + sin * vy, cos * vy - sin * vx
        target_forward, target_sideways = target.vx_m_s, target.vy_m_s
        if target.world:
            target_forward, target_sideways = (
                cos * target.vx_m_s + sin * target.vy_m_s,
                cos * target.vy_m_s - sin * target.vx_m_s,
            )
        target_pitch = target_roll = 0.0
        if not target.level:
            target_pitch = _tilt(_SPEED_GAIN * (target_forward - forward))
            target_roll = -_tilt(_SPEED_GAIN * (target_sideways - sideways))
        climb = target.vz_m_s
        if target.z_m is not None:
            climb = _within(climb + _HEIGHT_GAIN * (target.z_m - self.xyz_m[2]), _MOST_CLIMB_M_S)
        lift = GRAVITY_M_S2 + _within(_CLIMB_GAIN * (climb - vz), _MOST_LIFT_M_S2)
        thrust_n = self._kg * lift / max(0.5, math.cos(roll) * math.cos(pitch))
        turn = self.data.qvel[3:6].tolist()
        angular = (
            _TILT_GAIN * (target_roll - roll) - _TILT_DAMPING * turn[0],
            _TILT_GAIN * (target_pitch - pitch) - _TILT_DAMPING * turn[1],
            _TURN_GAIN * (target.wz_rad_s - turn[2]),
        )
        torques = [
            _within(inertia * value, most)
            for inertia, value, most in zip(self._inertia, angular, self._torque_nm, strict=True)
        ]
        return min(max(thrust_n, 0.0), self._thrust_n), (torques[0], torques[1], torques[2])


def _tilt(acceleration_m_s2: float) -> float:
    return _within(math.atan2(acceleration_m_s2, GRAVITY_M_S2), _MOST_TILT_RAD)


def _within(value: float, most: float) -> float:
    return max(-most, min(most, value))


__all__ = ["LONGEST_S", "TIMESTEP_S", "FlyingBody", "Target"]
