"""Identify the driver and the code that made the decisions in a recording. A replay with other code may
decide differently, and must report that."""

from __future__ import annotations

import hashlib
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from strands_actors.contract import driver as contract
from strands_actors.contract.driver import Driver
from strands_actors.contract.loading import load
from strands_actors.contract.shown import shown
from strands_actors.drivers import MODEL, PLAIN, SIMULATION, get_native_driver_class
from strands_actors.supervisors import gate
from strands_actors.supervisors.instrument import Attached
from strands_actors.supervisors.loading import describe_driver
from strands_actors.supervisors.wire import messages, watchdog

from .errors import RecordingError

if TYPE_CHECKING:
    from .file import Info

SUFFIXES = (".py", ".toml")
OF_THIS_PACKAGE = (PLAIN, MODEL, SIMULATION)
"""Drivers that serve robots of other drivers: one of the drivers page, a model file, a simulation."""


def driver_class_of(description: dict[str, object]) -> type[Driver]:
    """Return the driver class that is registered here for a recorded robot.

    A class is never loaded because a file names it, since a file must not decide which code runs.

    Args:
        description: The robot and its driver, as the recording has them.

    Raises:
        RecordingError: The driver is not installed, or another driver is registered for the robot.
    """
    robot, named = str(description.get("robot")), description.get("class")
    if named in OF_THIS_PACKAGE:
        if named == SIMULATION:
            _require_registered(robot, description.get("options"))
        own: type[Driver] = load(named)
        return own
    registered = get_native_driver_class(robot)
    if registered is None or not issubclass(registered, Driver):
        raise RecordingError(f"no driver for {robot} is installed. Install the package that has it")
    class_name = describe_driver(registered, robot, "", {})["class"]
    if class_name != named:
        raise RecordingError(f"{robot} was recorded with the driver {named}, but here its driver is {class_name}")
    return registered


def _require_registered(robot: str, options: object) -> None:
    """Raise ``RecordingError`` unless the driver of the simulated robot is registered here under the same
    name."""
    simulated = options.get("class") if isinstance(options, Mapping) else None
    driver_class_of({"robot": robot, "class": simulated})


def build_driver(info: Info) -> Driver:
    return driver_from(info.attached)


def driver_from(attached: Attached) -> Driver:
    """Build the driver of a recorded robot.

    Raises:
        RecordingError: The driver is not installed, or it does not accept the recorded options.
    """
    description = attached.driver
    driver_class = driver_class_of(description)
    robot_type = str(description["robot"])
    try:
        return driver_class(robot_type, str(description["port"]), dict(description["options"]))
    except (KeyError, TypeError, ValueError, OSError) as error:
        raise RecordingError(
            f"the driver of {shown(robot_type)} does not accept the recorded options: {shown(error, 200)}"
        ) from error


def fingerprint(driver_class: type[Driver]) -> str:
    """Return a hash of the code that makes decisions (gate, watchdog and driver), as twelve hexadecimal
    digits."""
    digest = hashlib.sha256()
    for path in _sources(driver_class):
        digest.update(path.name.encode() + b"\0" + path.read_bytes() + b"\0")
    return digest.hexdigest()[:12]


def _sources(driver_class: type[Driver]) -> list[Path]:
    deciding = [Path(str(module.__file__)) for module in (contract, messages, watchdog)]
    deciding += sorted(Path(str(gate.__file__)).parent.glob("*.py"))
    home = Path(str(sys.modules[driver_class.__module__].__file__)).parent
    folders = [home]
    if (common := home.parent / "common") and driver_class.__module__.startswith("strands_actors.drivers."):
        folders.append(common)
    for folder in folders:
        deciding += sorted(path for path in folder.rglob("*") if path.suffix in SUFFIXES)
    return deciding
