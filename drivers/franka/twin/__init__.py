"""The robot's end of a Franka arm's wire: FCI 5 or 10 on TCP and UDP, MuJoCo behind it.

Besides the control lines of every twin it takes ``reflex ERROR`` and ``mode MODE``, with the names
of ``protocol.ERRORS`` and ``protocol.RobotMode``, and ``success-rate NUMBER|measured``.
"""

from __future__ import annotations

import gc
from collections.abc import Mapping
from typing import Any, Unpack

from strands_actors.drivers.common.twin import Start, WireLog, known_options, run_server
from strands_actors.drivers.franka.arms import arm_of
from strands_actors.drivers.franka.protocol import DIALECTS

from .server import FrankaServer

OPTIONS = {
    "fci": "version of the interface, 5 or 10 (default: the arm's)",
    "host": "address to serve at (default: one of its own in 127.0.0.0/8; the port is fixed)",
    "tick_wait_ms": "how long a millisecond of a motion may be stretched until its command comes; 1 is real time, "
    "as on a machine of its own (default 10)",
}


def main(robot: str, *, options: Mapping[str, Any] | None = None, **start: Unpack[Start]) -> None:
    """Serve an arm of ``robots.toml`` until interrupted (see ``common.twin.run``)."""
    given = known_options(options, OPTIONS)
    fci = int(given.get("fci", arm_of(robot).fci))
    if fci not in DIALECTS:
        raise ValueError(f"fci is {fci}. There are {', '.join(map(str, DIALECTS))}")
    tick_wait_s = float(given.get("tick_wait_ms", 10.0)) / 1e3
    gc.collect()
    gc.freeze()  # a full collection would be a pause of many cycles

    def build(wire_log: WireLog) -> FrankaServer:
        return FrankaServer(robot, fci, wire_log, given.get("host"), tick_wait_s)

    run_server(build, **start)
