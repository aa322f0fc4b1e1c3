"""Register a driver that is no part of this package in a new process."""

from __future__ import annotations

from strands_actors.contract.driver import Driver
from strands_actors.contract.loading import load
from strands_actors.drivers import get_native_driver_class, register_native_driver


def where_is(driver_class: type[Driver]) -> str:
    """Return ``module:Class``, from which another process can load the driver."""
    return f"{driver_class.__module__}:{driver_class.__qualname__}"


def class_of(where: str) -> type[Driver] | None:
    """Load a driver class. Return None for an empty ``where``, which means a robot of this package."""
    driver_class: type[Driver] | None = load(where) if where else None
    return driver_class


def register(where: str, robot: str) -> None:
    """Register the class at ``module:Class`` for ``robot``, unless it is registered already."""
    driver_class = load(where)
    if get_native_driver_class(robot) is not driver_class:
        register_native_driver(robot, driver_class, overwrite=True)


def column(name: str, where: str = "") -> tuple[str, str]:
    """Return the robot of a column of the kill matrix, and the ``module:Class`` of a driver to register for it.

    A column is a robot, or ``robot:level`` for one that can be commanded in two ways (``Driver.LEVELS``).

    Raises:
        ValueError: The robot has no such level.
    """
    robot, _, level = name.partition(":")
    if not level or where:
        return robot, where
    driver_class = get_native_driver_class(robot)
    levels = driver_class.LEVELS if driver_class is not None and issubclass(driver_class, Driver) else {}
    if name not in levels:
        raise ValueError(f"{robot} has no level {level!r}. There is {', '.join(levels) or 'none'}")
    return robot, levels[name]


def prepare(robot: str, where: str) -> None:
    """Import the driver of a column, and register it if it is no part of this package.

    The driver of another level is not registered. In this process the robot's name keeps its usual meaning, and
    the caller that commands the other level registers that itself.
    """
    if where:
        register(where, robot)
    else:
        name, level = column(robot)
        if class_of(level) is None:
            get_native_driver_class(name)
