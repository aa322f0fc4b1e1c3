"""Run a peer with Fast DDS: Booster's own client, in a separate process.

    python fastdds_peer.py DOMAIN

It reads the low state, calls two services and sends commands. It prints the results as lines of JSON, then
ends.
"""

from __future__ import annotations

import json
import os
import sys
import threading

import booster_robotics_sdk_python as booster

STATES = 20
COMMANDS = 20
PATIENCE_S = 20.0


def say(**fields: object) -> None:
    os.write(1, json.dumps(fields).encode() + b"\n")


def main(domain: int) -> None:
    received: list[list[float]] = []
    enough = threading.Event()

    def on_state(state: booster.LowState) -> None:
        # The object is valid only within this callback.
        received.append([motor.q for motor in state.motor_state_serial])
        if len(received) == STATES:
            enough.set()

    booster.ChannelFactory.Instance().Init(domain, "127.0.0.1")
    states = booster.B1LowStateSubscriber(on_state)
    states.InitChannel()
    commands = booster.B1LowCmdPublisher()
    commands.InitChannel()
    client = booster.B1LocoClient()
    client.Init()
    say(states=received[:STATES] if enough.wait(PATIENCE_S) else None)
    client.ChangeMode(booster.RobotMode.kWalking)  # raises without an answer
    say(mode=int(client.GetMode().mode))
    command = booster.LowCmd()
    command.cmd_type = booster.LowCmdType.SERIAL
    command.resize_motor_cmd(23)
    for number in range(COMMANDS):
        command.motor_cmd_at(3).q = number / 16
        commands.Write(command)
    say(written=COMMANDS)
    sys.stdin.read()  # the test decides when it ends, because of the messages under way
    os._exit(0)


main(int(sys.argv[1]))
