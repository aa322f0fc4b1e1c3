"""The robots of a host, as its file describes them, and the faults of the file."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, NamedTuple

from strands_actors.caller.processes.plan import Plan
from strands_actors.caller.resolve.planning import plan

METRICS = "127.0.0.1:9464"
"""Address of the metrics by default."""


class Fault(NamedTuple):
    """A fault of the file. ``line`` is 0 if the whole file has the fault."""

    line: int
    text: str


class BadFleet(Exception):
    """The file has faults.

    Attributes:
        path: The file.
        faults: All faults, by their line.
    """

    def __init__(self, path: Path, faults: list[Fault]) -> None:
        self.path = path
        self.faults = sorted(faults)
        super().__init__(
            "\n".join(f"{path}{f':{fault.line}' if fault.line else ''}: {fault.text}" for fault in self.faults)
        )


@dataclass(frozen=True)
class RobotSpec:
    """One robot of the file.

    Attributes:
        name: Its name on this computer.
        type: Its type, such as ``so101``.
        keywords: Keywords of ``Robot``, with paths resolved and the mesh read.
        handle: Settings for the handles of scripts that attach themselves.
        adapter: Serial number of its USB adapter; empty if the file names none.
    """

    name: str
    type: str
    keywords: Mapping[str, Any] = field(default_factory=dict, repr=False)
    handle: Mapping[str, Any] = field(default_factory=dict)
    adapter: str = ""

    def plan(self) -> Plan:
        """Return a new plan of the robot. Raise as ``Robot`` does."""
        keywords = dict(self.keywords)
        mode = keywords.pop("mode", "real" if keywords.keys() & {"port", "transport"} else "sim")
        made = plan(self.type, mode, **{"id": self.name, **keywords})
        return replace(made, hosted=dict(self.handle))


@dataclass(frozen=True)
class Fleet:
    """A file without faults.

    Attributes:
        path: The file.
        robots: The robots, by name.
        services: The arguments of each service that the host runs, by name (see ``services``).
    """

    path: Path
    robots: Mapping[str, RobotSpec]
    services: Mapping[str, Mapping[str, Any]]
