"""The robots of a wire as data: the ``robots.toml`` beside its driver."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from importlib import resources
from typing import Any


class RobotTables:
    """The tables of all robots of a wire, or of all its leader arms."""

    def __init__(self, package: str, wire: str, followers: RobotTables | None = None) -> None:
        """Read the file.

        Args:
            package: The package that holds the file.
            wire: The name of the wire for people.
            followers: The tables of the followers, to read the leaders from ``leaders.toml``. The
                default reads ``robots.toml``.
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
        """Return the name of the robot's table.

        Raises:
            ValueError: The robot is not of this wire.
        """
        name = self.aliases.get(robot, robot)
        if name not in self.robots:
            raise ValueError(f"{robot} is not a {self._wire} robot. Use one of {', '.join(self.robots)}")
        return name

    def table(self, robot: str) -> Mapping[str, Any]:
        """Return the table of a robot, by name or alias.

        Raises:
            ValueError: The robot is not of this wire.
        """
        return self.robots[self.canonical(robot)]


def _leader(table: Mapping[str, Any], follower: Mapping[str, Any]) -> dict[str, Any]:
    """Return a leader's table: that of its follower, changed by its own entries. Its ``every_joint`` changes
    all joints."""
    joints = [{**joint, **table.get("every_joint", {})} for joint in follower["joints"]]
    return {**follower, "aliases": (), **table, "joints": joints}
