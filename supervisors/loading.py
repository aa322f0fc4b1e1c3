"""Pass a driver between processes as plain data, and build it in each of them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from strands_actors.contract.driver import Candidate, Driver, GateCheck, GateState
from strands_actors.contract.fallbacks import check_conditions, check_fallbacks
from strands_actors.contract.loading import load, place_of
from strands_actors.kernel.messages import Refused

from . import refusals

OURS = "strands_actors."


def describe_driver(driver_class: type[Driver], robot: str, port: str, options: dict[str, Any]) -> dict[str, Any]:
    return {"class": place_of(driver_class), "robot": robot, "port": port, "options": options}


def without_secrets(description: dict[str, Any], driver_class: type[Driver]) -> dict[str, Any]:
    """Return the description of a driver without passwords and other secrets, for a recorder."""
    options = {name: value for name, value in description["options"].items() if name not in driver_class.SECRETS}
    return {**description, "options": options}


def build_driver(driver_class: type[Driver], robot: str, port: str, options: Mapping[str, Any]) -> Driver:
    """Build the driver of a robot and check it.

    Raises:
        ValueError: The driver declares no safe state for some reason of a stop, or an unknown safe state.
    """
    driver = driver_class(robot, port, options)
    driver.fallbacks = check_fallbacks(driver.robot, driver.fallbacks)
    driver.conditions = check_conditions(driver.robot, driver.conditions)
    return driver


def load_driver(description: dict[str, Any]) -> Driver:
    """Build the driver from its description, and import the modules that it needs."""
    driver_class = load(description["class"])
    driver = build_driver(driver_class, description["robot"], description["port"], description["options"])
    if "drill" in description:
        driver.gates = (requires_drill(**description["drill"]), *driver.gates)
    driver.preload()
    return driver


def import_ours(description: dict[str, Any]) -> None:
    """Import the modules that ``load_driver`` needs, if the driver is part of this package.

    A process calls this before it forks, so that its children start about twice as fast. Modules of other packages
    are not imported here, since they may start threads, and a process with threads must not fork.
    """
    if description["class"].startswith(OURS):
        load_driver(description)


def requires_drill(until_ns: int, reason: str, remedy: str) -> GateCheck:
    """Return a check that refuses every setpoint from ``until_ns`` on, because the robot has no valid certificate
    of a stop drill."""

    def requires_drill(candidate: Candidate, state: GateState) -> Refused | None:
        return None if state.now_ns < until_ns else refusals.no_drill(reason, remedy)

    return requires_drill
