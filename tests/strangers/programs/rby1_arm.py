"""rby1-sdk: power and servos on, and the right elbow bent, as in the client's quick start."""

import os
import sys

import numpy as np
import rby1_sdk as rb

ELBOW, BEND = 3, -1.0

robot = rb.create_robot(sys.argv[1], "a")
assert robot.connect()
assert robot.power_on(".*") and robot.servo_on(".*")
assert robot.enable_control_manager()
assert robot.wait_for_control_ready(2000)
position = np.zeros(7)
position[ELBOW] = BEND
joints = rb.JointPositionCommandBuilder().set_minimum_time(3.0).set_position(position)
body = rb.BodyComponentBasedCommandBuilder().set_right_arm_command(joints)
command = rb.RobotCommandBuilder().set_command(rb.ComponentBasedCommandBuilder().set_body_command(body))
feedback = robot.send_command(command, 10).get()
assert feedback.finish_code == rb.RobotCommandFeedback.FinishCode.Ok, feedback.finish_code
print("finished:", feedback.finish_code, flush=True)
os._exit(0)
