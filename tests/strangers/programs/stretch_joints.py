"""hello-robot-stretch-body: start the whole robot, home it, raise the lift and move the arm out."""

import os
import time

import stretch_body.robot

robot = stretch_body.robot.Robot()
assert robot.startup()
if not robot.is_homed():
    robot.home()
robot.lift.move_to(0.6)
robot.arm.move_to(0.2)
robot.push_command()
deadline = time.monotonic() + 30
while abs(robot.lift.status["pos"] - 0.6) > 0.005 or abs(robot.arm.status["pos"] - 0.2) > 0.005:
    assert time.monotonic() < deadline, (robot.lift.status["pos"], robot.arm.status["pos"])
    time.sleep(0.1)
print("there:", robot.lift.status["pos"], robot.arm.status["pos"], flush=True)
robot.stop()
os._exit(0)
