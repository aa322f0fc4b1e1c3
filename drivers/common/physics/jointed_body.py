"""The body of a simulated robot that drives its joints one by one."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from .body import Commander, Felt
from .physics import Plant
from .scenery import Scenery


class JointedBody:
    """The body of a simulated robot that drives its joints one by one.

    Args:
        plant: The simulated physics of the robot's joints.
        pass_time: Called after each step, so that the simulated firmware notices the new time.
    """

    def __init__(self, plant: Plant, pass_time: Callable[[], None]) -> None:
        self._plant = plant
        self.pass_time = pass_time
        self.axes = plant.joints
        self.spec = plant.spec
        self.scenery = Scenery(plant)

    @property
    def commanders(self) -> Sequence[Commander]:
        return [self._plant.commander(index) for index in range(len(self.axes))]

    def felt(self) -> Felt:
        plant = self._plant
        return Felt(
            plant.time_s,
            plant.position_rad,
            plant.velocity_rad_s,
            plant.effort_nm,
            self.commanders,
            plant.base_xyz_m,
            plant.base_orientation_wxyz,
            plant.base_gyro_rad_s,
        )

    def pose(self) -> Sequence[float]:
        qpos: list[float] = self._plant.data.qpos.tolist()
        return qpos

    def energise(self, on: bool) -> None:
        self._plant.hold_by_controller(on)
        for index in range(len(self.axes)):
            self._plant.energise(index, on)

    def set_targets(self, values: Sequence[float]) -> None:
        self._plant.hold_by_controller(False)
        for index, value in enumerate(values):
            self._plant.set_simulation_target(index, value)

    def hold(self) -> None:
        if not self._plant.hold_by_controller(True):
            self.set_targets(self._plant.position_rad)

    def step(self, steps: int) -> None:
        self._plant.step(steps)
        self.pass_time()

    def reset(self) -> None:
        self._plant.hold_by_controller(False)
        self._plant.go_home()
