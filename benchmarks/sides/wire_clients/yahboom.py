"""roslibpy with rosbridge."""

from __future__ import annotations

import time

import roslibpy

from .hand import BaseClient, wave

SPEED_M_S = 0.3


class Client(BaseClient):
    def __init__(self, robot: str, port: str) -> None:
        host, _, number = port.rpartition(":")
        ros = roslibpy.Ros(host, int(number))
        ros.run(10)
        self._drive = roslibpy.Topic(ros, "/cmd_vel", "geometry_msgs/Twist")
        self._drive.advertise()

    def _publish(self, x: float) -> None:
        zero = type(x)(0)  # in a stop the speeds are whole numbers
        linear, angular = {"x": x, "y": zero, "z": zero}, {"x": zero, "y": zero, "z": zero}
        self._drive.publish(roslibpy.Message({"linear": linear, "angular": angular}))

    def setpoint(self, number: int) -> int:
        began_ns = time.monotonic_ns()
        self._publish(SPEED_M_S * wave(number))
        return began_ns

    def stop(self) -> None:
        self._publish(0)
