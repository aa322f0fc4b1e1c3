"""Read the table of robots that LeRobot supports (``types.toml``). The keys are the names of this package."""

from __future__ import annotations

import importlib.util
from pathlib import Path

import msgspec


class Type(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """One row of ``types.toml``. That file describes each field."""

    type: str
    module: str
    needs: str
    extra: str
    also: str = ""
    port: str = "port"
    buses: tuple[str, ...] = ()
    stop: tuple[str, ...] = ()
    goals: str = ""
    wire: str = ""
    serial: bool = True

    @property
    def stops(self) -> tuple[str, ...]:
        """Return the functions that stop the robot, as paths of attributes of LeRobot's robot object."""
        return self.stop or tuple(f"{bus}.disable_torque" for bus in self.buses)

    @property
    def holds(self) -> bool:
        """Return True if the robot can hold its position."""
        return bool(self.buses)


def missing(robot_type: Type) -> str:
    """Return the command that installs the packages which this robot needs. Empty if they are installed. This
    imports nothing, because LeRobot's packages import torch."""
    has_type = _has_type(robot_type)
    if has_type and importlib.util.find_spec(robot_type.needs) is not None:
        return ""
    # Without -U, pip keeps an installed LeRobot.
    newer = "-U " if has_type is False else ""
    lerobot = f"'lerobot[{robot_type.extra}]'" if robot_type.extra else "lerobot"
    return f"pip install {newer}{lerobot}{f', and {robot_type.also}' if robot_type.also else ''}"


def _has_type(robot_type: Type) -> bool | None:
    """Return True if the installed LeRobot has this robot, since only newer versions have some robots. Return None
    if LeRobot is not installed."""
    lerobot = importlib.util.find_spec("lerobot")
    if lerobot is None:
        return None
    places = [Path(folder) / "robots" / robot_type.module for folder in lerobot.submodule_search_locations or ()]
    return any(place.is_dir() or place.with_suffix(".py").is_file() for place in places)


TYPES = msgspec.toml.decode((Path(__file__).parent / "types.toml").read_bytes(), type=dict[str, Type])
