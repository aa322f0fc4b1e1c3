"""Load the ``robots.toml`` beside a driver: the data of all robots that the driver supports."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from importlib import resources
from typing import Any


class RobotTables:
    """The tables of all robots of one driver (``robots.toml``), or of all its leader arms (``leaders.toml``),
    which a person moves by hand."""

    def __init__(self, package: str, wire: str, followers: RobotTables | None = None) -> None:
        """Read the file.

        Args:
            package: The package that holds the file.
            wire: The name of the robot family, for messages.
            followers: The follower arms, to read their leader arms from ``leaders.toml``. The default reads
                ``robots.toml``.
        """
        self._wire = wire
        file = "robots.toml" if followers is None else "leaders.toml"
        tables: Mapping[str, Mapping[str, Any]] = tomllib.loads(
            resources.files(package).joinpath(file).read_text("utf-8")
        )
        self.robots: Mapping[str, Mapping[str, Any]] = (
            tables
            if followers is None
            else {name: _leader(table, followers.robots[table["follower"]]) for name, table in tables.items()}
        )
        self.aliases: Mapping[str, str] = {
            alias: name for name, table in self.robots.items() for alias in table.get("aliases", ())
        }
        """Each other name of a robot, with the name of its table."""

    def canonical(self, robot: str) -> str:
        """Return the name under which the robot's table is stored.

        Raises:
            ValueError: The file has no such robot.
        """
        name = self.aliases.get(robot, robot)
        if name not in self.robots:
            raise ValueError(f"{robot} is not a {self._wire} robot. Use one of {', '.join(self.robots)}")
        return name

    def table(self, robot: str) -> Mapping[str, Any]:
        """Return the table of a robot, by its name or an alias.

        Raises:
            ValueError: The file has no such robot.
        """
        return self.robots[self.canonical(robot)]


def _leader(table: Mapping[str, Any], follower: Mapping[str, Any]) -> dict[str, Any]:
    """Return the table of a leader arm: its follower's table, with the entries of the leader's table in place of
    the follower's. The entries of ``every_joint`` apply to each joint."""
    joints = [{**joint, **table.get("every_joint", {})} for joint in follower["joints"]]
    return {**follower, "aliases": (), **table, "joints": joints}
