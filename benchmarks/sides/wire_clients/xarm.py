"""UFACTORY's xarm-python-sdk."""

from __future__ import annotations

import time

from xarm.core.config.x_config import XCONF
from xarm.wrapper import XArmAPI

from .hand import BaseClient, wave

STEP_RAD = 0.03


class Client(BaseClient):
    def __init__(self, robot: str, port: str) -> None:
        host, _, number = port.partition(":")
        # The port of the simulated arm. The usual port 502 may need privileges.
        XCONF.SocketConf.TCP_CONTROL_PORT = int(number)
        self._arm = XArmAPI(host, is_radian=True)
        self.again()

    def again(self) -> None:
        for code in (self._arm.motion_enable(True), self._arm.set_mode(1), self._arm.set_state(0)):
            if code != 0:
                raise RuntimeError(f"the arm cannot be enabled: it answered with code {code}")
        until_s = time.monotonic() + 10.0
        while not (self._arm.mode == 1 and self._arm.state == 2):
            if time.monotonic() > until_s:
                raise RuntimeError(f"not ready after 10 s: mode {self._arm.mode}, state {self._arm.state}")
            time.sleep(0.005)
        self._base = self._arm.get_servo_angle(is_real=True)[1]

    def setpoint(self, number: int) -> int:
        target = [self._base[0] + STEP_RAD * wave(number), *self._base[1:]]
        began_ns = time.monotonic_ns()
        if (code := self._arm.set_servo_angle_j(target)) != 0:
            raise RuntimeError(f"the arm refused the target with code {code}")
        return began_ns

    def stop(self) -> None:
        self._arm.emergency_stop()
