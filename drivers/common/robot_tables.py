"""The robots of a wire, as data: the ``robots.toml`` beside its driver."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from importlib import resources
from typing import Any


class RobotTables:
    """``package``: where the file is; ``wire``: its name for people."""

    def __init__(self, package: str, wire: str) -> None:
        self._wire = wire
        self.robots: Mapping[str, Mapping[str, Any]] = tomllib.loads(
            resources.files(package).joinpath("robots.toml").read_text("utf-8")
        )
        self.aliases: Mapping[str, str] = {
            alias: name for name, table in self.robots.items() for alias in table.get("aliases", ())
        }
        """Other names a robot answers to -> its name."""

    def canonical(self, robot: str) -> str:
        """The name of ``robot``'s table. Raise ``ValueError`` for a robot that is not of this
        wire."""
        name = self.aliases.get(robot, robot)
        if name not in self.robots:
            raise ValueError(f"{robot} is not a {self._wire} robot. Use one of {', '.join(self.robots)}")
        return name

    def table(self, robot: str) -> Mapping[str, Any]:
        """By name or alias. Raise ``ValueError``."""
        return self.robots[self.canonical(robot)]
