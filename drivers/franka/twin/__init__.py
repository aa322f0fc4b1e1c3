"""Simulate a Franka arm with its controller (a "twin"): FCI 5 or 10 on TCP and UDP, and MuJoCo for the arm.

A test controls a simulated robot by lines of text. This robot accepts the lines of every twin, and also ``reflex
ERROR``, ``mode MODE`` and ``success-rate NUMBER|measured``. The names are in ``protocol.ERRORS`` and
``protocol.RobotMode``.
"""

from __future__ import annotations

import gc
from typing import Annotated

from strands_actors.contract.options import option
from strands_actors.drivers.common.twin import HostOption, WireLog, main_of
from strands_actors.drivers.franka.arms import arm_of
from strands_actors.drivers.franka.protocol import DIALECTS

from .pace import Stretches
from .requests import MODELLED
from .server import FrankaServer


class FrankaTwinOptions(HostOption, frozen=True):
    """The options of a simulated Franka arm. Its TCP port is always 1337, as on a real controller."""

    fci: Annotated[int | None, option("version of the interface, 5 or 10; None: the arm's")] = None
    tick_wait_ms: Annotated[
        float, option("longest stretch of a millisecond of a motion, until its command comes; 1 is real time", gt=0)
    ] = 10.0
    stretches: Annotated[
        Stretches,
        option("when a millisecond of a motion may be stretched: while all processors are busy, always, or never"),
    ] = "busy"
    states_from: Annotated[
        str | None, option("address that its states come from; None: the one that it serves at")
    ] = None


def build(robot: str, options: FrankaTwinOptions, log: WireLog) -> FrankaServer:
    """Return the server of an arm of ``robots.toml``. Raise ``ValueError`` for an unknown version of the
    interface."""
    fci = arm_of(robot).fci if options.fci is None else options.fci
    if fci not in DIALECTS:
        raise ValueError(f"fci is {fci}. Use one of {', '.join(map(str, DIALECTS))}")
    gc.collect()
    gc.freeze()  # A full garbage collection would stop this process for many milliseconds.
    wait_s = options.tick_wait_ms / 1e3
    return FrankaServer(robot, fci, log, options.host, wait_s, options.stretches, options.states_from)


main = main_of(FrankaTwinOptions, build)

__all__ = ["MODELLED", "FrankaServer", "FrankaTwinOptions", "build", "main"]
