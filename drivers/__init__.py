"""Which robots have a driver here, and how another package adds one.

Built-in wires are listed by name and imported when asked for; a third-party package names its driver class
in the entry point group ``strands_actors.drivers``. A wire that cannot be imported is reported, never fatal.
"""

from __future__ import annotations

import importlib
import warnings
from importlib.metadata import entry_points
from typing import Any

from strands_actors.runtime.contract import Driver

WIRES = {
    "feetech": "strands_actors.drivers.feetech.driver:Feetech",
    "dynamixel": "strands_actors.drivers.dynamixel.driver:Dynamixel",
    "ur": "strands_actors.drivers.ur.driver:UR",
    "robotiq": "strands_actors.drivers.robotiq.driver:Robotiq",
    "unitree_g1": "strands_actors.drivers.unitree.driver:G1Driver",
    "unitree": "strands_actors.drivers.unitree.driver:Go2Driver",
}
"""One entry a class that declares robots: most wires have one."""

LEROBOT_ROBOTS = (
    "so100", "so101", "koch", "omx", "hope_jr", "bi_so100", "bi_so101", "lekiwi", "stretch3", "reachy2",
    "unitree_g1", "earthrover",
)  # fmt: skip
"""Robots that lerobot has a type for."""

OTHER_ROBOTS = ("ability_hand",)
"""Known by name, with no hardware driver anywhere."""

MEMBERS = (
    "cleanup", "get_status", "get_task_status", "run_policy", "send_action", "start_task", "stop", "stop_task",
    "stream", "tool_name", "tool_spec", "tool_type",
)  # fmt: skip
"""What a driver class that runs by itself (not as a tree of actors) must have."""

broken: dict[str, str] = {}
"""Wires and entry points that could not be imported, and why."""

_registered: dict[str, type[Any]] = {}
_aliases: dict[str, str] = {}
_loaded = False


def _load() -> None:
    global _loaded
    if _loaded:
        return
    _loaded = True
    wheres = dict(WIRES)
    for point in entry_points(group="strands_actors.drivers"):
        wheres.setdefault(point.name, point.value)
    for wire, where in wheres.items():
        module, _, name = where.partition(":")
        try:
            driver_class = getattr(importlib.import_module(module), name)
        except Exception as error:  # a third party's module may raise anything
            broken[wire] = f"{type(error).__name__}: {error}"
            warnings.warn(f"driver {wire} cannot be used: {broken[wire]}", stacklevel=3)
            continue
        for robot in driver_class.SUPPORTED_ROBOTS:
            _registered.setdefault(robot, driver_class)
        _aliases.update(driver_class.ALIASES)


def missing_driver_members(cls: type[Any]) -> list[str]:
    """The members of the drivers page that ``cls`` lacks, sorted. A ``Driver`` (run as a tree) lacks none."""
    if isinstance(cls, type) and issubclass(cls, Driver):
        return []
    return [member for member in MEMBERS if not hasattr(cls, member)]


def register_native_driver(name: str, cls: type[Any], overwrite: bool = False) -> None:
    """Serve robot ``name`` by ``cls``. Raise ``TypeError`` naming the members it lacks, ``ValueError`` when the
    name is taken (unless ``overwrite``)."""
    _load()
    missing = missing_driver_members(cls)
    if missing:
        raise TypeError(f"register_native_driver: {cls.__name__} lacks {', '.join(missing)}")
    if name in _registered and not overwrite:
        raise ValueError(
            f"register_native_driver: {name} is already served by {_registered[name].__name__}. "
            "pass overwrite=True to replace it"
        )
    _registered[name] = cls


def canonical_name(name: str) -> str:
    """The robot an alias stands for; the name itself otherwise."""
    _load()
    return _aliases.get(name, name)


def get_native_driver_class(name: str) -> type[Any] | None:
    """The driver class of a robot or alias, or None."""
    _load()
    return _registered.get(canonical_name(name))


def list_native_drivers() -> dict[str, str]:
    """Robot name to driver class name, sorted."""
    _load()
    return {name: _registered[name].__name__ for name in sorted(_registered)}


def list_driver_coverage() -> dict[str, tuple[str, ...]]:
    """Every known robot with who drives it: ``lerobot``, ``strands``, both or none."""
    _load()
    return {
        name: tuple(who for who, has in (("lerobot", LEROBOT_ROBOTS), ("strands", _registered)) if name in has)
        for name in sorted({*_registered, *LEROBOT_ROBOTS, *OTHER_ROBOTS})
    }
