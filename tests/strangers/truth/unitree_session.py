"""A session with a Go2 by unitree_sdk2py: ``unitree_session.py HOST``. Each event is printed as JSON.

It stands the robot up as the vendor's example stand_go2 does, bends a leg, and pushes a hip by torque. It runs in
the environment of the client, so it imports nothing of this project.
"""

from __future__ import annotations

import json
import math
import os
import sys
import time
from collections.abc import Callable
from typing import Any

from unitree_sdk2py.core import channel
from unitree_sdk2py.idl.default import unitree_go_msg_dds__LowCmd_
from unitree_sdk2py.idl.unitree_go.msg.dds_ import LowCmd_, LowState_, SportModeState_
from unitree_sdk2py.utils.crc import CRC

HOST = sys.argv[1]
channel.ChannelConfigAutoDetermine = channel.ChannelConfigHasInterface = f"""
<CycloneDDS><Domain>
  <General>
    <Interfaces><NetworkInterface address="127.0.0.1" multicast="false"/></Interfaces>
    <AllowMulticast>false</AllowMulticast>
  </General>
  <Discovery><ParticipantIndex>auto</ParticipantIndex><Peers><Peer address="{HOST}"/></Peers></Discovery>
</Domain></CycloneDDS>
"""
JOINTS = [f"{leg}_{part}" for leg in ("fr", "fl", "rr", "rl") for part in ("hip", "thigh", "calf")]
UP = (0.0, 0.67, -1.3) * 4
BENT = (*UP[:1], UP[1] + 0.1, UP[2] - 0.2, *UP[3:])
DT = 0.002
KP, KD = 40.0, 1.0
"""Softer than the vendor's example (50, 3.5). The simulator computes the torques once for each message, so on a
busy computer, on which messages come late, its motors are not stable with more damping."""
HIP, PUSH_NM = 0, 4.0
START_S = 60.0


def say(name: str, answer: str = "", values: dict[str, float] | None = None, near: float = 0.05) -> None:
    print(json.dumps({"name": name, "answer": answer, "values": values or {}, "near": near}), flush=True)


class Robot:
    """The robot. The tolerances are wide, because soft motors let the feet slide, and where they stop differs from
    run to run. Order, sign and unit show all the same."""

    def __init__(self) -> None:
        channel.ChannelFactoryInitialize(0)
        self.count = self.sport = 0
        self.state: Any = None
        self.subscribers = [
            channel.ChannelSubscriber("rt/lowstate", LowState_),
            channel.ChannelSubscriber("rt/sportmodestate", SportModeState_),
        ]
        self.subscribers[0].Init(self.hear, 10)
        self.subscribers[1].Init(self.hear_sport, 10)
        self.commands = channel.ChannelPublisher("rt/lowcmd", LowCmd_)
        self.commands.Init()
        self.crc = CRC()

    def hear(self, message: Any) -> None:
        self.state, self.count = message, self.count + 1

    def hear_sport(self, message: Any) -> None:
        self.sport += 1

    def drive(self, seconds: float, q_of: Callable[[float], Any], push_nm: float = 0.0) -> None:
        """Command the joints until ``seconds`` have passed. ``q_of`` gets the share of the time."""
        command = unitree_go_msg_dds__LowCmd_()
        command.head[0], command.head[1], command.level_flag = 0xFE, 0xEF, 0xFF
        began = time.monotonic()
        while (elapsed := time.monotonic() - began) < seconds:
            for motor, q in zip(command.motor_cmd, q_of(elapsed / seconds), strict=False):
                motor.mode, motor.q, motor.dq, motor.kp, motor.kd, motor.tau = 1, q, 0.0, KP, KD, 0.0
            command.motor_cmd[HIP].tau = push_nm
            command.crc = self.crc.Crc(command)
            self.commands.Write(command)
            time.sleep(DT)

    def joints(self, part: str) -> dict[str, float]:
        """Return ``q`` or ``tau_est`` of all joints."""
        return {
            name: float(getattr(motor, part)) for name, motor in zip(JOINTS, self.state.motor_state, strict=False)
        }

    def imu(self, part: str) -> dict[str, float]:
        return dict(zip("xyz", map(float, getattr(self.state.imu_state, part)), strict=True))


def changes(before: dict[str, float], after: dict[str, float]) -> dict[str, float]:
    return {name: after[name] - before[name] for name in before}


def attitude(state: Any) -> dict[str, float]:
    w, x, y, z = map(float, state.imu_state.quaternion)
    return {
        "roll": math.atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y)),
        "pitch": math.asin(2 * (w * y - z * x)),
    }


robot = Robot()
deadline = time.monotonic() + START_S
while robot.state is None:
    assert time.monotonic() < deadline, "no LowState"
    time.sleep(0.05)
state = robot.state
say("first state", f"{len(state.motor_state)} motors, head {[*map(int, state.head)]}")
start = [float(motor.q) for motor in state.motor_state[:12]]
robot.drive(2.0, lambda share: [a + share * (b - a) for a, b in zip(start, UP, strict=True)])
before = robot.count
robot.drive(2.0, lambda share: UP)
say("states a second", values={"hundreds": (robot.count - before) / 200.0}, near=1.2)
stands = robot.joints("q")
say("standing: positions", values=stands, near=0.25)
say("standing: attitude", values=attitude(robot.state), near=0.15)
say("standing: gyroscope", values=robot.imu("gyroscope"), near=0.2)
say("standing: accelerometer", values=robot.imu("accelerometer"), near=1.5)
robot.drive(1.5, lambda share: BENT)
say("a leg bent: changes of positions", values=changes(stands, robot.joints("q")), near=0.12)
robot.drive(1.5, lambda share: UP)
stands, torques = robot.joints("q"), robot.joints("tau_est")
robot.drive(1.0, lambda share: UP, PUSH_NM)
hip = JOINTS[HIP]
pushed = {"tau_est": robot.joints("tau_est")[hip] - torques[hip], "q": robot.joints("q")[hip] - stands[hip]}
say("a hip pushed: changes", values=pushed, near=2.0)
say("rt/sportmodestate", "published" if robot.sport else "silent")
os._exit(0)
