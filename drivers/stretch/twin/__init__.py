"""Simulate a Stretch: every board on its own port, and a robot that drives on a floor."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Unpack

from strands_actors.contract.options import option
from strands_actors.drivers.common.dynamixel.twin import INSTRUCTIONS
from strands_actors.drivers.common.twin import Start, TwinOptions, WireLog, read_twin_options, run_server
from strands_actors.drivers.stretch.robots import TABLES

from .calls import PIMU_CALLS, STEPPER_CALLS, STEPPER_MODES, WACC_CALLS
from .server import StretchServer
from .world import World

MODELLED = (STEPPER_CALLS, STEPPER_MODES, PIMU_CALLS, WACC_CALLS, INSTRUCTIONS)


class StretchTwinOptions(TwinOptions, frozen=True):
    folder: Annotated[str | None, option("where the folder of ports appears; None: a temporary one")] = None


def main(robot: str, *, options: Mapping[str, Any] | None = None, **start: Unpack[Start]) -> None:
    """Simulate a robot of ``robots.toml`` until interrupted (see ``common.twin.run``). For its control lines
    see ``StretchServer.order``."""
    settings = read_twin_options(robot, StretchTwinOptions, options)
    world = World(TABLES.canonical(robot))

    def build(wire_log: WireLog) -> StretchServer:
        return StretchServer(world, wire_log, settings.folder)

    run_server(build, **start)


__all__ = ["MODELLED", "StretchServer", "World", "main"]
