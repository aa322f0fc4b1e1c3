"""The options of a robot on LeRobot's command line: ``--robot.port=...``."""

from dataclasses import dataclass, field
from typing import ClassVar

from lerobot.cameras import CameraConfig
from lerobot.robots import RobotConfig

REFUSALS = 30
"""One second at LeRobot's usual rate (30 Hz)."""


@dataclass(kw_only=True)
class StrandsConfig(RobotConfig):
    """Options of every robot.

    Without ``name``, LeRobot's own ``id`` is the robot's name, so that LeRobot's calibration of that id
    is used.
    """

    # The robot's name on the mesh, in logs and in locks, and the name of its calibration file.
    name: str | None = None
    # LeRobot opens and reads these cameras, as those of its own robots.
    cameras: dict[str, CameraConfig] = field(default_factory=dict)
    # True: angles in degrees. False: -100 to 100 over each joint's calibrated range.
    use_degrees: bool = True
    # Path of a TOML file, as for `strands-actors --mesh`: at which endpoints other hosts reach the robot.
    mesh: str | None = None
    # On connect, run the service that this robot needs before it moves (stand up, enable its arms).
    prepare: bool = False
    # When so many actions in a row have been refused, send_action raises.
    refusals: int = REFUSALS


@dataclass(kw_only=True)
class LocalConfig(StrandsConfig):
    """Options of a robot on this host. One subclass per robot is generated, with its name in ``ROBOT``."""

    ROBOT: ClassVar[str] = ""

    # The robot's serial device, or its address.
    port: str | None = None
    # Use the robot's twin instead: a process with its firmware and physics.
    twin: bool = False


@dataclass(kw_only=True)
class RemoteConfig(StrandsConfig):
    """Options of a robot that runs on another host."""

    # The type of the robot: so101, ur5e, ...
    robot: str
    # The endpoint at which that host listens: tls/arm.example:7447
    at: str
