"""Walks of the arms and grippers."""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator
from typing import Any

import trio

from strands_actors.drivers.common.dynamixel import protocol as dxl
from strands_actors.drivers.common.dynamixel.twin import INSTRUCTIONS
from strands_actors.drivers.common.physics.hand_motion import HandMotion
from strands_actors.drivers.common.twin import ClientGone, WireLog
from strands_actors.drivers.dynamixel.twin import DynamixelBus
from strands_actors.drivers.feetech import protocol as feetech
from strands_actors.drivers.feetech.twin import INSTRUCTIONS as FEETECH
from strands_actors.drivers.feetech.twin import FeetechBus
from strands_actors.drivers.franka import hand_protocol
from strands_actors.drivers.franka import protocol as franka
from strands_actors.drivers.franka.twin import FrankaServer
from strands_actors.drivers.franka.twin.hand import REQUESTS as FRANKA_HAND
from strands_actors.drivers.franka.twin.hand import Hand
from strands_actors.drivers.franka.twin.hand_service import HandService
from strands_actors.drivers.franka.twin.requests import MOTIONS as FRANKA_MOTIONS
from strands_actors.drivers.franka.twin.requests import REQUESTS as FRANKA
from strands_actors.drivers.robotiq.protocol import INPUT, OUTPUT
from strands_actors.drivers.robotiq.sessions import FUNCTIONS, TcpSession
from strands_actors.drivers.robotiq.twin import twin_of
from strands_actors.drivers.robotiq.unit import RobotiqTwin
from strands_actors.drivers.robotiq.urcap import LINES, UrcapSession
from strands_actors.drivers.xarm import protocol as xarm
from strands_actors.drivers.xarm.twin import controller_of
from strands_actors.drivers.xarm.twin import modbus as xarm_modbus
from strands_actors.drivers.xarm.twin.controller import Controller
from strands_actors.drivers.xarm.twin.modbus import Modbus
from strands_actors.drivers.xarm.twin.registers import REGISTERS as XARM
from strands_actors.drivers.xarm.twin.registers import Other
from tests.drivers.kinova import walk as kinova_walk
from tests.drivers.xarm import requests as xarm_requests

from .walk import Answer, Walk


def still() -> float:
    return 100.0


# -- xArm


def ask_xarm(twin: Controller, register: int, data: bytes) -> Answer:
    flags, content = twin.obey(register, data)
    return Answer(not flags & xarm.INVALID, content)


XARM_WALK = Walk(
    "xarm",
    XARM,
    range(256),
    lambda: controller_of("xarm7", now_s=still),
    ask_xarm,
    xarm_requests.REQUESTS,
    (b"", b"\0", b"\1", bytes(28), bytes(64)),
    xarm_requests.PREPARE,
    frozenset((Other.REPORT_CURRENTS,)),  # the reports have torques already
)


# -- standard Modbus of an xArm


def ask_xarm_modbus(twin: Modbus, function: int, data: bytes) -> Answer:
    reply = twin.answer(bytes((1, function)) + data)
    return Answer(not reply[1] & 0x80, reply[2:] if function <= xarm_modbus.INPUT_REGISTERS else b"")


XARM_MODBUS_WALK = Walk(
    "modbus of the xarm",
    xarm_modbus.FUNCTIONS,
    range(1, 128),
    lambda: Modbus(controller_of("xarm7", now_s=still)),
    ask_xarm_modbus,
    {
        xarm_modbus.COILS: b"\0\x87\0\7",
        xarm_modbus.INPUTS: b"\0\0\0\x10",
        xarm_modbus.HOLDING: b"\0\x20\0\2",
        xarm_modbus.INPUT_REGISTERS: b"\0\x40\0\x09",
        xarm_modbus.WRITE_COIL: b"\0\3\xff\0",
        xarm_modbus.WRITE_REGISTER: b"\0\x20\0\1",
        xarm_modbus.WRITE_COILS: b"\1\0\0\2\1\3",
        xarm_modbus.WRITE_REGISTERS: b"\1\0\0\1\2\0\5",
    },
    (b"", b"\0\0\0\1", bytes(4)),
)


