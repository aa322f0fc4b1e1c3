"""Arms for tests of poses, without a robot: the driver, the model of the arm, and random poses that it reaches."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache
from typing import NamedTuple

import numpy as np

from strands_actors.caller.poses.arm import Arm, Array, Pose
from strands_actors.caller.poses.plans import PosePlan, plan_pose
from strands_actors.caller.poses.request import Box, PoseRequest, read_request
from strands_actors.caller.poses.timing import Units, limits_of, units_of
from strands_actors.caller.session.motions import RobotReading
from strands_actors.contract.driver import Driver
from strands_actors.kernel.messages import Refused

from .robots import NOW_NS, drivers, observed

ROBOTS = ("ur5e", "panda", "xarm7", "kinova_gen3", "kuka_iiwa", "so101")

READY: dict[str, tuple[float, ...]] = {"so101": (0.0, -1.2, 1.0, 0.6, 0.0)}
"""Joint positions in rad with room around them, for an arm whose table has no home."""


class Desk(NamedTuple):
    """An arm, ready to plan."""

    driver: Driver
    arm: Arm
    units: Units
    ready: Array

    def reading(self, rad: Array) -> RobotReading:
        """Return the reading of an arm that stands at these joint positions."""
        position = list(observed(self.driver).position)
        for axis, value in zip(self.units.axes, self.units.values(rad), strict=True):
            position[axis] = value
        before = observed(self.driver)
        reading = type(before)(
            NOW_NS, tuple(position), before.stamp_ns, before.velocity, before.sensors, before.faults
        )
        return RobotReading(reading, tuple(position), NOW_NS)

    def planned(self, rad: Array | None = None, **pose: object) -> PosePlan | Refused:
        return plan_pose(self.arm, asked(**pose), self.ready if rad is None else rad)


def asked(**pose: object) -> PoseRequest:
    """Return the request of valid arguments."""
    request = read_request(**pose)
    assert isinstance(request, PoseRequest), request
    return request


@cache
def driver_of(robot: str) -> Driver:
    return drivers()[robot]


def desk(robot: str, keep_out: tuple[Box, ...] = ()) -> Desk:
    driver = driver_of(robot)
    model = driver.arm_model({})
    assert model is not None
    units = units_of(driver, model.joints)
    arm = Arm(model, *limits_of(driver, model), keep_out=keep_out)
    return Desk(driver, arm, units, np.array(READY.get(robot, arm.home)))


def reachable(arm: Arm, count: int, seed: int = 3) -> Iterator[Pose]:
    """Return random poses that the arm reaches without touching itself."""
    generator = np.random.default_rng(seed)
    low, high = arm.searched()
    while count:
        rad = generator.uniform(low, high)
        if arm.touch(rad) is None:
            count -= 1
            yield arm.pose(rad)
