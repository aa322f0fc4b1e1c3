"""urx: turn the first joint, and read where it is."""

import math
import os
import sys
import time

from urx.urrobot import URRobot

robot = URRobot(sys.argv[1], use_rt=True)
joints = robot.getj()
goal = [joints[0] + 0.2, *joints[1:]]
robot.movej(goal, acc=2, vel=1, wait=False)
deadline = time.monotonic() + 20
while math.dist(robot.getj(), goal) > 0.01:
    assert time.monotonic() < deadline, robot.getj()
    time.sleep(0.02)
print("there:", robot.getj(), flush=True)
os._exit(0)
