"""The client panda-python, which contains libfranka 0.9."""

from __future__ import annotations

import threading
import time

import panda_py
from panda_py import libfranka

from .hand import BaseClient, wave

STEP_RAD = 0.03
FAR_RAD = 1.0


class Client(BaseClient):
    """The client. A call moves the arm to its goal, and returns when the arm has reached it."""

    def __init__(self, robot: str, port: str) -> None:
        self._panda = panda_py.Panda(port.partition(":")[0], realtime_config=libfranka.RealtimeConfig.kIgnore)
        self._base = list(self._panda.q)

    def _go(self, far: float) -> int:
        goal = [self._base[0] + far, *self._base[1:]]
        began_ns = time.monotonic_ns()
        self._panda.move_to_joint_position(goal, speed_factor=0.2)
        return began_ns

    def setpoint(self, number: int) -> int:
        return self._go(STEP_RAD * wave(number))

    def move(self, number: int) -> None:
        self._go(-FAR_RAD if self._base[0] > 0 else FAR_RAD)

    def stop(self) -> None:
        self._panda.get_robot().stop()

    def again(self) -> None:
        self._base = list(self._panda.get_state().q)

    def stream(self, hz: float, seconds: float) -> None:
        moving = threading.Thread(target=self.move, args=(0,), daemon=True)
        moving.start()
        time.sleep(seconds)
        self.stop()
        moving.join()
        self.again()
