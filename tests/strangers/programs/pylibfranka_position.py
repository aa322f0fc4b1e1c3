"""pylibfranka: a joint position motion of two seconds, as in the client's joint position example."""

import math
import os
import sys

import pylibfranka as franka

SECONDS = 2.0

robot = franka.Robot(sys.argv[1], franka.RealtimeConfig.kIgnore)
active = robot.start_joint_position_control(franka.ControllerMode.JointImpedance)
start, elapsed = list[float](), 0.0
while elapsed < SECONDS:
    state, duration = active.readOnce()
    start = start or list(state.q_d)
    elapsed += duration.to_sec()
    swing = 0.1 * (1 - math.cos(math.pi * min(elapsed / SECONDS, 1.0)))
    command = franka.JointPositions([start[0] + swing, *start[1:]])
    command.motion_finished = elapsed >= SECONDS
    active.writeOnce(command)
turned = robot.read_once().q[0] - start[0]
assert abs(turned - 0.2) < 0.02, turned
print("there:", turned, flush=True)
os._exit(0)
