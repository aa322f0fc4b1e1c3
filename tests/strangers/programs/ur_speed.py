"""ur-rtde: move the tool upwards at a speed for a second, and stop it."""

import sys
import time

from rtde_control import RTDEControlInterface
from rtde_receive import RTDEReceiveInterface

control, receive = RTDEControlInterface(sys.argv[1]), RTDEReceiveInterface(sys.argv[1])
before = receive.getActualTCPPose()[2]
assert control.speedL([0, 0, 0.1, 0, 0, 0], 0.5)
time.sleep(1.0)
assert control.speedStop()
time.sleep(0.5)
risen = receive.getActualTCPPose()[2] - before
assert 0.04 < risen < 0.16, risen
control.stopScript()
print("risen:", risen)
