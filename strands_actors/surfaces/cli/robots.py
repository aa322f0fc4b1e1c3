"""``list`` and ``twin``: list the robots and their drivers, and serve a twin."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from strands_actors.caller.resolve.simulated import EXPERIMENTAL
from strands_actors.contract.driver import Driver
from strands_actors.contract.loading import load
from strands_actors.drivers import (
    canonical_name,
    driver_name,
    get_native_driver_class,
    leader_name,
    lerobot_missing,
    list_driver_coverage,
    list_leaders,
    list_native_drivers,
    register_own_table,
)

from .errors import Problem
from .packages import missing_extras

OURS = "strands_actors.drivers"
ORDERS = ".orders"
"""The end of the name of the socket for orders to a twin, beside its port file."""
SEND_ORDER = "strands_actors.drivers.common.twin.orders:send_order"


def show_robots(as_json: bool, every: bool) -> None:
    """Show the robots that have a driver on this machine, and the extras that are not installed.

    Args:
        as_json: Print JSON.
        every: Also show robots without a driver on this machine, with the project that has a driver.
    """
    rows = [_row(robot, coverage) for robot, coverage in list_driver_coverage().items()]
    shown = [row for row in rows if every or _drivers_here(row)]
    absent = missing_extras()
    if as_json:
        print(json.dumps({"robots": shown, "experimental": EXPERIMENTAL, "not_installed": absent}))
        return
    from rich import box
    from rich.console import Console
    from rich.table import Table

    table = Table(box=box.SIMPLE_HEAD)
    for title in ("robot", "wire", "port", "twin", "driven by"):
        table.add_column(title)
    for row in shown:
        by = _driven_by(row) if every else ", ".join(_drivers_here(row))
        cells = (row["robot"], row["wire"] or "-", row["port"] or "-", "yes" if row["twin"] else "-", by)
        table.add_row(*map(str, cells), style="" if _drivers_here(row) else "dim")
    console = Console()
    console.print(table)
    if not every:
        for line in _hidden(rows):
            console.print(line, highlight=False, markup=False)
    for robot, experiments in (
        *((row["robot"], row["experimental"]) for row in shown),
        ("simulations", EXPERIMENTAL),
    ):
        for transport, reason in experiments.items():
            console.print(f"experimental: {robot}, {transport}: {reason}", highlight=False, markup=False)
    for extra, command in absent.items():
        console.print(f"extra {extra} is not installed: {command}", highlight=False, markup=False)


def _row(robot: str, coverage: Sequence[str]) -> dict[str, Any]:
    driver_class = get_native_driver_class(robot)
    driver = (
        driver_class if driver_class is not None and issubclass(driver_class, Driver) else None
    )  # a user's plain class has no wire
    return {
        "robot": robot,
        "driver": None if driver_class is None else driver_name(driver_class),
        "wire": None if driver is None else _wire_of(driver),
        "port": None if driver is None else driver.PORT_KIND,
        "twin": hasattr(driver, "TWIN"),
        "coverage": list(coverage),
        "missing": lerobot_missing(robot) or None,
        "experimental": {} if driver is None else driver.EXPERIMENTAL,
    }


def _wire_of(driver: type[Driver]) -> str:
    """Return the folder of a driver of this package, or the package of another driver."""
    return driver.__module__.removeprefix(f"{OURS}.").partition(".")[0]


def _hidden(rows: Sequence[Mapping[str, Any]]) -> Iterator[str]:
    """Yield a line about the robots that need LeRobot, and one about those that nothing drives."""
    by_lerobot = sum(bool(row["coverage"]) and not _drivers_here(row) for row in rows)
    undriven = sum(not row["coverage"] for row in rows)
    if by_lerobot:
        yield f"{by_lerobot} more are driven by LeRobot, which is not installed: --all shows them"
    if undriven:
        yield f"{undriven} more are known by name and have no driver: --all shows them"


def _drivers_here(row: Mapping[str, Any]) -> list[str]:
    """Return the names of the packages (such as LeRobot) with a driver for a robot on this machine."""
    return [each for each in row["coverage"] if each != "lerobot" or not row["missing"]]


def _driven_by(row: Mapping[str, Any]) -> str:
    """Return as text the packages with a driver for a robot on this machine, and how to install LeRobot if it
    is missing."""
    drivers = _drivers_here(row)
    lacking = [f"lerobot: {row['missing']}"] if row["missing"] else []
    return ", ".join([*drivers, *(f"({text})" for text in lacking)]) or "-"


def driver_of_twin(robot: str) -> tuple[str, type[Driver]]:
    """Return the canonical name and the driver of a robot or leader. Raise ``Problem`` if it has no driver."""
    leader = leader_name(robot)
    driver_class = get_native_driver_class(robot) if leader is None else list_leaders()[leader]
    if driver_class is None or not issubclass(driver_class, Driver):
        raise Problem(
            f"twin: no driver for {robot!r}. There are {', '.join([*list_native_drivers(), *list_leaders()])}"
        )
    return leader or canonical_name(robot), driver_class


def serve_twin(
    robot: str,
    port_file: Path,
    log: Path | None,
    fault: str | None,
    parent_fd: int | None,
    control: Path | None,
    options: list[str],
    takes_orders: bool = False,
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
        takes_orders: Let ``order_twin`` change the running robot.
    """
    if wrong := [text for text in options if "=" not in text]:
        raise Problem(f"twin: {wrong[0]!r} is not KEY=VALUE")
    given = dict(text.split("=", 1) for text in options)
    register_own_table(robot, given)
    name, driver_class = driver_of_twin(robot)
    if fault is not None:
        _check_fault(driver_class, name, fault)
    serve = load(driver_class.TWIN)
    keywords: dict[str, Any] = {"options": given} if given else {}
    if takes_orders:
        keywords["orders"] = f"{port_file}{ORDERS}"
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


def order_twin(port_file: Path, words: list[str]) -> None:
    """Send a control line, such as ``unplug``, to a running twin.

    Args:
        port_file: The file with the twin's port.
        words: The words of the line.

    Raises:
        Problem: No twin runs, or it does not know the line.
    """
    try:
        problem = load(SEND_ORDER)(f"{port_file}{ORDERS}", " ".join(words))
    except OSError as failure:
        raise Problem(
            f"twin-order: no twin takes orders at {port_file} ({failure.strerror or failure}). Start one: "
            f"strands-actors twin so101 --port-file {port_file}"
        ) from failure
    if problem:
        raise Problem(f"twin-order: {problem}")


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
