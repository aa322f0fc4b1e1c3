"""The vendor's own client for a T1, in a separate process.

    python sdk_client.py DOMAIN PID

It reads the robot's topics, calls its service and sends commands. Then it stops the robot's process (PID),
makes a call that fails, continues the process and calls again. It prints the result of each step as a line of
JSON.
"""

from __future__ import annotations

import json
import os
import signal
import sys
import threading
import time
from collections.abc import Callable

import booster_robotics_sdk_python as booster

PATIENCE_S = 30.0
STATES = 50
COMMANDS = 50
ELBOW = 4
MOTORS = 23
KEPT: list[object] = []
"""Callbacks, with many references each. The SDK copies a callback without the interpreter's lock, so a
reference is lost now and then. At zero references the callback would be freed, and the process would abort."""
REFERENCES = 10_000


def say(**fields: object) -> None:
    os.write(1, json.dumps(fields).encode() + b"\n")


def call(name: str, function: Callable[[], object]) -> object:
    began_s = time.monotonic()
    try:
        answer, failed = function(), ""
    except RuntimeError as error:
        answer, failed = None, str(error)
    say(call=name, failed=failed, took_s=time.monotonic() - began_s)
    return answer


def heard(make: Callable[[Callable[[object], None]], object], row: Callable[[object], list[float]]) -> list[float]:
    """Return the first sample of a topic. A sample is valid only within its callback."""
    rows: list[list[float]] = []
    come = threading.Event()

    def on_sample(sample: object) -> None:
        rows.append(row(sample))
        come.set()

    KEPT.extend([on_sample] * REFERENCES)
    subscriber = make(on_sample)
    subscriber.InitChannel()
    come.wait(PATIENCE_S)
    subscriber.CloseChannel()
    return rows[0] if rows else []


def drive(client: booster.B1LocoClient) -> None:
    def on_state(state: booster.LowState) -> None:
        states.append([motor.q for motor in state.motor_state_serial] + list(state.imu_state.rpy))
        if len(states) >= STATES:
            enough.set()

    states: list[list[float]] = []
    enough = threading.Event()
    KEPT.extend([on_state] * REFERENCES)
    subscriber = booster.B1LowStateSubscriber(on_state)
    subscriber.InitChannel()
    commands = booster.B1LowCmdPublisher()
    commands.InitChannel()
    enough.wait(PATIENCE_S)
    say(states=len(states), first=states[0] if states else [])
    say(fall=heard(booster.B1FallDownStateSubscriber, lambda m: [m.fall_down_state.value, m.is_recovery_available]))
    say(battery=heard(booster.B1BatteryStateSubscriber, lambda m: [m.voltage, m.current, m.soc, m.average_voltage]))
    say(odometer=heard(booster.B1OdometerStateSubscriber, lambda m: [m.x, m.y, m.theta]))
    mode = call("GetMode", client.GetMode)
    say(mode=int(mode.mode))
    call("ChangeMode", lambda: client.ChangeMode(booster.RobotMode.kWalking))
    call("UpperBodyCustomControl", lambda: client.UpperBodyCustomControl(True))
    call("Move", lambda: client.Move(0.3, 0.0, 0.1))
    call("MoveCommand", lambda: client.MoveCommand(0.2, 0.0, 0.0))
    call("RotateHead", lambda: client.RotateHead(0.2, 0.1))
    info = call("GetRobotInfo", client.GetRobotInfo)
    say(name=info.name)
    transform = call(
        "GetFrameTransform", lambda: client.GetFrameTransform(booster.Frame.kHead, booster.Frame.kBody)
    )
    say(head=[transform.position.x, transform.position.y, transform.position.z])
    kinds = [
        call(read.__name__, read).kind.value for read in (client.GetSensors, client.GetHands, client.GetRobotModel)
    ]
    say(devices=kinds)
    command = booster.LowCmd()
    command.cmd_type = booster.LowCmdType.PARALLEL
    command.resize_motor_cmd(MOTORS)
    for number in range(COMMANDS):
        motor = command.motor_cmd_at(ELBOW)
        motor.q, motor.kp, motor.kd = 0.01 * number, 60.0, 3.0
        commands.Write(command)
        time.sleep(0.01)
    call("Move zero", lambda: client.Move(0.0, 0.0, 0.0))
    call("ResetOdometryTo", lambda: client.ResetOdometryTo(1.0, 2.0, 0.5))
    say(reset=heard(booster.B1OdometerStateSubscriber, lambda m: [m.x, m.y, m.theta]))
    call("ResetOdometry", client.ResetOdometry)
    time.sleep(0.5)
    say(elbow=states[-1][ELBOW])


def stop_it(client: booster.B1LocoClient, pid: int) -> None:
    os.kill(pid, signal.SIGSTOP)
    call("Move to a stopped robot", lambda: client.Move(0.4, 0.0, 0.0))
    os.kill(pid, signal.SIGCONT)
    call("GetMode afterwards", client.GetMode)


def main(domain: int, pid: int) -> None:
    booster.ChannelFactory.Instance().Init(domain, "127.0.0.1")
    client = booster.B1LocoClient()
    client.Init()
    say(served=client.WaitForService(round(PATIENCE_S * 1000)))
    drive(client)
    stop_it(client, pid)
    say(done=True)
    os._exit(0)  # the threads of its library keep the process from a normal exit


main(int(sys.argv[1]), int(sys.argv[2]))
