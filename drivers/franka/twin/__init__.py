"""Simulate the robot's end of a Franka arm's wire: FCI 5 or 10 on TCP and UDP, with MuJoCo behind it.

Besides the control lines of every twin it takes ``reflex ERROR`` and ``mode MODE``, with the names
of ``protocol.ERRORS`` and ``protocol.RobotMode``, and ``success-rate NUMBER|measured``.
"""

from __future__ import annotations

import gc
from collections.abc import Mapping
from typing import Annotated, Any, Unpack

from strands_actors.contract.options import option
from strands_actors.drivers.common.twin import HostOption, Start, WireLog, read_twin_options, run_server
from strands_actors.drivers.franka.arms import arm_of
from strands_actors.drivers.franka.protocol import DIALECTS

from .server import FrankaServer


class FrankaTwinOptions(HostOption, frozen=True):
    """The port is fixed."""

    fci: Annotated[int | None, option("version of the interface, 5 or 10; None: the arm's")] = None
    tick_wait_ms: Annotated[
        float,
        option(
            "how long a millisecond of a motion may be stretched until its command comes; 1 is real time, as on a "
            "machine of its own",
            gt=0,
        ),
    ] = 10.0


def main(robot: str, *, options: Mapping[str, Any] | None = None, **start: Unpack[Start]) -> None:
    """Serve an arm of ``robots.toml`` until interrupted (see ``common.twin.run``)."""
    given = read_twin_options(robot, FrankaTwinOptions, options)
    fci = arm_of(robot).fci if given.fci is None else given.fci
    if fci not in DIALECTS:
        raise ValueError(f"fci is {fci}. There are {', '.join(map(str, DIALECTS))}")
    gc.collect()
    gc.freeze()  # A full collection would be a pause of many cycles.

    def build(wire_log: WireLog) -> FrankaServer:
        return FrankaServer(robot, fci, wire_log, given.host, given.tick_wait_ms / 1e3)

    run_server(build, **start)
