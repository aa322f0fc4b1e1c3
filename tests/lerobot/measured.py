"""LeRobot's own classes of robots that we have a twin of, as drivers that a kill matrix can measure:
their processes find them here by name."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any, ClassVar

from strands_actors.contract.loading import load
from strands_actors.drivers import WIRES, get_lerobot_class
from strands_actors.drivers.plain.lerobot.driver import LeRobotDriver

from . import calibration

CALIBRATED = "STRANDS_ACTORS_MEASURED"
"""The folder of the calibration, told to all processes of a matrix."""


class Measured(LeRobotDriver):
    """What ``Robot(robot, driver="lerobot", port=..., tool_name="black", calibration_dir=...)``
    makes of LeRobot's class, at a port that is known later."""

    def __init__(self, robot: str, port: str, options: Mapping[str, Any]) -> None:
        config = options["config"]
        with_port = {**options, "config": {**config, "keywords": {**config["keywords"], "port": port}}}
        super().__init__(robot, port, with_port)

    @classmethod
    def resolve(cls, robot: str, options: Mapping[str, Any]) -> dict[str, Any]:
        folder = os.environ[CALIBRATED]
        known = {"tool_name": calibration.NAME, "calibration_dir": folder}
        return cls.options_of(cls.follower(robot), robot, known)

    @classmethod
    def follower(cls, robot: str) -> type[Any]:
        """Return the class of the object that the wire process makes."""
        return get_lerobot_class(robot)


class SO101(Measured):
    SUPPORTED_ROBOTS: ClassVar[tuple[str, ...]] = ("so101",)
    TWIN: ClassVar[str] = load(WIRES["feetech"]).TWIN


class Koch(Measured):
    SUPPORTED_ROBOTS: ClassVar[tuple[str, ...]] = ("koch",)
    TWIN: ClassVar[str] = load(WIRES["dynamixel"]).TWIN


class OnRustypot:
    """LeRobot's class on a bus as LeRobot 0.7 has it. Name this class before the robot's."""

    @classmethod
    def follower(cls, robot: str) -> type[Any]:
        from . import on_rustypot

        follower: type[Any] = on_rustypot.CLASSES[robot]
        return follower


class SO101OnRustypot(OnRustypot, SO101):
    pass


class KochOnRustypot(OnRustypot, Koch):
    pass


CLASSES: dict[str, type[Measured]] = {"so101": SO101, "koch": Koch}
ON_RUSTYPOT: dict[str, type[Measured]] = {"so101": SO101OnRustypot, "koch": KochOnRustypot}


def calibrate(folder: Path) -> None:
    """Have the robots of this module calibrated, in this process and those that it starts."""
    calibration.write(folder)
    os.environ[CALIBRATED] = str(folder)
