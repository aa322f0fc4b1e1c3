"""Test Unitree's own, unmodified Python client against the G1's twin.

It releases the robot's controller, reads states and bends an elbow. A command for another machine, or with a
wrong checksum, has no effect.
"""

from __future__ import annotations

import json
from pathlib import Path

from strands_actors.testing import Twin
from tests.drivers.packages import UNITREE, run_with

PROGRAM = """
import faulthandler, json, os, sys, time
faulthandler.dump_traceback_later(100, exit=True)
from unitree_sdk2py.core import channel

channel.ChannelConfigAutoDetermine = sys.argv[2]
channel.ChannelFactoryInitialize(0)
from unitree_sdk2py.comm.motion_switcher.motion_switcher_client import MotionSwitcherClient
from unitree_sdk2py.idl.default import unitree_hg_msg_dds__LowCmd_
from unitree_sdk2py.idl.unitree_hg.msg.dds_ import LowCmd_, LowState_
from unitree_sdk2py.utils.crc import CRC

ELBOW = int(sys.argv[1])

def until(look):
    deadline = time.monotonic() + 30
    while not (seen := look()):
        assert time.monotonic() < deadline, "patience is over"
        time.sleep(0.02)
    return seen

switcher = MotionSwitcherClient()
switcher.SetTimeout(5.0)
switcher.Init()

def answered(call):  # an answer may come before the client hears the robot: it is asked again
    return until(lambda: next((told for code, told in [call()] if code == 0), None))

mode = answered(switcher.CheckMode)
until(lambda: switcher.ReleaseMode()[0] == 0)
released = answered(switcher.CheckMode)

states = channel.ChannelSubscriber("rt/lowstate", LowState_)
states.Init()  # read when wanted: to decode all that come is more than a busy machine has time for
commands = channel.ChannelPublisher("rt/lowcmd", LowCmd_)
commands.Init()
crc = CRC()
state = until(lambda: states.Read())
told = {
    "modes": [mode, released],
    "machine": state.mode_machine,
    "crc": state.crc == crc.Crc(state),
    "rpy": list(state.imu_state.rpy),
    "quaternion": list(state.imu_state.quaternion),
}

def command(by, machine, checksum=0):
    message = unitree_hg_msg_dds__LowCmd_()
    message.mode_machine = machine
    for number in range(29):
        motor = message.motor_cmd[number]
        motor.mode, motor.kp, motor.kd, motor.q = 1, 60.0, 1.5, state.motor_state[number].q
    message.motor_cmd[ELBOW].q += by
    message.crc = crc.Crc(message) ^ checksum
    assert commands.Write(message)

def turned(by, machine, checksum=0, within=1.0, least=9.0):
    deadline, begun = time.monotonic() + within, state.motor_state[ELBOW].q
    far = 0.0
    while time.monotonic() < deadline and far < least:
        command(by, machine, checksum)
        time.sleep(0.02)
        newest = states.Read()
        far = abs(newest.motor_state[ELBOW].q - begun) if newest is not None else far
    return far

told["another machine"] = turned(0.5, state.mode_machine + 4)
told["wrong checksum"] = turned(0.5, state.mode_machine, 1)
told["turned"] = turned(0.5, state.mode_machine, within=30.0, least=0.1)
print(json.dumps(told), flush=True)
os._exit(0)
"""

CONFIG = """
<CycloneDDS><Domain>
  <General>
    <Interfaces><NetworkInterface address="127.0.0.1" multicast="false"/></Interfaces>
    <AllowMulticast>false</AllowMulticast>
  </General>
  <Discovery><ParticipantIndex>auto</ParticipantIndex><Peers><Peer address="{robot}"/></Peers></Discovery>
</Domain></CycloneDDS>
"""
LEFT_ELBOW = 18


def test_the_vendors_client_releases_reads_and_commands(tmp_path: Path) -> None:
    with Twin("unitree_g1", tmp_path) as twin:
        config = CONFIG.format(robot=twin.port.partition(":")[0])
        reported = json.loads(run_with(UNITREE, PROGRAM, str(LEFT_ELBOW), config, timeout_s=150.0).splitlines()[-1])
        kinds = [entry.kind for entry in twin.log.entries()]
    assert [mode["name"] for mode in reported["modes"]] == ["ai", ""]
    assert reported["machine"] == 5 and reported["crc"]
    assert abs(reported["quaternion"][0]) < 1.0 and any(reported["rpy"])
    # The order in the twin's log counts. Without a hold, gravity moves the elbow, too.
    first = {kind: kinds.index(kind) for kind in ("other", "garbled", "setpoint")}
    assert first["other"] < first["garbled"] < first["setpoint"], "two commands are refused, the third is accepted"
    assert "garbled" not in kinds[first["setpoint"] :]
    assert reported["turned"] >= 0.1
