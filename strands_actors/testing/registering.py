"""Register a driver of another package in a new process."""

from __future__ import annotations

from typing import Any

from strands_actors.contract.driver import Driver
from strands_actors.contract.loading import load
from strands_actors.drivers import get_native_driver_class, register_native_driver

LOWERING = ":lowering"
"""The end of the name of a column in which an arm is broken while it is lowered."""

HOSTED = ":hosted"
"""The end of the name of a column in which a host keeps the robot, and the caller attaches itself."""


CARRIES = ":gripper="
"""In the name of a column: the option ``gripper`` of the arm, such as ``ur5e:gripper=robotiq_2f85``."""


def class_path_of(driver_class: type[Driver]) -> str:
    """Return the ``module:Class`` of a driver class, by which another process can load it."""
    return f"{driver_class.__module__}:{driver_class.__qualname__}"


def class_of(class_path: str) -> type[Driver] | None:
    """Load a driver class. Return None for an empty ``class_path``, which means a robot of this package."""
    driver_class: type[Driver] | None = load(class_path) if class_path else None
    return driver_class


def register(class_path: str, robot: str) -> None:
    """Register the class at ``module:Class`` for ``robot``, unless it is registered already."""
    driver_class = load(class_path)
    if get_native_driver_class(robot) is not driver_class:
        register_native_driver(robot, driver_class, overwrite=True)


def column(name: str, class_path: str = "") -> tuple[str, str]:
    """Return the robot of a column of the kill matrix, and the ``module:Class`` of the driver to register.

    The second text is empty for the usual driver of the robot.

    The name of a column is that of a robot. It is ``robot:level`` if the robot can be commanded in two ways
    (``Driver.LEVELS``), ``robot:lowering`` for an arm that is lowered, ``robot:hosted`` for a robot that a host
    keeps (``strands-actors up``), and ``robot:gripper=NAME`` for an arm that carries this gripper.

    Raises:
        ValueError: The robot has no such level, or no option ``gripper``.
    """
    if CARRIES in name:
        robot = name.partition(CARRIES)[0]
        carrier = get_native_driver_class(robot)
        if carrier is not None and "gripper" not in getattr(carrier, "OPTIONS", {}):
            raise ValueError(f"{robot} has no option gripper: there is no column {name}")
        return robot, class_path
    robot, _, level = name.removesuffix(LOWERING).removesuffix(HOSTED).partition(":")
    if name.endswith(LOWERING) and not end_of(robot, get_native_driver_class(robot), lowered=True):
        raise ValueError(f"{robot} is not lowered: there is no column {name}")
    if not level or class_path:
        return robot, class_path
    driver_class = get_native_driver_class(robot)
    levels = driver_class.LEVELS if driver_class is not None and issubclass(driver_class, Driver) else {}
    if name not in levels:
        raise ValueError(f"{robot} has no level {level!r}. It has {', '.join(levels) or 'no levels'}")
    return robot, levels[name]


def prepare(robot: str, class_path: str) -> None:
    """Import the driver of a column. Register it if it belongs to another package.

    A driver for another level is imported but not registered, so that the robot's name keeps its usual meaning in
    this process. A caller that commands the other level registers the driver itself.
    """
    if class_path:
        register(class_path, robot)
    else:
        name, level = column(robot)
        if class_of(level) is None:
            get_native_driver_class(name)


def carried(name: str) -> dict[str, Any]:
    """Return the option ``gripper`` in the name of a column. It is empty for a column without a gripper."""
    gripper = name.partition(CARRIES)[2]
    return {"gripper": gripper} if gripper else {}


def end_of(robot: str, driver_class: type | None, *, lowered: bool) -> dict[str, Any]:
    """Return the options of a robot in a trial that concern its end.

    An arm that can be lowered is limp at once in trials, as the other arms are. Its lowering has separate trials.

    Args:
        robot: The robot.
        driver_class: Its driver.
        lowered: True for the options of those trials.
    """
    if driver_class is None or not issubclass(driver_class, Driver) or not driver_class.is_lowered(robot):
        return {}
    return {"on_exit": "lower" if lowered else "limp"}
