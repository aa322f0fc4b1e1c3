"""ur-rtde: move the joints, move the tool on a line, and servo, as in the guide of ur_rtde."""

import sys
import time

from rtde_control import RTDEControlInterface
from rtde_receive import RTDEReceiveInterface

control, receive = RTDEControlInterface(sys.argv[1]), RTDEReceiveInterface(sys.argv[1])
joints = receive.getActualQ()
assert control.moveJ([joints[0] + 0.3, *joints[1:]], 1.05, 1.4)
pose = receive.getActualTCPPose()
assert control.moveL([pose[0], pose[1], pose[2] - 0.05, *pose[3:]], 0.25, 0.5)
assert abs(receive.getActualTCPPose()[2] - pose[2] + 0.05) < 0.005
start = receive.getActualQ()
for step in range(250):
    period = control.initPeriod()
    assert control.servoJ([start[0] + 0.001 * step, *start[1:]], 0.5, 0.5, 0.002, 0.1, 300)
    control.waitPeriod(period)
control.servoStop()
time.sleep(0.3)
turned = receive.getActualQ()[0] - joints[0]
assert abs(turned - 0.549) < 0.03, turned
control.stopScript()
print("there:", turned)