# -- servo buses


def ask_dynamixel(bus: DynamixelBus, code: int, params: bytes) -> Answer:
    target = dxl.BROADCAST if code in GROUPS else 1
    replies = bus.handle(dxl.Packet(target, code, params))
    packets = [packet for reply in replies for packet in dxl.Decoder().feed(reply.data)]
    if code in GROUPS:
        return Answer(True, b"".join(reply.data for reply in replies))
    return Answer(bool(packets) and not packets[0].failure, packets[0].params if packets else b"")


GROUPS = (dxl.SYNC_READ, dxl.SYNC_WRITE, dxl.FAST_SYNC_READ, dxl.BULK_READ, dxl.BULK_WRITE, dxl.FAST_BULK_READ)
LED = 65
ONE_LED = struct.pack("<H", LED) + b"\1"


def keep_dynamixel(bus: DynamixelBus) -> None:
    bus.handle(dxl.Packet(1, dxl.REG_WRITE, ONE_LED))


def light_dynamixel(bus: DynamixelBus) -> None:
    bus.handle(dxl.Packet(1, dxl.WRITE, ONE_LED))


def ask_feetech(bus: FeetechBus, code: int, params: bytes) -> Answer:
    target = feetech.BROADCAST if code in (feetech.SYNC_READ, feetech.SYNC_WRITE) else 1
    replies = bus.handle(feetech.Packet(target, code, params))
    return Answer(bool(replies) or code == feetech.SYNC_WRITE, b"".join(reply.data[5:-1] for reply in replies))


ACCELERATION = 41


def change_feetech(code: int) -> Callable[[FeetechBus], None]:
    def act(bus: FeetechBus) -> None:
        bus.handle(feetech.Packet(1, code, bytes((ACCELERATION, 7))))

    return act


# -- Robotiq


def ask_modbus(twin: RobotiqTwin, function: int, data: bytes) -> Answer:
    frame = struct.pack(">HHHBB", 1, 0, 2 + len(data), twin.unit, function) + data
    try:
        replies = [reply for each in TcpSession(twin).receive(frame, None) for reply in each.replies]
    except ClientGone:
        return Answer(False)
    reply = replies[0].data if replies else b""
    return Answer(bool(reply) and not reply[7] & 0x80, reply[8:])


def ask_line(twin: RobotiqTwin, line: str, value: str) -> Answer:
    text = f"{line}{value}\n".encode()
    (exchange,) = UrcapSession(twin).receive(text, None)
    said = exchange.replies[0].data
    return Answer(said != b"?", b"" if said == b"ack" else said)


COMMAND = struct.pack(">HHB", OUTPUT, 1, 2) + b"\1\0"
BLOCK = struct.pack(">HH", INPUT, 3)
BOTH = BLOCK + COMMAND


# -- Franka


TOOL = struct.pack("<16d", 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0.1, 1)
"""An end effector of 10 cm, column by column."""


class Client:
    """The client's end of a connection."""

    peer_host = "127.0.0.1"

    def __init__(self) -> None:
        self.sent: list[bytes] = []

    def send_logged(self, kind: str, data: bytes) -> None:
        self.sent.append(data)


def franka_server(robot: str = "panda", fci: int = 5) -> FrankaServer:
    async def build() -> FrankaServer:
        return FrankaServer(robot, fci, WireLog(None), None, 0.01)

    server = trio.run(build)
    server._udp.close()  # It needs no socket here.
    return server


def ask_franka(server: FrankaServer, name: str, payload: bytes) -> Answer:
    client: Any = Client()
    if name == "move":
        server._obey(client, "connect", franka.Message(0, 1, struct.pack("<HH", 5, 1)))
        client.sent.clear()
    code = franka.DIALECTS[5].commands.index(name)
    server._obey(client, name, franka.Message(code, 2, payload))
    reply = client.sent[0][franka.HEADER.size :]
    accepted = reply[0] == (1 if name == "move" else 0)
    server._listeners_of_state.clear()
    return Answer(accepted, reply[1:] if name in ("connect", "model") else b"")


