"""``legs_cyclone LENGTH PORT LOG``: read LowState and write LowCmd at 500 Hz with cyclonedds, which Unitree's
Python SDK uses, too.

LENGTH is ``short`` or ``long`` (4 or 25 s). PORT is the port of the simulated robot, and LOG the file of the
frames that it has read.

The process does nothing else: it has no policy, no gate, no limits, and is not supervised. The types are Unitree's
(unitree_hg), copied here. As in the SDK, the checksum covers the packed C struct.
"""

import array
import itertools
import json
import struct
import sys
import time
import zlib
from dataclasses import dataclass

import cyclonedds.idl as idl
import cyclonedds.idl.types as types
from cyclonedds.core import Policy, Qos
from cyclonedds.domain import Domain, DomainParticipant
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic

from .wire import Log, percentile

HZ = 500.0
SECONDS = {"short": 4.0, "long": 25.0}
GAP_MS = 4.0
JOINTS = 29
SLOTS = 35

CONFIG = """
<CycloneDDS><Domain id="0">
  <General>
    <Interfaces><NetworkInterface address="127.0.0.1" multicast="false"/></Interfaces>
    <AllowMulticast>false</AllowMulticast>
  </General>
  <Discovery><ParticipantIndex>auto</ParticipantIndex><Peers><Peer address="{robot}"/></Peers></Discovery>
</Domain></CycloneDDS>
"""


@dataclass
class MotorCmd(idl.IdlStruct, typename="unitree_hg.msg.dds_.MotorCmd_"):
    mode: types.uint8
    q: types.float32
    dq: types.float32
    tau: types.float32
    kp: types.float32
    kd: types.float32
    reserve: types.uint32


@dataclass
class LowCmd(idl.IdlStruct, typename="unitree_hg.msg.dds_.LowCmd_"):
    mode_pr: types.uint8
    mode_machine: types.uint8
    motor_cmd: types.array[MotorCmd, SLOTS]
    reserve: types.array[types.uint32, 4]
    crc: types.uint32


@dataclass
class IMUState(idl.IdlStruct, typename="unitree_hg.msg.dds_.IMUState_"):
    quaternion: types.array[types.float32, 4]
    gyroscope: types.array[types.float32, 3]
    accelerometer: types.array[types.float32, 3]
    rpy: types.array[types.float32, 3]
    temperature: types.int16


@dataclass
class MotorState(idl.IdlStruct, typename="unitree_hg.msg.dds_.MotorState_"):
    mode: types.uint8
    q: types.float32
    dq: types.float32
    ddq: types.float32
    tau_est: types.float32
    temperature: types.array[types.int16, 2]
    vol: types.float32
    sensor: types.array[types.uint32, 2]
    motorstate: types.uint32
    reserve: types.array[types.uint32, 4]


@dataclass
class LowState(idl.IdlStruct, typename="unitree_hg.msg.dds_.LowState_"):
    version: types.array[types.uint32, 2]
    mode_pr: types.uint8
    mode_machine: types.uint8
    tick: types.uint32
    imu_state: IMUState
    motor_state: types.array[MotorState, SLOTS]
    wireless_remote: types.array[types.uint8, 40]
    reserve: types.array[types.uint32, 4]
    crc: types.uint32


PACKED = struct.Struct("<2B2x" + "B3x5fI" * SLOTS + "5I")
REVERSED = bytes(int(f"{byte:08b}"[::-1], 2) for byte in range(256))


def checksum(command: LowCmd) -> int:
    """Return the CRC-32/MPEG-2 over all words of the C struct except the last."""
    values = [command.mode_pr, command.mode_machine]
    for motor in command.motor_cmd:
        values += [motor.mode, motor.q, motor.dq, motor.tau, motor.kp, motor.kd, motor.reserve]
    values += [*command.reserve, 0]
    words = array.array("I", PACKED.pack(*values)[:-4])
    words.byteswap()
    mirrored = zlib.crc32(words.tobytes().translate(REVERSED)) ^ 0xFFFFFFFF
    return int.from_bytes(mirrored.to_bytes(4, "little").translate(REVERSED), "big")


def first_state(reader: DataReader) -> LowState:
    until_s = time.monotonic() + 10.0
    while time.monotonic() < until_s:
        for sample in reader.take(8):
            if isinstance(sample, LowState):
                return sample
        time.sleep(0.01)
    raise RuntimeError("no LowState came")


def main(length: str, port: str, log_path: str) -> None:
    seconds = SECONDS[length]
    domain = Domain(0, CONFIG.format(robot=port.partition(":")[0]))
    participant = DomainParticipant(0)
    qos = Qos(Policy.Reliability.BestEffort)
    reader = DataReader(participant, Topic(participant, "rt/lowstate", LowState), qos)
    writer = DataWriter(participant, Topic(participant, "rt/lowcmd", LowCmd), qos)
    state = first_state(reader)
    stand = [motor.q for motor in state.motor_state]
    command = LowCmd(
        0, state.mode_machine, [MotorCmd(0, 0.0, 0.0, 0.0, 0.0, 0.0, 0) for _ in range(SLOTS)], [0] * 4, 0
    )
    received = 0
    log = Log(log_path)
    began_s, used_s, began_ns = time.monotonic(), time.process_time(), time.monotonic_ns()
    for step in range(round(HZ * seconds)):
        time.sleep(max(0.0, began_s + step / HZ - time.monotonic()))
        received += len(reader.take(8))
        for slot in range(JOINTS):
            motor = command.motor_cmd[slot]
            motor.mode, motor.q, motor.kp, motor.kd = 1, stand[slot], 200.0, 6.0
        command.crc = checksum(command)
        writer.write(command)
    elapsed_s = time.monotonic() - began_s
    used = time.process_time() - used_s
    times_ns = [frame.t_ns for frame in log.setpoints() if frame.t_ns >= began_ns]
    if received < 0.5 * HZ * seconds or len(times_ns) < 0.5 * HZ * seconds:
        raise RuntimeError(
            f"too few messages: {received} states came, and {len(times_ns)} commands reached the robot"
        )
    gaps_ms = [(after - before) / 1e6 for before, after in itertools.pairwise(times_ns)]
    figures = {
        "lowcmd_hz": len(gaps_ms) / (sum(gaps_ms) / 1e3),
        "gap_p99_ms": percentile(gaps_ms, 0.99),
        "gap_worst_ms": max(gaps_ms),
        "above_4_ms_pct": 100 * sum(gap > GAP_MS for gap in gaps_ms) / len(gaps_ms),
        "process_pct": 100 * used / elapsed_s,
    }
    print(json.dumps(figures), flush=True)
    del domain


if __name__ == "__main__":
    main(*sys.argv[1:])
