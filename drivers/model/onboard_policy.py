"""Run a policy as the controller on board of a simulated model."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from strands_actors.contract.axis import Axis
from strands_actors.contract.loading import load
from strands_actors.contract.rotations import roll_pitch_yaw
from strands_actors.contract.wire import Observation
from strands_actors.drivers.common.physics.body import TIMESTEP_S
from strands_actors.drivers.common.physics.physics import Plant

from .reading import Joint


class OnboardPolicy:
    """A policy that gets the state of a simulated robot, and returns the targets of its joints.

    Args:
        plant: The simulated physics of the robot's joints.
        joints: The axes of the model.
        where: The policy's class, as ``module:class``.
        options: Its keyword arguments. It also gets ``axes``, the names of the joints.
    """

    def __init__(self, plant: Plant, joints: Sequence[Joint], where: str, options: Mapping[str, Any]) -> None:
        self._plant = plant
        self._names = [joint.name for joint in joints]
        self._policy = load(where)(axes=self._names, **options)
        self._policy.set_robot_axes(
            [
                Axis(key=joint.name, unit="m" if joint.slides else "rad", low=joint.low, high=joint.high)
                for joint in joints
            ]
        )
        self.period = max(1, round(1 / (self._policy.control_hz * TIMESTEP_S)))
        """Number of time steps in one control period."""
        self._kept: dict[str, float] = {}

    def begin(self) -> None:
        """Forget earlier readings, and keep the joints that the policy does not move where they are now."""
        self._policy.reset()
        self._kept = dict(zip(self._names, self._plant.position_rad, strict=True))

    def targets(self) -> list[float]:
        """Return the targets of the joints for the present state."""
        plant = self._plant
        quaternion = plant.base_orientation_wxyz
        sensors = {
            "base_xyz_m": plant.base_xyz_m,
            "rpy_rad": roll_pitch_yaw(quaternion) if quaternion else (),
            "gyro_rad_s": plant.base_gyro_rad_s,
        }
        position = plant.position_rad
        reading = Observation(0, position, (0,) * len(position), plant.velocity_rad_s, sensors)
        self._policy.set_reading(reading)
        chosen = self._policy.get_actions_sync(dict(zip(self._names, position, strict=True)), "")[0]
        return [chosen.get(name, self._kept[name]) for name in self._names]
