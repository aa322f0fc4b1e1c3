"""Simulate a Franka arm with its controller (a "twin"): FCI 5 or 10 on TCP and UDP, and MuJoCo for the arm.

A test controls a simulated robot by lines of text. This robot accepts the lines of every twin, and also ``reflex
ERROR``, ``mode MODE`` and ``success-rate NUMBER|measured``. The names are in ``protocol.ERRORS`` and
``protocol.RobotMode``. With a hand there are also ``gripper lost|found|homed|unhomed``, and ``object PERCENT|none``
for something between the fingers, which meet it when they are so far open.
"""

from __future__ import annotations

import gc
from typing import Annotated

from strands_actors.contract.options import option
from strands_actors.drivers.common.twin import HostOption, WireLog, main_of
from strands_actors.drivers.franka.arms import arm_of
from strands_actors.drivers.franka.grippers import Gripper
from strands_actors.drivers.franka.protocol import DIALECTS

from .hand import REQUESTS
from .pace import Stretches
from .requests import MODELLED as OF_THE_ARM
from .server import FrankaServer

MODELLED = (*OF_THE_ARM, REQUESTS)


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
    gripper: Annotated[Gripper | None, option("the hand on its flange, with its service; None: no hand")] = None


def build(robot: str, options: FrankaTwinOptions, log: WireLog) -> FrankaServer:
    """Return the server of an arm of ``robots.toml``. Raise ``ValueError`` for an unknown version of the
    interface."""
    fci = arm_of(robot).fci if options.fci is None else options.fci
    if fci not in DIALECTS:
        raise ValueError(f"fci is {fci}. Use one of {', '.join(map(str, DIALECTS))}")
    gc.collect()
    gc.freeze()  # A full garbage collection would stop this process for many milliseconds.
    wait_s = options.tick_wait_ms / 1e3
    return FrankaServer(
        robot,
        fci,
        log,
        options.host,
        wait_s,
        options.stretches,
        options.states_from,
        options.gripper or "",
    )


main = main_of(FrankaTwinOptions, build)

__all__ = ["MODELLED", "FrankaServer", "FrankaTwinOptions", "build", "main"]
