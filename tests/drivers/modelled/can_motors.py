"""Walks of the twin's motors: Damiao's commands and registers, RobStride's messages."""

from __future__ import annotations

from collections.abc import Iterator

from strands_actors.drivers.can_motors.protocol import HOST, Damiao, Frame, RobStride, State
from strands_actors.drivers.can_motors.robots import arm_of
from strands_actors.drivers.can_motors.twin import CanRobot
from strands_actors.drivers.can_motors.twin.motor import (
    DAMIAO_COMMANDS,
    DAMIAO_REGISTERS,
    ROBSTRIDE_MIT,
    ROBSTRIDE_TYPES,
    SimRobStride,
)

from .walk import Answer, Walk

REQUEST = b"\xff" * 7


def arm(motor: str) -> CanRobot:
    joint = {"key": "a", "motor": motor, "id": 1, "low": -1, "high": 1, "speed": 1, "torque": 1, "kp": 1, "kd": 1}
    table = {"joints": [joint]}
    return CanRobot(arm_of("mine", table), table, lambda: 100.0)


def mit_arm() -> CanRobot:
    made = arm("rs02")
    assert isinstance(made.motors[0], SimRobStride)
    made.motors[0].speaks_mit = True
    return made


def asked(robot: CanRobot, frame: Frame) -> Answer:
    kind, _, replies = robot.handle(0, frame)
    content = b"".join(reply.data for _, reply in replies)
    return Answer(kind != "other", content)


def ask_command(robot: CanRobot, code: int, data: bytes) -> Answer:
    return asked(robot, Frame(1, REQUEST + bytes((code,))))


def ask_register(robot: CanRobot, number: int, data: bytes) -> Answer:
    """Write a register if there is data, else read it."""
    code = Damiao.WRITE if data else Damiao.READ
    return asked(robot, Frame(Damiao.PARAMETERS, bytes((1, 0, code, number)) + (data or bytes(4))))


def ask_message(robot: CanRobot, kind: int, data: bytes) -> Answer:
    return asked(robot, Frame(kind << 24 | HOST << 8 | 1, data.ljust(8, b"\0"), True))


def enabled(robot: CanRobot) -> None:
    robot.motors[0].switch(State.ENABLED)


def faulty(robot: CanRobot) -> None:
    robot.motors[0].switch(State.OVERLOAD)


def walks() -> Iterator[Walk]:
    """Yield the walks of this module."""
    # A frame of seven bytes FF with any other byte is a command in MIT mode, so there is none that is not modelled.
    yield Walk(
        "damiao registers",
        DAMIAO_REGISTERS,
        range(256),
        lambda: arm("dm4310"),
        ask_register,
        {**dict.fromkeys(DAMIAO_REGISTERS.effects, b""), Damiao.TIMEOUT: (2000).to_bytes(4, "little")},
        (b"", bytes(4), (1).to_bytes(4, "little")),
    )
    yield Walk(
        "robstride",
        ROBSTRIDE_TYPES,
        range(32),
        lambda: arm("rs02"),
        ask_message,
        {
            0x00: b"",
            RobStride.COMMAND: bytes.fromhex("900080001000"),
            RobStride.ENABLE: b"",
            RobStride.DISABLE: b"",
            RobStride.READ: bytes.fromhex("1c70"),
            RobStride.WRITE: bytes.fromhex("28700000a00f0000"),
        },
        (b"", b"\x01", bytes(8)),
        {RobStride.COMMAND: enabled, RobStride.DISABLE: enabled},
    )
    yield Walk(
        "robstride mit",
        ROBSTRIDE_MIT,
        range(256),
        mit_arm,
        ask_command,
        dict.fromkeys(ROBSTRIDE_MIT.effects, b""),
        (b"",),
        {Damiao.DISABLE: enabled, Damiao.CLEAR: faulty},
    )
    yield Walk(
        "damiao commands",
        DAMIAO_COMMANDS,
        (*DAMIAO_COMMANDS.effects, 0x00),
        lambda: arm("dm4310"),
        lambda robot, code, data: ask_command(robot, code, data) if code else Answer(False),
        dict.fromkeys(DAMIAO_COMMANDS.effects, b""),
        (b"",),
        {Damiao.DISABLE: enabled, Damiao.CLEAR: faulty},
    )
