"""xarm-python-sdk: enable the arm, move its joints, and move its tool by 50 mm."""

import sys

from xarm.wrapper import XArmAPI

arm = XArmAPI(sys.argv[1])
assert arm.motion_enable(enable=True) == 0
assert arm.set_mode(0) == 0 and arm.set_state(state=0) == 0
code, angles = arm.get_servo_angle()
assert code == 0
assert arm.set_servo_angle(servo_id=1, angle=angles[0] + 20, speed=30, wait=True) == 0
code, pose = arm.get_position()
assert code == 0
assert arm.set_position(*pose[:2], pose[2] + 50, *pose[3:], speed=100, wait=True) == 0
code, raised = arm.get_position()
assert code == 0 and abs(raised[2] - pose[2] - 50) < 1, raised
print("there:", raised)
arm.disconnect()
