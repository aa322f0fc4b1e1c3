"""The drivers of the types of robots that pages show."""

from __future__ import annotations

from strands_actors.contract.driver import Driver
from strands_actors.drivers import get_native_driver_class
from strands_actors.supervisors.loading import build_driver


def driver_of(robot_type: str) -> Driver | None:
    """Return the driver of a type with its usual options, for its units and its model.

    Returns:
        None if there is no such type here, or if it needs options, which only the robot's own program knows.
    """
    driver_class: type[Driver] | None = get_native_driver_class(robot_type)
    if driver_class is None:
        return None
    try:
        return build_driver(driver_class, robot_type, "", driver_class.resolve(robot_type, {}))
    except ValueError:
        return None
