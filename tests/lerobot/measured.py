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
        return cls.options_of(get_lerobot_class(robot), robot, known)


class SO101(Measured):
    SUPPORTED_ROBOTS: ClassVar[tuple[str, ...]] = ("so101",)
    TWIN: ClassVar[str] = load(WIRES["feetech"]).TWIN


class Koch(Measured):
    SUPPORTED_ROBOTS: ClassVar[tuple[str, ...]] = ("koch",)
    TWIN: ClassVar[str] = load(WIRES["dynamixel"]).TWIN


CLASSES: dict[str, type[Measured]] = {"so101": SO101, "koch": Koch}


def calibrate(folder: Path) -> None:
    """Have the robots of this module calibrated, in this process and those that it starts."""
    calibration.write(folder)
    os.environ[CALIBRATED] = str(folder)
