"""Keep the registers that servos had before a calibration, next to the calibration file, so that they can be put
back."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from .calibration import save_json, text_of

SUFFIX = ".before"
"""LeRobot takes each ``.json`` in this folder for a calibration."""


def kept_path(calibration: Path) -> Path:
    """Return the path of the kept values of a calibration file."""
    return calibration.with_suffix(SUFFIX)


def keep(calibration: Path, robot: str, registers: Mapping[str, Mapping[str, int]]) -> None:
    """Store the registers of all servos, and the present content of the calibration file.

    Args:
        calibration: The path of the calibration file.
        robot: The robot.
        registers: The values by joint and name of the register.

    Raises:
        OSError: The file cannot be written, or the calibration file cannot be read.
    """
    file = text_of(calibration) if calibration.exists() else None
    save_json(kept_path(calibration), {"robot": robot, "registers": registers, "file": file})


class Kept:
    """What ``keep`` has stored.

    Attributes:
        registers: The values by joint and name of the register.
        file: The text of the calibration file; None if there was no file.
    """

    def __init__(self, registers: Mapping[str, Mapping[str, int]], file: str | None) -> None:
        self.registers = registers
        self.file = file


def load_kept(calibration: Path, robot: str, motors: Mapping[str, int], names: Mapping[str, Any]) -> Kept:
    """Read the kept values of a calibration file.

    Args:
        calibration: The path of the calibration file.
        robot: The robot.
        motors: The id of the servo of each joint.
        names: The registers that each servo must have, by name.

    Raises:
        ValueError: There is nothing, or it is of another robot or damaged.
    """
    path = kept_path(calibration)
    if not path.exists():
        raise ValueError(f"{path} does not exist: no earlier values were kept. Calibrate once, then they are")
    try:
        content = json.loads(text_of(path))
    except (OSError, ValueError, RecursionError) as error:
        raise ValueError(f"{path}: cannot be read ({error}). Calibrate again") from None
    if not isinstance(content, dict) or content.get("robot") != robot:
        of_robot = content.get("robot") if isinstance(content, dict) else None
        raise ValueError(f"{path}: robot is {of_robot!r}, must be {robot}. Give the robot that it was kept for")
    registers = content.get("registers")
    if not isinstance(registers, dict) or set(registers) != set(motors):
        raise ValueError(f"{path}: registers must have exactly {', '.join(motors)}. Calibrate again")
    for joint, values in registers.items():
        if not isinstance(values, dict) or set(values) != set(names):
            raise ValueError(f"{path}: {joint} must have exactly {', '.join(names)}. Calibrate again")
        if wrong := [name for name, value in values.items() if type(value) is not int]:
            raise ValueError(f"{path}: {joint}: {wrong[0]} is {values[wrong[0]]!r}, must be an integer")
    file = content.get("file")
    if file is not None and not isinstance(file, str):
        raise ValueError(f"{path}: file is {type(file).__name__}, must be text. Calibrate again")
    return Kept(registers, file)
