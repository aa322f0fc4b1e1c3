"""The client for a Booster T1: Booster's SDK.

Setpoints are published on the SDK's topic, and Move(0, 0, 0) stops.
"""

from __future__ import annotations

import time

import booster_robotics_sdk_python as booster

from .hand import BaseClient, wave

DOMAIN = 91
"""The DDS domain of the twin (``benchmarks.wires``)."""
MOTORS = 23
ELBOW = 4
STEP_RAD = 0.06
SERVED_MS = 30_000
SPEED_M_S = 0.2


class Client(BaseClient):
    def __init__(self, robot: str, port: str) -> None:
        booster.ChannelFactory.Instance().Init(DOMAIN, "127.0.0.1")
        self._loco = booster.B1LocoClient()
        self._loco.Init()
        if not self._loco.WaitForService(SERVED_MS):
            raise RuntimeError("the robot's service does not answer")
        self._reading: list[float] = []
        self._subscriber = booster.B1LowStateSubscriber(self._on_state)
        self._subscriber.InitChannel()
        self._commands = booster.B1LowCmdPublisher()
        self._commands.InitChannel()
        self._loco.ChangeMode(booster.RobotMode.kWalking)
        self._loco.UpperBodyCustomControl(True)
        until_s = time.monotonic() + 10.0
        while not self._reading:
            if time.monotonic() > until_s:
                raise RuntimeError("the robot publishes no state")
            time.sleep(0.01)
        self._base = self._reading[0]

    def _on_state(self, state: booster.LowState) -> None:
        self._reading = [state.motor_state_serial[ELBOW].q]

    def setpoint(self, number: int) -> int:
        began_ns = time.monotonic_ns()
        command = booster.LowCmd()
        command.cmd_type = booster.LowCmdType.PARALLEL
        command.resize_motor_cmd(MOTORS)
        motor = command.motor_cmd_at(ELBOW)
        motor.q, motor.kp, motor.kd = self._base + STEP_RAD * wave(number), 60.0, 3.0
        self._commands.Write(command)
        return began_ns

    def move(self, number: int) -> None:
        self._loco.Move(SPEED_M_S, 0.0, 0.0)

    def stop(self) -> None:
        self._loco.Move(0.0, 0.0, 0.0)
