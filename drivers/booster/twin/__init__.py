"""Simulate a T1 on its own DDS network: its onboard computer, its 23 motors, and its body in
MuJoCo.

Besides the control lines of every simulated robot it takes ``fall``, ``get-up``, ``mode NAME``,
``battery PERCENT`` and ``answer API STATUS``. ``answer GET_MODE 500`` makes a function of the
robot's service fail: it is answered with this status and not carried out. With ``nothing`` as the
status the function is carried out and not answered. The status ``-`` restores the normal behaviour.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Unpack

from strands_actors.drivers.booster.robots import model_of
from strands_actors.drivers.common.twin import Start, WireLog, read_twin_options, run_server

from .requests import REQUESTS, TOPICS
from .server import BoosterServer, BoosterTwinOptions

MODELLED = (TOPICS, REQUESTS)


def main(robot: str, *, options: Mapping[str, Any] | None = None, **start: Unpack[Start]) -> None:
    """Simulate a robot of ``robots.toml`` until interrupted (see ``common.twin.run``)."""
    twin_options = read_twin_options(robot, BoosterTwinOptions, options)
    model = model_of(robot)

    def build(wire_log: WireLog) -> BoosterServer:
        return BoosterServer(model, wire_log, twin_options)

    run_server(build, **start)
