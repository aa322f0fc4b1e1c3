"""The options of a robot on LeRobot's command line: ``--robot.port=...``."""

from dataclasses import dataclass, field
from typing import ClassVar

from .lerobot_api import CameraConfig, RobotConfig

REFUSALS = 30
"""One second at LeRobot's usual rate (30 Hz)."""


@dataclass(kw_only=True)
class StrandsConfig(RobotConfig):
    """Options of every robot.

    Without ``name``, LeRobot's ``id`` is also the robot's name. LeRobot's calibration file for that id is then
    used.
    """

    # The robot's name on the mesh, in logs and in locks, and the name of its calibration file.
    name: str | None = None
    # Cameras that LeRobot opens and reads by itself, without strands-actors.
    cameras: dict[str, CameraConfig] = field(default_factory=dict)
    # True: angles are in degrees. False: a position is -100 to 100 over the joint's calibrated range.
    use_degrees: bool = True
    # Path of a TOML file with the network endpoints by which other hosts reach the robot. The format is that
    # of `strands-actors --mesh`.
    mesh: str | None = None
    # On connect, run the service that this robot needs before it moves (stand up, enable its arms).
    prepare: bool = False
    # After this number of refused actions in a row, send_action raises ConnectionError.
    refusals: int = REFUSALS


@dataclass(kw_only=True)
class LocalConfig(StrandsConfig):
    """Options of a robot on this host. A subclass is generated for each type of robot, and its attribute
    ``ROBOT`` has the name of the type."""

    ROBOT: ClassVar[str] = ""

    # The robot's serial device, or its address.
    port: str | None = None
    # Use a simulated robot instead: a process that imitates the robot's firmware and physics.
    twin: bool = False


@dataclass(kw_only=True)
class RemoteConfig(StrandsConfig):
    """Options of a robot that runs on another host."""

    # The type of the robot: so101, ur5e, ...
    robot: str
    # The network endpoint at which the robot's host listens, for example tls/arm.example:7447.
    at: str
