"""A Stretch as a twin: every board on a port of its own, and a robot that drives on a floor."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Unpack

from strands_actors.drivers.common.twin import Start, WireLog, known_options, run_server
from strands_actors.drivers.stretch.robots import TABLES

from .server import StretchServer
from .world import World

OPTIONS = {"folder": "where the folder of ports appears (default: a temporary directory)"}


def main(robot: str, *, options: Mapping[str, Any] | None = None, **start: Unpack[Start]) -> None:
    """Serve a robot of ``robots.toml`` until interrupted (see ``common.twin.run``). More control
    lines: see ``StretchServer.order``."""
    given = known_options(options, OPTIONS)
    world = World(TABLES.canonical(robot))

    def build(wire_log: WireLog) -> StretchServer:
        return StretchServer(world, wire_log, given.get("folder"))

    run_server(build, **start)


__all__ = ["StretchServer", "World", "main"]
