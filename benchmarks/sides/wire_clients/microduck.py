"""microduck-cli's client of the robot's daemon."""

from __future__ import annotations

import time

from microduck_cli.ipc.client import RobotClient

from .hand import Hand, wave

SPEED_M_S = 0.15


class Client(Hand):
    def __init__(self, robot: str, port: str) -> None:
        self._duck = RobotClient(port, clock=time.monotonic)
        self._duck.connect()
        self._duck.request("robot.enable", {"on": True})
        time.sleep(1.0)  # until it stands

    def setpoint(self, number: int) -> int:
        began_ns = time.monotonic_ns()
        self._duck.send("robot.move", {"vx": SPEED_M_S * wave(number), "vy": 0.0, "vyaw": 0.0})
        return began_ns

    def stop(self) -> None:
        self._duck.send("robot.stop")
