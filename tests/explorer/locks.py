"""The locks of e-stops, kept in memory. They survive the end of a tree, as files on a disk do."""

from __future__ import annotations

from pathlib import Path
from typing import ClassVar

from strands_actors.supervisors.root.locks import Lock


class SimLocks:
    """Replaces ``Locks``. ``disk`` holds the locks of the present run."""

    disk: ClassVar[dict[str, str]] = {}

    def __init__(self, directory: Path, robot: str, port: str = "") -> None:
        self._robot = robot

    def find(self) -> Lock | None:
        by = self.disk.get(self._robot)
        return None if by is None else Lock(by, "then")

    def put(self, by: str) -> str:
        self.disk[self._robot] = by
        return "then"

    def lift(self) -> None:
        self.disk.pop(self._robot, None)
