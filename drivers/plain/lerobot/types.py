"""The robots that LeRobot has a class for, by the names of this package: ``types.toml``."""

from __future__ import annotations

import importlib.util
from pathlib import Path

import msgspec


class Type(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A row of ``types.toml``, which describes each field."""

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
        """Return the paths of the calls that stop the robot."""
        return self.stop or tuple(f"{bus}.disable_torque" for bus in self.buses)

    @property
    def holds(self) -> bool:
        """Return True if the robot can hold its position."""
        return bool(self.buses)


def missing(kind: Type) -> str:
    """Return the command that installs the packages that this robot needs and this machine lacks; empty if it
    lacks nothing. Nothing is imported, since LeRobot's packages import torch."""
    has_type = _has_type(kind)
    if has_type and importlib.util.find_spec(kind.needs) is not None:
        return ""
    newer = "-U " if has_type is False else ""  # without -U, pip keeps an installed LeRobot
    lerobot = f"'lerobot[{kind.extra}]'" if kind.extra else "lerobot"
    return f"pip install {newer}{lerobot}{f', and {kind.also}' if kind.also else ''}"


def _has_type(kind: Type) -> bool | None:
    """Return True if the installed LeRobot has this robot, since newer versions added some. None without
    LeRobot."""
    lerobot = importlib.util.find_spec("lerobot")
    if lerobot is None:
        return None
    places = [Path(folder) / "robots" / kind.module for folder in lerobot.submodule_search_locations or ()]
    return any(place.is_dir() or place.with_suffix(".py").is_file() for place in places)


TYPES = msgspec.toml.decode((Path(__file__).parent / "types.toml").read_bytes(), type=dict[str, Type])
