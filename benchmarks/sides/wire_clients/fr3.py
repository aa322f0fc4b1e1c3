"""Franka's pylibfranka. The script runs the 1 kHz control loop itself."""

from __future__ import annotations

import math
import threading
import time

import pylibfranka as franka

from .hand import BaseClient, wave

STEP_RAD = 0.03
FAR_RAD = 1.0
SPEED_RAD_S = 0.4


class Client(BaseClient):
    def __init__(self, robot: str, port: str) -> None:
        self._robot = franka.Robot(port.partition(":")[0], franka.RealtimeConfig.kIgnore)
        self._base = list(self._robot.read_once().q)

    def _go(self, far: float) -> int:
        """Move along a cosine, slowly enough for every safety limit. Return when the goal is reached."""
        seconds = max(0.3, 1.6 * abs(far) / SPEED_RAD_S)
        began_ns = time.monotonic_ns()
        active = self._robot.start_joint_position_control(franka.ControllerMode.JointImpedance)
        start: list[float] = []
        elapsed_s = 0.0
        goal = self._base[0] + far
        while elapsed_s < seconds:
            state, duration = active.readOnce()
            start = start or list(state.q_d)
            elapsed_s += duration.to_sec()
            share = (1 - math.cos(math.pi * min(1.0, elapsed_s / seconds))) / 2
            command = franka.JointPositions([start[0] + share * (goal - start[0]), *start[1:]])
            command.motion_finished = elapsed_s >= seconds
            active.writeOnce(command)
        return began_ns

    def setpoint(self, number: int) -> int:
        return self._go(STEP_RAD * wave(number))

    def move(self, number: int) -> None:
        self._go(-FAR_RAD if self._base[0] > 0 else FAR_RAD)

    def stop(self) -> None:
        self._robot.stop()

    def again(self) -> None:
        self._base = list(self._robot.read_once().q)

    def stream(self, hz: float, seconds: float) -> None:
        moving = threading.Thread(target=self.move, args=(0,), daemon=True)
        moving.start()
        time.sleep(seconds)
        self.stop()
        moving.join()
        self.again()
