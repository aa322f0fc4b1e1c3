"""The client for a Microduck: that of microduck-cli, which connects to the robot's daemon."""

from __future__ import annotations

import time

from microduck_cli.ipc.client import RobotClient

from .hand import BaseClient, wave

SPEED_M_S = 0.15


class Client(BaseClient):
    def __init__(self, robot: str, port: str) -> None:
        self._duck = RobotClient(port, clock=time.monotonic)
        self._duck.connect()
        self._duck.request("robot.enable", {"on": True})
        # Wait until the robot stands.
        time.sleep(1.0)

    def setpoint(self, number: int) -> int:
        began_ns = time.monotonic_ns()
        self._duck.send("robot.move", {"vx": SPEED_M_S * wave(number), "vy": 0.0, "vyaw": 0.0})
        return began_ns

    def stop(self) -> None:
        self._duck.send("robot.stop")
