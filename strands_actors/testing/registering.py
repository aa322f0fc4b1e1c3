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


def prepare(robot: str, where: str) -> None:
    """Have the driver of ``robot`` imported; ``where``: of one that has to be registered, else
    empty."""
    if where:
        register(where, robot)
    else:
        get_native_driver_class(robot)
