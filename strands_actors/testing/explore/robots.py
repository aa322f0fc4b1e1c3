"""The robots that are modelled, one of each kind of wire."""

from __future__ import annotations

from .robot_model import RobotModel
from .service_robot import Base, Drone, SlowArm
from .servo_arm import ServoArm

MODELS: dict[str, type[RobotModel]] = {
    "so101": ServoArm,
    "fake_base": Base,
    "fake_drone": Drone,
    "fake_http": SlowArm,
}
ROBOTS = tuple(MODELS)
