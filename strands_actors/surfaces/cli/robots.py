"""``list`` and ``twin``: list the robots and their drivers, and serve a twin."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from strands_actors.caller.resolve.simulated import EXPERIMENTAL
from strands_actors.contract.driver import Driver
from strands_actors.contract.loading import load
from strands_actors.drivers import (
    canonical_name,
    get_native_driver_class,
    leader_name,
    lerobot_missing,
    list_driver_coverage,
    list_leaders,
    list_native_drivers,
)

from .errors import Problem


def show_robots(as_json: bool, every: bool) -> None:
    """Show the robots that have a driver on this machine.

    Args:
        as_json: Print JSON.
        every: Also show robots without a driver on this machine, with the project that has a driver.
    """
    drivers = list_native_drivers()
    rows: list[dict[str, Any]] = [
        {
            "robot": robot,
            "driver": drivers.get(robot),
            "coverage": list(coverage),
            "missing": lerobot_missing(robot) or None,
            "experimental": _experimental(robot) if robot in drivers else {},
        }
        for robot, coverage in list_driver_coverage().items()
    ]
    shown = [row for row in rows if every or _drivers_here(row)]
    if as_json:
        print(json.dumps({"robots": shown, "experimental": EXPERIMENTAL}))
        return
    from rich import box
    from rich.console import Console
    from rich.table import Table

    table = Table(box=box.SIMPLE_HEAD)
    for title in ("robot", "driver", "driven by"):
        table.add_column(title)
    for row in shown:
        by = _driven_by(row) if every else ", ".join(_drivers_here(row))
        table.add_row(str(row["robot"]), str(row["driver"] or "-"), by, style="" if _drivers_here(row) else "dim")
    console = Console()
    console.print(table)
    if not every and (hidden := len(rows) - len(shown)):
        console.print(f"{hidden} more are known by name and have no driver on this machine: --all shows them")
    for robot, experiments in (
        *((row["robot"], row["experimental"]) for row in shown),
        ("simulations", EXPERIMENTAL),
    ):
        for transport, reason in experiments.items():
            console.print(f"experimental: {robot}, {transport}: {reason}", highlight=False, markup=False)


def _experimental(robot: str) -> Mapping[str, str]:
    driver = get_native_driver_class(robot)
    return driver.EXPERIMENTAL if driver is not None else {}


def _drivers_here(row: Mapping[str, Any]) -> list[str]:
    """Return the names of the packages (such as LeRobot) with a driver for a robot on this machine."""
    return [each for each in row["coverage"] if each != "lerobot" or not row["missing"]]


def _driven_by(row: Mapping[str, Any]) -> str:
    """Return as text the packages with a driver for a robot on this machine, and how to install LeRobot if it
    is missing."""
    drivers = _drivers_here(row)
    lacking = [f"lerobot: {row['missing']}"] if row["missing"] else []
    return ", ".join([*drivers, *(f"({text})" for text in lacking)]) or "-"


def serve_twin(
    robot: str,
    port_file: Path,
    log: Path | None,
    fault: str | None,
    parent_fd: int | None,
    control: Path | None,
    options: list[str],
) -> None:
    """Run a simulated robot or leader, which a driver can connect to, until interrupted.

    Args:
        robot: The type of the robot or leader.
        port_file: The file to which the simulated robot writes its port or address.
        log: The file for all messages between the driver and the simulated robot, one JSON line each.
        fault: Name of a fault that the simulated robot has from the beginning, or ``name:servo`` with the
            number of the only servo that has the fault.
        parent_fd: A file descriptor of a pipe or socket. The simulated robot ends shortly after the other end
            of it was closed.
        control: The path of a socket that moves the simulated joints, as if by hand.
        options: Options of the simulated robot, each as a text ``name=value``.
    """
    leader = leader_name(robot)
    driver_class = get_native_driver_class(robot) if leader is None else list_leaders()[leader]
    if driver_class is None or not issubclass(driver_class, Driver):
        raise Problem(
            f"twin: no driver for {robot!r}. There are {', '.join([*list_native_drivers(), *list_leaders()])}"
        )
    if wrong := [text for text in options if "=" not in text]:
        raise Problem(f"twin: {wrong[0]!r} is not KEY=VALUE")
    name = leader or canonical_name(robot)
    if fault is not None:
        _check_fault(driver_class, name, fault)
    serve = load(driver_class.TWIN)
    keywords = {"options": dict(text.split("=", 1) for text in options)} if options else {}
    try:
        serve(
            name,
            port_file=str(port_file),
            log=None if log is None else str(log),
            fault=fault,
            parent_fd=parent_fd,
            control=None if control is None else str(control),
            **keywords,
        )
    except ValueError as refusal:
        raise Problem(f"twin: {refusal}") from refusal


def _check_fault(driver_class: type[Driver], name: str, fault: str) -> None:
    """Raise ``Problem`` if a fault names a servo that the robot does not have, because the fault would have no
    effect."""
    unit = fault.partition(":")[2]
    if not hasattr(driver_class, "SETUP") or not unit.isdecimal():
        return
    servos = sorted(driver_class(name, "", driver_class.resolve(name, {})).ids)
    if int(unit) not in servos:
        numbers = ", ".join(map(str, servos))
        raise Problem(
            f"twin: {name} has no servo {unit}. Use one of {numbers}, or no number for a fault of all servos"
        )