LAWS = ("joint_impedance", "cartesian_impedance", "external", "other")
GENERATORS = ("joint_position", "joint_velocity", "cartesian_position", "cartesian_velocity", "none", "other")


def ask_motion(server: FrankaServer, motion: str, payload: bytes) -> Answer:
    """Request a motion: a controller, a motion generator, and whether its targets come at no rate (FCI 10)."""
    law, generator, *asynchronous = motion.split()
    client: Any = Client()
    server._obey(client, "connect", franka.Message(0, 1, struct.pack("<HH", 10, 1)))
    payload = franka.DIALECTS[10].move.pack(
        LAWS.index(law), GENERATORS.index(generator), *[1.0] * 6, bool(asynchronous), *[0.5] * 7
    )
    client.sent.clear()
    server._obey(client, "move", franka.Message(1, 2, payload))
    server._listeners_of_state.clear()
    return Answer(client.sent[0][franka.HEADER.size] == franka.DIALECTS[10].move_statuses.index("motion_started"))


def reflex(server: FrankaServer) -> None:
    server.controller.reflex("joint_reflex")


def moves(server: FrankaServer) -> None:
    ask_franka(server, "move", franka.DIALECTS[5].start_joint_motion(1)[franka.HEADER.size :])


def franka_hand() -> HandService:
    return HandService(Hand(HandMotion()), lambda state, address: None)


def ask_hand(service: HandService, command: int, payload: bytes) -> Answer:
    client: Any = Client()
    if command != hand_protocol.Command.CONNECT:
        service._obey(client, franka.Message(hand_protocol.Command.CONNECT, 1, hand_protocol.connect_payload(1)))
        client.sent.clear()
    try:
        service._obey(client, franka.Message(command, 2, payload))
    except ClientGone:
        return Answer(False)
    finally:
        service._listeners.clear()
    if not client.sent:
        return Answer(service.hand.motion.moves or service.hand._running is not None)
    reply = client.sent[-1][hand_protocol.HEADER.size :]
    return Answer(reply[0] == 0, reply[2:])


def close_hand(service: HandService) -> None:
    ask_hand(service, hand_protocol.Command.MOVE, hand_protocol.move_payload(0.01, 0.1))


