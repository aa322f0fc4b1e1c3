"""The robots that LeRobot has a class for, by our names: ``types.toml``."""

from __future__ import annotations

import importlib.util
from pathlib import Path

import msgspec


class Type(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A row of ``types.toml``, which says what each field is."""

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
        """Return the calls that stop it."""
        return self.stop or tuple(f"{bus}.disable_torque" for bus in self.buses)

    @property
    def holds(self) -> bool:
        """Return whether it can be told to stay where it is."""
        return bool(self.buses)


def missing(kind: Type) -> str:
    """Return the line that installs what this robot needs and this machine lacks; empty: it is all
    here. Nothing is imported: LeRobot's packages bring torch."""
    has_type = _has_type(kind)
    if has_type and importlib.util.find_spec(kind.needs) is not None:
        return ""
    newer = "-U " if has_type is False else ""  # pip keeps a LeRobot that is there
    lerobot = f"'lerobot[{kind.extra}]'" if kind.extra else "lerobot"
    return f"pip install {newer}{lerobot}{f', and {kind.also}' if kind.also else ''}"


def _has_type(kind: Type) -> bool | None:
    """Return whether the LeRobot of this environment has the robot: some came later. None: there is
    no LeRobot."""
    lerobot = importlib.util.find_spec("lerobot")
    if lerobot is None:
        return None
    places = [Path(folder) / "robots" / kind.module for folder in lerobot.submodule_search_locations or ()]
    return any(place.is_dir() or place.with_suffix(".py").is_file() for place in places)


TYPES = msgspec.toml.decode((Path(__file__).parent / "types.toml").read_bytes(), type=dict[str, Type])
