"""The robots of a wire, as data: the ``robots.toml`` beside its driver."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from importlib import resources
from typing import Any


class RobotTables:
    """``package``: where the file is; ``wire``: its name for people."""

    def __init__(self, package: str, wire: str, followers: RobotTables | None = None) -> None:
        """``followers``: these are their leaders, ``leaders.toml``."""
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
        """Other names a robot answers to -> its name."""

    def canonical(self, robot: str) -> str:
        """Return the name of ``robot``'s table. Raise ``ValueError`` for a robot that is not of
        this wire."""
        name = self.aliases.get(robot, robot)
        if name not in self.robots:
            raise ValueError(f"{robot} is not a {self._wire} robot. Use one of {', '.join(self.robots)}")
        return name

    def table(self, robot: str) -> Mapping[str, Any]:
        """By name or alias. Raise ``ValueError``."""
        return self.robots[self.canonical(robot)]


def _leader(table: Mapping[str, Any], follower: Mapping[str, Any]) -> dict[str, Any]:
    """Return a leader as its follower is, but for what its own table says: of the robot, and under
    ``every_joint`` of all its joints."""
    joints = [{**joint, **table.get("every_joint", {})} for joint in follower["joints"]]
    return {**follower, "aliases": (), **table, "joints": joints}
