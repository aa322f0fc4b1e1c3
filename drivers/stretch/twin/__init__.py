"""Simulate a Stretch: every board on its own port, and a robot that drives on a floor."""

from __future__ import annotations

from typing import Annotated

from strands_actors.contract.options import option
from strands_actors.drivers.common.dynamixel.twin import INSTRUCTIONS
from strands_actors.drivers.common.twin import TwinOptions, WireLog, main_of
from strands_actors.drivers.stretch.robots import TABLES

from .calls import PIMU_CALLS, STEPPER_CALLS, STEPPER_MODES, WACC_CALLS
from .server import StretchServer
from .world import World

MODELLED = (STEPPER_CALLS, STEPPER_MODES, PIMU_CALLS, WACC_CALLS, INSTRUCTIONS)


class StretchTwinOptions(TwinOptions, frozen=True):
    folder: Annotated[str | None, option("where the folder of ports appears; None: a temporary one")] = None


def build(robot: str, options: StretchTwinOptions, log: WireLog) -> StretchServer:
    """Return the server of a robot of ``robots.toml``. For its control lines see ``StretchServer.order``."""
    return StretchServer(World(TABLES.canonical(robot)), log, options.folder)


main = main_of(StretchTwinOptions, build)

__all__ = ["MODELLED", "StretchServer", "World", "build", "main"]
