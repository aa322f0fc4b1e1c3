"""The client for a Crazyflie: Bitcraze's cflib, with a drone that flies. cflib is under the GPL, so it has a
separate environment.
"""

from __future__ import annotations

import tempfile
import time

import cflib.crtp
from cflib.crazyflie import Crazyflie
from cflib.crazyflie.syncCrazyflie import SyncCrazyflie

from .hand import BaseClient, wave

SPEED_M_S = 0.2
HEIGHT_M = 0.5
TAKEOFF_S = 2.0
PERIOD_S = 0.05


class Client(BaseClient):
    """The client. Its stop is the one of cflib's ``MotionCommander``: the drone hovers with speed zero."""

    def __init__(self, robot: str, port: str) -> None:
        cflib.crtp.init_drivers()
        self._link = SyncCrazyflie(f"udp://{port}", cf=Crazyflie(rw_cache=tempfile.mkdtemp(prefix="sa-")))
        self._link.open_link()
        self._link.wait_for_params()
        self._crazyflie = self._link.cf
        self._crazyflie.supervisor.send_arming_request(True)
        time.sleep(0.1)
        began_s = time.monotonic()
        while time.monotonic() < began_s + TAKEOFF_S:
            self._hover(0.0)
            time.sleep(PERIOD_S)

    def _hover(self, forward_m_s: float) -> None:
        self._crazyflie.commander.send_hover_setpoint(forward_m_s, 0, 0, HEIGHT_M)

    def setpoint(self, number: int) -> int:
        began_ns = time.monotonic_ns()
        self._hover(SPEED_M_S * wave(number))
        return began_ns

    def stop(self) -> None:
        self._hover(0.0)
