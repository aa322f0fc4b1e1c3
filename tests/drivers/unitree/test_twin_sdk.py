"""Test Unitree's own, unmodified Python client against the twins of a G1 and a Go2.

It releases the robot's controller, reads states and bends an elbow. A command for another machine, or with a
wrong checksum, has no effect. It also moves the arms of a G1 that stands by its own controller, by messages and
by gestures, and walks a Go2 by its obstacle avoidance.
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


START = """
import faulthandler, json, os, sys, time
faulthandler.dump_traceback_later(100, exit=True)
from unitree_sdk2py.core import channel

channel.ChannelConfigAutoDetermine = sys.argv[1]
channel.ChannelFactoryInitialize(0)

def until(look):
    deadline = time.monotonic() + 30
    while not (seen := look()):
        assert time.monotonic() < deadline, "patience is over"
        time.sleep(0.02)
    return seen
"""

ARMS_PROGRAM = (
    START
    + """
from unitree_sdk2py.g1.arm.g1_arm_action_client import G1ArmActionClient, action_map
from unitree_sdk2py.go2.obstacles_avoid.obstacles_avoid_client import ObstaclesAvoidClient
from unitree_sdk2py.idl.default import unitree_hg_msg_dds__LowCmd_
from unitree_sdk2py.idl.std_msgs.msg.dds_ import String_
from unitree_sdk2py.idl.unitree_hg.msg.dds_ import LowCmd_, LowState_

ELBOW, SHOULDER, WEIGHT, ARMS = 18, 22, 29, range(15, 29)
states = channel.ChannelSubscriber("rt/lowstate", LowState_)
states.Init()
gestures = channel.ChannelSubscriber("rt/arm/action/state", String_)
gestures.Init()
arms = channel.ChannelPublisher("rt/arm_sdk", LowCmd_)
arms.Init()
client = G1ArmActionClient()
client.SetTimeout(10.0)
client.Init()
home = until(lambda: states.Read()).motor_state

def turned(joint):
    return until(lambda: states.Read()).motor_state[joint].q - home[joint].q

def send(weight, share):  # without checksum, mode_machine and motor modes, as in the vendor's examples
    message = unitree_hg_msg_dds__LowCmd_()
    message.motor_cmd[WEIGHT].q = weight
    for number in ARMS:
        motor = message.motor_cmd[number]
        motor.kp, motor.kd, motor.q = 60.0, 1.5, home[number].q
    message.motor_cmd[ELBOW].q -= 0.6 * share
    assert arms.Write(message)
    time.sleep(0.02)

told = {"list": until(lambda: next((data for code, data in [client.GetActionList()] if code == 0), None))}
told["invalid"] = client.ExecuteAction(14)
told["gesture"] = client.ExecuteAction(action_map["shake hand"])
told["raised"] = turned(SHOULDER)
held = lambda: [state for state in [json.loads(until(gestures.Read).data)] if state["holding"]]
told["state"] = until(held)[0]
told["another"] = client.ExecuteAction(action_map["hug"])
told["release"] = client.ExecuteAction(action_map["release arm"])
until(lambda: abs(turned(SHOULDER)) < 0.1)
for step in range(50):
    send(1.0, step / 50)
until(lambda: send(1.0, 1.0) or turned(ELBOW) < -0.4)
told["occupied"] = client.ExecuteAction(action_map["clap"])
for step in range(51):
    send(1.0 - step / 50, 1.0)
until(lambda: abs(turned(ELBOW)) < 0.1)
avoider = ObstaclesAvoidClient()
avoider.SetTimeout(1.0)
avoider.Init()
told["avoid"] = avoider.SwitchGet()[0]
print(json.dumps(told), flush=True)
os._exit(0)
"""
)


def test_the_vendors_client_moves_the_arms_of_a_g1_that_stands(tmp_path: Path) -> None:
    with Twin("unitree_g1", tmp_path) as twin:
        config = CONFIG.format(robot=twin.port.partition(":")[0])
        told = json.loads(run_with(UNITREE, ARMS_PROGRAM, config, timeout_s=150.0).splitlines()[-1])
        entries = twin.log.entries()
    assert {"id": 27, "name": "shake_hand"} in told["list"][0]
    assert told["gesture"] == told["release"] == 0 and told["raised"] < -0.3
    assert told["state"] == {"holding": True, "id": 27, "name": "shake_hand"}
    assert (told["invalid"], told["another"], told["occupied"]) == (7402, 7401, 7400), told
    assert told["avoid"] == 3102, "a G1 has no such service: the vendor's client finds no receiver"
    kinds = {entry.kind for entry in entries}
    assert "arms" in kinds and "garbled" not in kinds and "fell" not in kinds


AVOID_PROGRAM = (
    START
    + """
from unitree_sdk2py.go2.obstacles_avoid.obstacles_avoid_client import ObstaclesAvoidClient
from unitree_sdk2py.idl.unitree_go.msg.dds_ import SportModeState_

states = channel.ChannelSubscriber("rt/sportmodestate", SportModeState_)
states.Init()
client = ObstaclesAvoidClient()
client.SetTimeout(3.0)
client.Init()
told = {"before": until(lambda: next(([on] for code, on in [client.SwitchGet()] if code == 0), None))[0]}
told["set"] = client.SwitchSet(True)
told["after"] = client.SwitchGet()
told["remote"] = client.UseRemoteCommandFromApi(True)
until(lambda: client.Move(0.5, 0.0, 0.0) == 0 and until(lambda: states.Read()).position[0] > 0.2)
client.Move(0.0, 0.0, 0.0)
told["returned"] = client.UseRemoteCommandFromApi(False)
told["version"] = client.GetServerApiVersion()
print(json.dumps(told), flush=True)
os._exit(0)
"""
)


def test_the_vendors_client_walks_a_go2_by_its_obstacle_avoidance(tmp_path: Path) -> None:
    with Twin("unitree_go2", tmp_path) as twin:
        config = CONFIG.format(robot=twin.port.partition(":")[0])
        told = json.loads(run_with(UNITREE, AVOID_PROGRAM, config, timeout_s=150.0).splitlines()[-1])
        kinds = [entry.kind for entry in twin.log.entries() if entry.sender == "host"]
    assert told["before"] is False and told["after"] == [0, True]
    assert told["set"] == told["remote"] == told["returned"] == 0
    assert told["version"][0] == 0 and "1.0.0.2" in told["version"][1]
    assert "setpoint" in kinds and "safe" in kinds[kinds.index("setpoint") :]
