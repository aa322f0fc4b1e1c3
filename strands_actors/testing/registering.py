"""A driver that is no part of this package, made known to a process that starts afresh."""

from __future__ import annotations

from strands_actors.contract.driver import Driver
from strands_actors.contract.loading import load
from strands_actors.drivers import get_native_driver_class, register_native_driver


def where_is(driver_class: type[Driver]) -> str:
    """``module:Class``, from which another process can load it."""
    return f"{driver_class.__module__}:{driver_class.__qualname__}"


def class_of(where: str) -> type[Driver] | None:
    """None for an empty ``where``: a robot that this package knows by itself."""
    found: type[Driver] | None = load(where) if where else None
    return found


def register(where: str, robot: str) -> None:
    """Serve ``robot`` by the class at ``module:Class``, unless it is so already."""
    driver_class = load(where)
    if get_native_driver_class(robot) is not driver_class:
        register_native_driver(robot, driver_class, overwrite=True)


def column(name: str, where: str = "") -> tuple[str, str]:
    """Return the robot of a column of the kill matrix, and ``module:Class`` of a driver that has to be
    registered for it. A column is a robot, or ``robot:level`` of one that can be commanded in two
    ways (``Driver.LEVELS``). Raise ``ValueError`` for a level that is not there."""
    robot, _, level = name.partition(":")
    if not level or where:
        return robot, where
    driver_class = get_native_driver_class(robot)
    levels = driver_class.LEVELS if driver_class is not None and issubclass(driver_class, Driver) else {}
    if name not in levels:
        raise ValueError(f"{robot} has no level {level!r}. There is {', '.join(levels) or 'none'}")
    return robot, levels[name]


def prepare(robot: str, where: str) -> None:
    """Have the driver of ``robot``, the name of a column, imported, and registered where it is not of
    this package. Of a robot at another level it is not: in this process the name goes on to mean the
    robot itself, and the caller that commands it registers the other for itself."""
    if where:
        register(where, robot)
    else:
        name, level = column(robot)
        if class_of(level) is None:
            get_native_driver_class(name)
