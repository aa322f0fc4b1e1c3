"""pyrobotiqur: activate the gripper over the text port of the URCap, and close it half."""

import sys

from pyrobotiqur import RobotiqGripper

with RobotiqGripper(sys.argv[1]) as gripper:
    gripper.activate(poll_interval=0.02)
    position, _ = gripper.move(128, speed=255)
    assert gripper.get_fault() == 0
    assert abs(position - 128) < 5, position
    print("there:", position)