def walks() -> Iterator[Walk]:
    """Yield the walks of this module."""
    hand = hand_protocol.Command
    yield Walk(
        "franka hand",
        FRANKA_HAND,
        range(64),
        franka_hand,
        ask_hand,
        {
            hand.CONNECT: hand_protocol.connect_payload(1),
            hand.HOMING: b"",
            hand.GRASP: hand_protocol.grasp_payload(0.0, 0.0, 1.0, 0.1, 20.0),
            hand.MOVE: hand_protocol.move_payload(0.04, 0.1),
            hand.STOP: b"",
        },
        (b"", bytes(16), bytes(40)),
        {hand.STOP: close_hand},
    )
    yield XARM_WALK
    yield XARM_MODBUS_WALK
    read = struct.pack("<HH", 0, 2)
    yield Walk(
        "dynamixel",
        INSTRUCTIONS,
        range(256),
        lambda: DynamixelBus.for_robot("koch", still),
        ask_dynamixel,
        {
            dxl.PING: b"",
            dxl.READ: read,
            dxl.WRITE: ONE_LED,
            dxl.REG_WRITE: ONE_LED,
            dxl.ACTION: b"",
            dxl.FACTORY_RESET: b"\x02",
            dxl.REBOOT: b"",
            dxl.CLEAR: b"\x01\x44\x58\x4c\x22",
            dxl.SYNC_READ: read + b"\1",
            dxl.FAST_SYNC_READ: read + b"\1",
            dxl.SYNC_WRITE: struct.pack("<HH", LED, 1) + b"\1\1",
            dxl.BULK_READ: b"\1" + read,
            dxl.FAST_BULK_READ: b"\1" + read,
            dxl.BULK_WRITE: b"\1" + struct.pack("<HH", LED, 1) + b"\1",
        },
        (b"", ONE_LED, bytes(5)),
        {dxl.ACTION: keep_dynamixel, dxl.REBOOT: light_dynamixel, dxl.FACTORY_RESET: light_dynamixel},
        frozenset((dxl.CLEAR,)),  # tests/drivers/dynamixel/test_twin.py turns a servo more than once
    )
    yield Walk(
        "feetech",
        FEETECH,
        range(256),
        lambda: FeetechBus.for_robot("so101", still),
        ask_feetech,
        {
            feetech.PING: b"",
            feetech.READ: b"\3\2",
            feetech.WRITE: bytes((ACCELERATION, 7)),
            feetech.REG_WRITE: bytes((ACCELERATION, 7)),
            feetech.ACTION: b"",
            feetech.RESET: b"",
            feetech.REBOOT: b"",
            feetech.SYNC_READ: b"\3\2\1",
            feetech.SYNC_WRITE: bytes((ACCELERATION, 1, 1, 7)),
        },
        (b"", bytes((ACCELERATION, 7)), bytes(5)),
        {
            feetech.ACTION: change_feetech(feetech.REG_WRITE),
            feetech.RESET: change_feetech(feetech.WRITE),
            feetech.REBOOT: change_feetech(feetech.WRITE),
        },
        frozenset((feetech.PING,)),  # its reply is the error byte alone
    )
    yield from kinova_walk.walks()
    yield Walk(
        "robotiq",
        FUNCTIONS,
        range(1, 128),
        lambda: twin_of("robotiq_2f85", still),
        ask_modbus,
        {3: BLOCK, 4: BLOCK, 6: struct.pack(">HH", OUTPUT, 0x0100), 16: COMMAND, 23: BOTH},
        (b"", bytes(4), struct.pack(">HH", OUTPUT, 1), COMMAND),
    )
    names = (
        "ACT",
        "GTO",
        "ATR",
        "POS",
        "SPE",
        "FOR",
        "STA",
        "OBJ",
        "FLT",
        "PRE",
        "COU",
        "SID",
        "MOD",
        "VER",
        "ARD",
    )
    yield Walk(
        "urcap",
        LINES,
        [f"{word} {name}" for word in ("GET", "SET", "PUT") for name in names],
        lambda: twin_of("robotiq_2f85", still),
        ask_line,
        {line: " 1" if line.startswith("SET") else "" for line in LINES.effects},
        ("", " 1"),
    )
    yield Walk(
        "franka",
        FRANKA,
        franka.DIALECTS[5].commands,
        franka_server,
        ask_franka,
        {
            "connect": struct.pack("<HH", 5, 40000),
            "move": franka.DIALECTS[5].start_joint_motion(1)[franka.HEADER.size :],
            "stop": b"",
            "recover": b"",
            "model": b"\0\0",
            "load": struct.pack("<13d", 1.0, *[0.0] * 12),
            "ee_to_k": TOOL,
            "ne_to_ee": TOOL,
            "collision": struct.pack("<52d", *[20.0] * 52),
            "joint_impedance": struct.pack("<7d", *[2000.0] * 7),
            "cartesian_impedance": struct.pack("<6d", *[200.0] * 6),
        },
        (b"", struct.pack("<7d", *[100.0] * 7), bytes(13 * 8)),
        {"stop": moves, "recover": reflex},
    )
    yield Walk(
        "franka motions",
        FRANKA_MOTIONS,
        [f"{law} {kind}{more}" for law in LAWS for kind in GENERATORS for more in ("", " asynchronous")],
        lambda: franka_server("fr3", 10),
        ask_motion,
        dict.fromkeys(FRANKA_MOTIONS.effects, b""),
        (b"",),
    )


__all__ = ["walks"]
