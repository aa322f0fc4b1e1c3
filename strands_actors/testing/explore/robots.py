"""The robots that are modelled, one of each kind of wire."""

from __future__ import annotations

from .legs import LeggedRobot
from .robot_model import RobotModel
from .service_robot import Base, Drone, SlowArm
from .servo_arm import ServoArm
from .session_arm import SessionArm

MODELS: dict[str, type[RobotModel]] = {
    "so101": ServoArm,
    "xarm7": SessionArm,
    "unitree_go2": LeggedRobot,
    "fake_base": Base,
    "fake_drone": Drone,
    "fake_http": SlowArm,
}
ROBOTS = tuple(MODELS)
