"""Simulate the body of the drone: a rigid body in MuJoCo, with cascaded controllers like those of the firmware.

A speed error leads to a tilt, and a tilt error to a torque. The motors' thrust and torque are bounded. The
gains are [assumed]: they make it fly, but are not the firmware's.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from strands_actors.drivers.common.physics.body import TIMESTEP_S
from strands_actors.drivers.common.physics.lean_mujoco import mujoco
from strands_actors.drivers.common.physics.model_rows import build

GRAVITY_M_S2 = 9.81
LONGEST_S = 0.25
"""Longest time that is simulated at once after a pause. The rest of a longer pause is skipped."""

_SPEED_GAIN, _CLIMB_GAIN, _TURN_GAIN, _YAW_GAIN = 4.0, 8.0, 10.0, 4.0
_TILT_GAIN, _TILT_DAMPING = 400.0, 36.0
_MOST_TILT_RAD, _MOST_COMMANDED_TILT_RAD = math.radians(25.0), math.radians(45.0)
_MOST_TURN_RAD_S = math.radians(200.0)
_MOST_LIFT_M_S2 = 5.0


class Target(NamedTuple):
    """A setpoint for the simulated flight controllers.

    Attributes:
        vx_m_s: Speed ahead, or along x of the world.
        vy_m_s: Speed to the left, or along y of the world.
        vz_m_s: Climb speed.
        wz_rad_s: Turn rate.
        z_m: The height to hold. None if only the climb speed counts.
        level: Roll and pitch are commanded by ``tilt_rad``, and the speeds ``vx_m_s`` and ``vy_m_s`` do not count.
        world: True if the speeds are in the frame of the world, False for the drone's own.
        xy_m: The place to hold, in the frame of the world. None if only the speeds count.
        yaw_rad: The yaw to hold. None if only the turn rate counts.
        tilt_rad: Roll and pitch if ``level``. A positive pitch lowers the nose.
        lift: Thrust in place of a climb: 1 carries the drone. None to control the climb.
    """

    vx_m_s: float = 0.0
    vy_m_s: float = 0.0
    vz_m_s: float = 0.0
    wz_rad_s: float = 0.0
    z_m: float | None = None
    level: bool = False
    world: bool = True
    xy_m: tuple[float, float] | None = None
    yaw_rad: float | None = None
    tilt_rad: tuple[float, float] = (0.0, 0.0)
    lift: float | None = None

    def levelled(self) -> Target:
        """Return the setpoint to which the firmware changes this one when no newer one comes: level, without a
        turn, at the same height."""
        return self._replace(level=True, tilt_rad=(0.0, 0.0), wz_rad_s=0.0, xy_m=None, yaw_rad=None)


@dataclass
class Gains:
    """Gains and limits of the position controller, x, y and z. They are the firmware's parameters ``posCtlPid``."""

    proportional: list[float] = field(default_factory=lambda: [2.0, 2.0, 2.0])
    most_m_s: list[float] = field(default_factory=lambda: [1.0, 1.0, 1.0])


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
        self.gains = Gains()
        self.lift = 0.0
        """Present thrust, as a multiple of the weight."""
        self.commanded_rad = (0.0, 0.0, 0.0)
        """Present roll, pitch and yaw that the controller wants."""
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
    def turn_rad_s(self) -> tuple[float, float, float]:
        """Return the turn rates in the frame of the body."""
        x, y, z = self.data.qvel[3:6].tolist()
        return x, y, z

    @property
    def acceleration_g(self) -> tuple[float, float, float]:
        """Return what the accelerometer measures, in the frame of the body. A body at rest measures (0, 0, 1)."""
        x, y, z = self.data.qacc[:3].tolist()
        force = (x, y, z + GRAVITY_M_S2)
        rotation = self.data.xmat[self._base].tolist()
        ax, ay, az = (
            sum(rotation[3 * row + column] * force[row] for row in range(3)) / GRAVITY_M_S2 for column in range(3)
        )
        return ax, ay, az

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

    def stand_up(self) -> None:
        """Put the body on its feet where it lies, as a person does."""
        self.data.qpos[2:7] = (self._rest_m, 1.0, 0.0, 0.0, 0.0)
        self.data.qvel[:] = 0.0
        mujoco.mj_forward(self.model, self.data)

    # -- time

    def step(self) -> None:
        """Advance the simulated body by one time step."""
        data = self.data
        vx, vy, vz = self.velocity_m_s
        force = [-self._drag * vx, -self._drag * vy, -self._drag * vz]
        torque = (0.0, 0.0, 0.0)
        self.lift, self.commanded_rad = 0.0, (0.0, 0.0, 0.0)
        if self.target is not None:
            thrust_n, torque = self._control(self.target)
            self.lift = thrust_n / (self._kg * GRAVITY_M_S2)
            up = data.xmat[self._base][2::3].tolist()
            force = [drag + thrust_n * axis for drag, axis in zip(force, up, strict=True)]
        rotation = data.xmat[self._base].tolist()
        turned = [sum(rotation[3 * row + column] * torque[column] for column in range(3)) for row in range(3)]
        data.xfrc_applied[self._base] = (*force, *turned)
        mujoco.mj_step(self.model, data)

    def _control(self, target: Target) -> tuple[float, tuple[float, float, float]]:
        """Return thrust and torques in the body's frame, within the limits of the motors."""
        roll, pitch, yaw = self.rpy_rad
        turn = self.data.qvel[3:6].tolist()
        target_roll, target_pitch = target.tilt_rad if target.level else self._tilts(target, yaw)
        self.commanded_rad = (target_roll, target_pitch, yaw if target.yaw_rad is None else target.yaw_rad)
        lift_n = self._lift_n(target, roll, pitch)
        turn_rate = target.wz_rad_s
        if target.yaw_rad is not None:
            off_rad = math.remainder(target.yaw_rad - yaw, math.tau)
            turn_rate = _within(turn_rate + _YAW_GAIN * off_rad, _MOST_TURN_RAD_S)
        angular = (
            _TILT_GAIN * (_within(target_roll, _MOST_COMMANDED_TILT_RAD) - roll) - _TILT_DAMPING * turn[0],
            _TILT_GAIN * (_within(target_pitch, _MOST_COMMANDED_TILT_RAD) - pitch) - _TILT_DAMPING * turn[1],
            _TURN_GAIN * (turn_rate - turn[2]),
        )
        torques = [
            _within(inertia * value, most)
            for inertia, value, most in zip(self._inertia, angular, self._torque_nm, strict=True)
        ]
        return min(max(lift_n, 0.0), self._thrust_n), (torques[0], torques[1], torques[2])

    def _tilts(self, target: Target, yaw: float) -> tuple[float, float]:
        """Return the roll and the pitch that lead to the target's speeds."""
        vx, vy, _ = self.velocity_m_s
        cos, sin = math.cos(yaw), math.sin(yaw)
        ahead, left = target.vx_m_s, target.vy_m_s
        if target.xy_m is not None:
            off_m = (target.xy_m[0] - self.xyz_m[0], target.xy_m[1] - self.xyz_m[1])
            gains, most = self.gains.proportional, self.gains.most_m_s
            ahead, left = (
                speed + _within(gain * off, limit)
                for speed, gain, off, limit in zip((ahead, left), gains[:2], off_m, most[:2], strict=True)
            )
        if target.world:
            ahead, left = cos * ahead + sin * left, cos * left - sin * ahead
        forward, sideways = cos * vx + sin * vy, cos * vy - sin * vx
        return -_tilt(_SPEED_GAIN * (left - sideways)), _tilt(_SPEED_GAIN * (ahead - forward))

    def _lift_n(self, target: Target, roll: float, pitch: float) -> float:
        """Return the thrust that the target needs."""
        if target.lift is not None:
            return target.lift * self._kg * GRAVITY_M_S2
        climb = target.vz_m_s
        if target.z_m is not None:
            correction = self.gains.proportional[2] * (target.z_m - self.xyz_m[2])
            climb = _within(climb + correction, self.gains.most_m_s[2])
        lift = GRAVITY_M_S2 + _within(_CLIMB_GAIN * (climb - self.velocity_m_s[2]), _MOST_LIFT_M_S2)
        return self._kg * lift / max(0.5, math.cos(roll) * math.cos(pitch))


def _tilt(acceleration_m_s2: float) -> float:
    return _within(math.atan2(acceleration_m_s2, GRAVITY_M_S2), _MOST_TILT_RAD)


def _within(value: float, most: float) -> float:
    return max(-most, min(most, value))


__all__ = ["LONGEST_S", "TIMESTEP_S", "FlyingBody", "Gains", "Target"]
