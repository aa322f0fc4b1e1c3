"""The client for an RB-Y1: Rainbow Robotics' rby1-sdk. Setpoints are sent as a stream of commands. CancelControl
stops.
"""

from __future__ import annotations

import time

import rby1_sdk as rb

from .hand import BaseClient, wave

STEP_RAD = 0.03
PERIOD_S = 0.02
HOLD_S = 0.3


class Client(BaseClient):
    def __init__(self, robot: str, port: str) -> None:
        self._robot = rb.create_robot(port, "a")
        if not self._robot.connect(3):
            raise RuntimeError("the client cannot connect to the robot")
        self._robot.power_on(".*")
        self._robot.servo_on(".*")
        self._robot.enable_control_manager()
        self._robot.wait_for_control_ready(2000)
        self.again()

    def again(self) -> None:
        self._base = self._robot.get_state().position[8:15].copy()
        self._stream = self._robot.create_command_stream(1)

    def setpoint(self, number: int) -> int:
        target = self._base.copy()
        target[6] += STEP_RAD * wave(number)
        began_ns = time.monotonic_ns()
        header = rb.CommandHeaderBuilder().set_control_hold_time(HOLD_S)
        joints = rb.JointPositionCommandBuilder().set_command_header(header)
        joints = joints.set_minimum_time(PERIOD_S).set_position(target)
        body = rb.BodyComponentBasedCommandBuilder().set_right_arm_command(joints)
        command = rb.RobotCommandBuilder().set_command(rb.ComponentBasedCommandBuilder().set_body_command(body))
        self._stream.send_command(command)
        return began_ns

    def stop(self) -> None:
        self._robot.cancel_control()
