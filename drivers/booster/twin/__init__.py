"""Simulate a T1 on its own DDS network: its onboard computer, its 23 motors, and its body in
MuJoCo.

Besides the control lines of every simulated robot it takes ``fall``, ``get-up``, ``mode NAME``,
``battery PERCENT`` and ``answer API STATUS``. ``answer GET_MODE 500`` makes a function of the
robot's service fail: it is answered with this status and not carried out. With ``nothing`` as the
status the function is carried out and not answered. The status ``-`` restores the normal behaviour.
"""

from __future__ import annotations

from strands_actors.drivers.booster.robots import model_of
from strands_actors.drivers.common.twin import WireLog, main_of

from .requests import REQUESTS, TOPICS
from .server import BoosterServer, BoosterTwinOptions

MODELLED = (TOPICS, REQUESTS)


def build(robot: str, options: BoosterTwinOptions, log: WireLog) -> BoosterServer:
    """Return the server of a robot of ``robots.toml``."""
    return BoosterServer(model_of(robot), log, options)


main = main_of(BoosterTwinOptions, build)
