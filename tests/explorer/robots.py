"""The modelled robots, one for each kind of wire."""

from __future__ import annotations

from .datagram_wires import CycleArm, RadioDrone
from .dds_wires import UpperBody
from .fci_wires import FciArm
from .json_wires import DeskRobot, Duck
from .legs import LeggedRobot
from .queued_robot import QueuedRobot
from .register_wires import Fingers, SpeedArm
from .robot_model import RobotModel
from .script_arm import ScriptArm
from .serial_wires import Boards
from .service_robot import Base, Drone, SlowArm
from .servo_arm import LoweredArm, ServoArm
from .session_arm import SessionArm
from .stream_wires import Humanoid, Mecanum, Rover, Walker
from .upload_arm import UploadArm

MODELS: dict[str, type[RobotModel]] = {
    "so101": ServoArm,
    "so101_lowered": LoweredArm,
    "xarm7": SessionArm,
    "ur5e": UploadArm,
    "ur5e_script": ScriptArm,
    "unitree_go2": LeggedRobot,
    "fake_base": Base,
    "fake_drone": Drone,
    "fake_http": SlowArm,
    "fake_queue": QueuedRobot,
    "rby1": Humanoid,
    "spot": Walker,
    "yahboom_m3pro": Mecanum,
    "earthrover": Rover,
    "kuka_iiwa": CycleArm,
    "crazyflie": RadioDrone,
    "booster_t1": UpperBody,
    "microduck": Duck,
    "reachy_mini": DeskRobot,
    "kinova_gen3": SpeedArm,
    "robotiq_2f85": Fingers,
    "panda": FciArm,
    "stretch3": Boards,
}
ROBOTS = tuple(MODELS)
