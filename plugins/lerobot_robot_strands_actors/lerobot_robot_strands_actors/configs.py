"""What LeRobot's command line may say of a robot: ``--robot.port=...``."""

from dataclasses import dataclass, field
from typing import ClassVar

from lerobot.cameras import CameraConfig
from lerobot.robots import RobotConfig

REFUSALS = 30
"""A second of LeRobot's usual rate."""


@dataclass(kw_only=True)
class StrandsConfig(RobotConfig):
    """Of all of them. ``id``, LeRobot's own, is the robot's name where ``name`` is not given, so
    that LeRobot's calibration of that id is used."""

    # Its name on the mesh, in logs and locks; also of its calibration file.
    name: str | None = None
    # Opened and read by LeRobot, as with its own robots.
    cameras: dict[str, CameraConfig] = field(default_factory=dict)
    # Angles in degrees. False: -100 to 100 over each joint's calibrated range.
    use_degrees: bool = True
    # A TOML file, as `strands-actors --mesh` takes it: where other hosts reach the robot, and how.
    mesh: str | None = None
    # Do what this robot wants done before it moves (stand up, enable its arms) when it is connected.
    prepare: bool = False
    # So many actions in a row may be refused before send_action raises.
    refusals: int = REFUSALS


@dataclass(kw_only=True)
class LocalConfig(StrandsConfig):
    """Of a robot of this host; ``ROBOT`` is which. One class a robot is made of it."""

    ROBOT: ClassVar[str] = ""

    # A serial device, or an address: what the robot has.
    port: str | None = None
    # Its twin instead: the robot's firmware and physics in a process.
    twin: bool = False


@dataclass(kw_only=True)
class RemoteConfig(StrandsConfig):
    """Of a robot that another host runs, and listens for."""

    # Which robot it is: so101, ur5e, ...
    robot: str
    # Where its host listens: tls/arm.example:7447
    at: str
