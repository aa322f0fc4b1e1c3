"""unitree_sdk2py: release the G1's own controller, and bend its left elbow by LowCmd."""

import os
import time

from unitree_sdk2py.comm.motion_switcher.motion_switcher_client import MotionSwitcherClient
from unitree_sdk2py.core import channel
from unitree_sdk2py.idl.default import unitree_hg_msg_dds__LowCmd_
from unitree_sdk2py.idl.unitree_hg.msg.dds_ import LowCmd_, LowState_
from unitree_sdk2py.utils.crc import CRC

ELBOW, BY, SECONDS, PERIOD = 18, 0.5, 2.0, 0.01

channel.ChannelFactoryInitialize(0)
switcher = MotionSwitcherClient()
switcher.SetTimeout(5.0)
switcher.Init()
deadline = time.monotonic() + 30
while (answer := switcher.CheckMode())[0] != 0 or answer[1]["name"]:
    assert time.monotonic() < deadline, "the robot's own controller is not released"
    switcher.ReleaseMode()
states = channel.ChannelSubscriber("rt/lowstate", LowState_)
states.Init()
commands = channel.ChannelPublisher("rt/lowcmd", LowCmd_)
commands.Init()
while (state := states.Read()) is None:
    assert time.monotonic() < deadline, "no LowState"
start = [state.motor_state[number].q for number in range(29)]
crc, began = CRC(), time.monotonic()
while (elapsed := time.monotonic() - began) < 2 * SECONDS:
    message = unitree_hg_msg_dds__LowCmd_()
    message.mode_pr, message.mode_machine = 0, state.mode_machine
    for number in range(29):
        motor = message.motor_cmd[number]
        motor.mode, motor.kp, motor.kd, motor.q = 1, 60.0, 1.5, start[number]
    message.motor_cmd[ELBOW].q += BY * min(elapsed / SECONDS, 1.0)
    message.crc = crc.Crc(message)
    assert commands.Write(message)
    time.sleep(PERIOD)
newest = states.Read()
turned = newest.motor_state[ELBOW].q - start[ELBOW]
assert abs(turned - BY) < 0.15, turned
print("there:", turned, flush=True)
os._exit(0)
