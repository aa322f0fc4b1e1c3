"""Walks of the topics that twins on DDS subscribe to: Unitree and Booster.

A robot is silent about a topic without a reader. So the walk opens the twin's endpoints on a participant without a
network. Every reader must be in the twin's table, and every topic of the table must have a reader and an effect.
Topics of requests are walked request by request.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from types import SimpleNamespace
from typing import Any

from strands_actors.drivers.booster import protocol as booster
from strands_actors.drivers.booster import rpc as booster_rpc
from strands_actors.drivers.booster.robots import model_of as booster_model
from strands_actors.drivers.booster.rpc import Mode
from strands_actors.drivers.booster.twin.requests import TOPICS as BOOSTER
from strands_actors.drivers.booster.twin.server import BoosterServer, BoosterTwinOptions
from strands_actors.drivers.common.rtps import CDR
from strands_actors.drivers.common.twin import WireLog
from strands_actors.drivers.unitree import protocol as unitree
from strands_actors.drivers.unitree import rpc as unitree_rpc
from strands_actors.drivers.unitree.protocol import CommandCodec
from strands_actors.drivers.unitree.robots import model_of
from strands_actors.drivers.unitree.twin import UnitreeServer, UnitreeTwinOptions, arm_sdk
from strands_actors.drivers.unitree.twin.arm_sdk import SLOTS
from strands_actors.drivers.unitree.twin.requests import HUMANOID_TOPICS, TOPICS

from .walk import Answer, Walk

Handler = Callable[[memoryview, bytes, int], None]
WRITER = bytes(16)

OTHER_UNITREE = (
    "rt/wirelesscontroller",
    "rt/wirelesscontroller_unprocessed",
    "rt/user_lowcmd",
    "rt/dex3/left/cmd",
    "rt/dex3/right/cmd",
    "rt/inspire/cmd",
    "rt/unitree_hand/left/cmd",
    "rt/unitree_go/lowcmd",
    "rt/audio_msg",
    "rt/config_change_status",
    "rt/utlidar/switch",
    "rt/utlidar/mapping_cmd",
    "rt/qt_command",
    "rt/selftest",
    "rt/videohub/inner",
    "rt/gas_sensor",
    "rt/uslam/client_command",
    "rt/api/vui/request",
    "rt/api/robot_state/request",
    "rt/api/videohub/request",
    "rt/api/voice/request",
    "rt/api/agv/request",
    "rt/api/config/request",
    "rt/lowstate",
    "rt/sportmodestate",
)
OTHER_BOOSTER = (
    "rt/booster_hand_ctrl",
    "rt/booster/hand_data",
    "rt/remote_controller_state",
    "rt/button_event",
    "rt/robot_dds_states",
    "rt/LightControlApiTopicReq",
    "rt/VisionApiTopicReq",
    "rt/AiApiTopicReq",
    "rt/low_state",
    "rt/odometer_state",
    "rt/tf",
)


class Readers:
    """A participant without a network: it keeps the readers."""

    def __init__(self) -> None:
        self.handlers: dict[str, Handler] = {}

    def reader(self, topic: str, kind: str, handler: Handler, **qos: object) -> None:
        self.handlers[topic] = handler

    def writer(self, topic: str, kind: str, **qos: object) -> SimpleNamespace:
        return SimpleNamespace(write=lambda payload: None)

    def address_of(self, prefix: bytes) -> None:
        """Return None: the sender has no address."""


class Twin:
    """A twin with its readers, on a clock that stands still."""

    def __init__(self, server: UnitreeServer | BoosterServer, requests: frozenset[str]) -> None:
        self.server = server
        self.readers = Readers()
        participant: Any = self.readers
        server.make_endpoints(participant)
        self.topics = tuple(topic for topic in self.readers.handlers if topic not in requests)
        """The topics that it reads, except those of requests."""


def unitree_twin(robot: str) -> Twin:
    server = UnitreeServer(model_of(robot), WireLog(None), UnitreeTwinOptions())
    return Twin(server, frozenset(map(unitree_rpc.request_topic, server.onboard.services)))


def booster_twin() -> Twin:
    server = BoosterServer(booster_model("booster_t1"), WireLog(None), BoosterTwinOptions())
    return Twin(server, frozenset((booster_rpc.request_topic(""),)))


def ask_topic(twin: Twin, topic: str, body: bytes) -> Answer:
    """Write to a topic. Without a reader nothing hears it."""
    if topic not in twin.topics:
        return Answer(False)
    twin.readers.handlers[topic](memoryview(CDR + body), WRITER, 100 * 10**9)
    return Answer(True)


def obeying(twin: Twin) -> None:
    """Bring the robot into the state in which its joints obey: without its onboard mode, or as it is."""
    assert isinstance(twin.server, UnitreeServer)
    if not twin.server.onboard.takes_commands:
        twin.server.onboard.set_mode("")
    assert twin.server.onboard.takes_commands


def low_command(robot: str) -> bytes:
    """Return a LowCmd that moves the first joint."""
    model = model_of(robot)
    count = len(model.joints)
    server = unitree_twin(robot).server
    assert isinstance(server, UnitreeServer)
    values = (0.3, *[0.0] * (3 * count - 1), *[50.0] * count, *[2.0] * count)  # q, dq, tau, kp, kd
    return CommandCodec(model).encode(server.onboard.machine, values)


def arm_command(robot: str) -> bytes:
    """Return a message of ``rt/arm_sdk`` with the whole weight, which moves the first joint of the arms."""
    model, slots = model_of(robot), SLOTS[robot]
    body = bytearray(unitree.COMMAND_BYTES[model.family])
    offset, stride = arm_sdk._LAYOUT[model.family]
    for slot in slots.joints:
        arm_sdk._MOTOR.pack_into(body, offset + slot * stride, 0.3, 0.0, 0.0, 50.0, 2.0)
    arm_sdk._MOTOR.pack_into(body, offset + slots.weight * stride, 1.0, 0.0, 0.0, 0.0, 0.0)
    return bytes(body)


def handed_over(twin: Twin) -> None:
    assert isinstance(twin.server, BoosterServer)
    twin.server.onboard.set_mode(Mode.WALKING)
    twin.server.onboard._hand_over(True)


def joint_control() -> bytes:
    count = len(booster_model("booster_t1").motors)
    motor = booster.Motor(10, math.pi / 8, kp=50.0, kd=2.0)
    return booster.encode_command(booster.Command(booster.CommandType.SERIAL, (motor,) * count))


def walks() -> Iterator[Walk]:
    """Yield the walks of this module."""
    for robot, table in (("unitree_go2", TOPICS), ("unitree_g1", HUMANOID_TOPICS)):
        requests = {unitree.COMMAND_TOPIC: low_command(robot)}
        if robot in SLOTS:
            requests[arm_sdk.TOPIC] = arm_command(robot)
        yield Walk(
            f"topics of {robot}",
            table,
            (*dict.fromkeys((*unitree_twin(robot).topics, *OTHER_UNITREE)),),
            lambda robot=robot: unitree_twin(robot),
            ask_topic,
            requests,
            (b"", bytes(64), requests[unitree.COMMAND_TOPIC]),
            {unitree.COMMAND_TOPIC: obeying},
        )
    yield Walk(
        "topics of booster_t1",
        BOOSTER,
        (*dict.fromkeys((*booster_twin().topics, *OTHER_BOOSTER)),),
        booster_twin,
        ask_topic,
        {booster.topic("joint_ctrl", ""): joint_control()},
        (b"", bytes(64), joint_control()),
        {booster.topic("joint_ctrl", ""): handed_over},
    )
