"""Run a T1 on its own DDS network: its computer, a MuJoCo body, 23 motors.

Besides the control lines of every twin it takes ``fall``, ``get-up``, ``mode NAME``,
``battery PERCENT`` and ``answer API STATUS``. The last one sets the status with which a function is
answered without being carried out (``answer GET_MODE 500``). With ``nothing`` it is carried out and
not answered; ``-`` restores the normal behaviour.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Unpack

from strands_actors.drivers.booster.robots import model_of
from strands_actors.drivers.common.twin import Start, WireLog, read_twin_options, run_server

from .server import BoosterServer, BoosterTwinOptions


def main(robot: str, *, options: Mapping[str, Any] | None = None, **start: Unpack[Start]) -> None:
    """Serve a robot of ``robots.toml`` until interrupted (see ``common.twin.run``)."""
    given = read_twin_options(robot, BoosterTwinOptions, options)
    model = model_of(robot)

    def build(wire_log: WireLog) -> BoosterServer:
        return BoosterServer(model, wire_log, given)

    run_server(build, **start)
