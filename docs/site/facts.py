"""Read the figures of the robots' pages: from the drivers, the README and the kill matrix.

A new robot needs the name of its product in ``robots.toml`` of this package and a row in the README. Its driver has
everything else.
"""

from __future__ import annotations

import enum
import functools
import inspect
import re
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

from strands_actors.contract.driver import Driver
from strands_actors.contract.loading import load
from strands_actors.contract.short_names import SHORT_NAMES
from strands_actors.drivers import WIRES, get_native_driver_class
from strands_actors.supervisors.loading import build_driver
from strands_actors.testing import matrix_page

from .build import ROOT

TABLE = Path(__file__).with_name("robots.toml")


class Level(NamedTuple):
    """One way to command a robot. Most robots have one."""

    name: str
    """The value of the option ``level``; empty for the only or usual way."""
    driver: Driver


class Wire(NamedTuple):
    """The protocol of a robot, as the README's table of robots names it."""

    text: str
    tested_with: str
    """Names of the clients that drive its twin, with commas; "–" if there are none."""
    page: str
    """The path of its page in ``docs/``."""


class Client(NamedTuple):
    """A client of others that a test runs unchanged against a twin."""

    name: str
    version: str
    test: str
    """The path of the test in the repository."""
    robots: tuple[str, ...]
    """The robots of the twins in the test."""
    others: bool
    """False if it cannot drive the other robots of the same driver."""


def robots() -> list[str]:
    """Return the names of all robots that have a driver of this package, sorted."""
    return sorted(name for location in WIRES.values() for name in load(location).SUPPORTED_ROBOTS)


@functools.cache
def _table() -> dict[str, Any]:
    return tomllib.loads(TABLE.read_text())


def product(robot: str) -> str:
    """Return the name of the product.

    Raises:
        KeyError: ``robots.toml`` of this package has no name for the robot.
    """
    return str(_table()["names"][robot])


def driver_class(robot: str) -> type[Driver]:
    """Return the class of a robot's driver."""
    found = get_native_driver_class(robot)
    assert found is not None and issubclass(found, Driver), robot
    return found


@functools.cache
def levels(robot: str) -> tuple[Level, ...]:
    """Return the ways to command a robot, the usual one first."""
    usual = driver_class(robot)
    names = ("", *(key.partition(":")[2] for key in usual.LEVELS if key.partition(":")[0] == robot))
    return tuple(Level(name, _built(robot, {"level": name} if name else {})) for name in names)


def _built(robot: str, options: Mapping[str, Any]) -> Driver:
    """Return a driver with its default options. It opens nothing."""
    chosen = driver_class(robot).for_level(robot, options)
    return build_driver(chosen, robot, "", chosen.resolve(robot, options))


def aliases(robot: str) -> list[str]:
    """Return the other names of a robot, sorted."""
    names = {**SHORT_NAMES, **driver_class(robot).ALIASES}
    return sorted(name for name, meant in names.items() if meant == robot)


@functools.cache
def _wires() -> dict[str, Wire]:
    rows = re.findall(
        r"^\|(?: <img [^>]+> \|)? (`[^|]+`) \| ([^|]+) \| ([^|]+) \| \[[^]]+\]\(docs/([^)]+)\) \|$",
        (ROOT / "README.md").read_text(),
        re.M,
    )
    return {
        name: Wire(text, tested_with, page)
        for names, text, tested_with, page in rows
        for name in re.findall(r"`(\w+)`", names)
    }


def wire(robot: str) -> Wire:
    """Return the protocol of a robot.

    Raises:
        KeyError: The table of robots in the README lacks the robot.
    """
    return _wires()[robot]


# -- clients


def _version(client: str) -> str:
    """Return the version that a test runs; empty if none is pinned."""
    pinned = re.compile(rf"(?<![\w-]){re.escape(client)}==([\d.]*\d)")
    for path in (ROOT / "pyproject.toml", *sorted((ROOT / "tests" / "drivers").rglob("*.py"))):
        if found := pinned.search(path.read_text()):
            return found[1]
    return ""


@functools.cache
def clients() -> tuple[Client, ...]:
    """Return the clients of others that drive a twin unchanged."""
    return tuple(
        Client(row["name"], _version(row["name"]), row["test"], tuple(row["robots"]), row.get("others", True))
        for row in _table()["clients"]
    )


def clients_of(robot: str) -> list[Client]:
    """Return the clients that drive the twin of a robot, or of another robot with the same driver."""
    same = driver_class(robot)
    return [
        client
        for client in clients()
        if robot in client.robots or (client.others and same in map(driver_class, client.robots))
    ]


# -- meanings


@functools.cache
def comments(words: type[enum.StrEnum]) -> dict[str, str]:
    """Return the comment that stands behind each member of an enum in its source; empty without one."""
    lines = re.findall(r'^\s+[A-Z_]+ = "(\w+)"(?:\s+# (.+))?$', inspect.getsource(words), re.MULTILINE)
    return dict(lines)


# -- kill matrix


@functools.cache
def matrix() -> matrix_page.Columns:
    """Return the measured times from a fault to the safe state, by robot."""
    return matrix_page.load(ROOT / "docs" / "kill-matrix.json")


def measured_like(robot: str) -> list[str]:
    """Return the robots of the kill matrix that have the driver of this robot: the robot itself, if it is there."""
    if robot in matrix():
        return [robot]
    return [other for other in matrix() if ":" not in other and driver_class(other) is driver_class(robot)]
