"""Test the frames of a T1 and its service: offsets recorded from the vendor's SDK, and damaged frames."""

from __future__ import annotations

import json
import math
import random
import struct
from collections.abc import Callable

import pytest

from strands_actors.drivers.booster import protocol as p
from strands_actors.drivers.booster import rpc
from strands_actors.drivers.booster.protocol import (
    IDLE,
    Battery,
    Command,
    CommandType,
    Fall,
    Motor,
    Odometer,
    State,
)
from strands_actors.drivers.booster.rpc import Api, Mode, Request, Response
from strands_actors.drivers.common.codecs.malformed import MalformedFrame
from tests.drivers.disturbed import DISTURBED

MOTORS = 23

STATE = State(
    (0.25, 0.5, 0.75),
    (1.0, 2.0, 3.0),
    (4.0, 5.0, 6.0),
    tuple(slot / 4 for slot in range(MOTORS)),
    tuple(slot / 8 for slot in range(MOTORS)),
    tuple(slot / 2 for slot in range(MOTORS)),
    tuple(range(MOTORS)),
)
COMMAND = Command(
    CommandType.SERIAL,
    tuple(Motor(10, 0.5, 1.0, 1.5, 60.0, 3.0) if slot in (2, 9) else IDLE for slot in range(MOTORS)),
)

CAPTURED = (
    b"%\0\0\0" + b"24a6a703-ab7b-4e9f-97a4-e214c36f621c\0\0\0\0"
    b'N\0\0\0{"api_id":2001,"call_mode":0,"req_id":"24a6a703-ab7b-4e9f-97a4-e214c36f621c"}\0\0\0'
    b'/\0\0\0{"vx":0.10000000149011612,"vy":0.0,"vyaw":0.0}\0\0'
)
"""A request of the vendor's SDK 1.6.3, recorded from the wire."""


def test_a_command_has_its_numbers_where_the_robot_looks_for_them() -> None:
    body = p.encode_command(COMMAND)
    assert len(body) == 652
    assert struct.unpack_from("<II", body) == (1, MOTORS)
    at = 8 + 28 * 9
    assert body[at] == 10
    assert struct.unpack_from("<6f", body, at + 4) == (0.5, 1.0, 1.5, 60.0, 3.0, 0.0)
    assert p.decode_command(body) == COMMAND


def test_slots_without_a_command_are_zero() -> None:
    body = p.encode_command(COMMAND)
    for slot in set(range(MOTORS)) - {2, 9}:
        assert body[8 + 28 * slot : 36 + 28 * slot] == bytes(28)


def test_a_state_has_two_copies_of_its_motors() -> None:
    body = p.encode_state(STATE)
    assert len(body) == 1700
    assert struct.unpack_from("<9f", body) == (*STATE.rpy, *STATE.gyro, *STATE.acceleration)
    assert struct.unpack_from("<I", body, 36) == struct.unpack_from("<I", body, 868) == (MOTORS,)
    assert p.decode_state(body) == STATE
    other = bytearray(body)
    struct.pack_into("<f", other, 872 + 36 * 3 + 4, 9.0)  # q of slot 3, in the second copy
    assert p.decode_state(bytes(other), CommandType.PARALLEL).q[3] == 0.75
    assert p.decode_state(bytes(other), CommandType.SERIAL).q[3] == 9.0


def test_the_small_topics() -> None:
    assert p.encode_fall(Fall.HAS_FALLEN, True) == struct.pack("<iB", 2, 1)
    assert p.decode_fall(struct.pack("<iB3x", 3, 0)) == (Fall.IS_GETTING_UP, False)
    battery = Battery(1.5, 2.5, 3.5, 4.5)
    assert p.encode_battery(battery) == struct.pack("<4f", 1.5, 2.5, 3.5, 4.5)
    assert p.decode_battery(p.encode_battery(battery)) == battery
    odometer = Odometer(5.5, 6.5, 7.5)
    assert p.decode_odometer(p.encode_odometer(odometer)) == odometer


@pytest.mark.parametrize(("soc", "percent"), [(80.0, 80.0), (0.5, 50.0), (1.0, 100.0), (0.0, 0.0), (1.5, 1.5)])
def test_a_charge_of_unknown_scale_is_reported_in_percent(soc: float, percent: float) -> None:
    assert Battery(0, 0, soc, 0).percent == percent


def test_topics_carry_the_robot_s_name() -> None:
    assert p.topic("low_state", "") == "rt/low_state"
    assert p.topic("joint_ctrl", "alice") == "rt/alice/joint_ctrl"
    assert (rpc.request_topic(""), rpc.response_topic("")) == ("rt/LocoApiTopicReq", "rt/LocoApiTopicResp")
    assert rpc.request_topic("alice") == "rt/LocoApiTopic/aliceReq"
    assert rpc.response_topic("alice") == "rt/LocoApiTopic/aliceResp"


def test_a_request_of_the_sdk_is_read() -> None:
    request = rpc.decode_request(CAPTURED)
    assert (request.id, request.api) == ("24a6a703-ab7b-4e9f-97a4-e214c36f621c", Api.MOVE)
    assert rpc.parsed(request.body)["vx"] == pytest.approx(0.1)
    assert request.wants_answer


@pytest.mark.parametrize(
    ("header", "wants_answer"),
    [
        ({"api_id": 1, "call_mode": 0}, True),
        ({"api_id": 1, "call_mode": 2}, False),
        ({"api_id": 1, "expect_response": True}, True),
        ({"api_id": 1, "expect_response": False}, False),
        ({"api_id": 1}, True),
    ],
)
def test_headers_of_both_generations_are_read(header: dict[str, object], wants_answer: bool) -> None:
    request = rpc.encode_request(Request("a", 1, ""))
    ours = json.dumps({"api_id": 1, "call_mode": 0, "expect_response": True, "req_id": "a"})
    theirs = json.dumps(header)
    text = theirs.encode() + b"\0"
    other = request[:8] + struct.pack("<I", len(text)) + text + bytes(-len(text) % 4) + request[-8:]
    assert ours.encode() in request, "our request has the header fields of both generations"
    assert rpc.decode_request(other).wants_answer is wants_answer


def test_a_request_and_its_answer_survive_the_wire() -> None:
    request = Request("number", Api.MOVE, rpc.move(0.5, 0.0, -0.5), wants_answer=False)
    assert rpc.decode_request(rpc.encode_request(request)) == request
    response = Response("number", 409, "")
    assert rpc.decode_response(rpc.encode_response(response)) == response
    assert response.error == "conflict (409)" and Response("", 0).error == "" and "(7)" in Response("", 7).error


def test_bodies_are_those_of_the_sdk() -> None:
    assert json.loads(rpc.change_mode(Mode.WALKING)) == {"mode": 2}
    assert json.loads(rpc.upper_body(True)) == {"start": True}
    assert json.loads(rpc.rotate_head(0.25, 0.5)) == {"pitch": 0.25, "yaw": 0.5}
    assert json.loads(rpc.ZERO) == {"vx": 0.0, "vy": 0.0, "vyaw": 0.0}
    assert rpc.mode_of('{"mode": 4}') is Mode.SOCCER
    assert rpc.mode_of('{"mode": 17}') is Mode.UNKNOWN


@pytest.mark.parametrize(
    ("decode", "body"),
    [
        (p.decode_command, b""),
        (p.decode_command, struct.pack("<II", 0, 65) + bytes(28 * 65)),
        (p.decode_command, struct.pack("<II", 2, 0)),
        (p.decode_command, struct.pack("<II", 0, 2) + bytes(28)),
        (p.decode_state, bytes(36)),
        (p.decode_state, bytes(36) + struct.pack("<I", 2**31)),
        (p.decode_state, p.encode_state(STATE) + b"\0"),
        (p.decode_state, p.encode_state(STATE._replace(rpy=(math.nan, 0.0, 0.0)))),
        (p.decode_state, p.encode_state(STATE._replace(q=(math.inf,) * MOTORS))),
        (p.decode_fall, struct.pack("<iB", 4, 0)),
        (p.decode_fall, b"\0\0\0\0"),
        (p.decode_battery, struct.pack("<4f", 1, 2, math.nan, 4)),
        (p.decode_odometer, bytes(11)),
        (rpc.decode_request, rpc.encode_response(Response("a", 0))),
        (rpc.decode_response, rpc.encode_request(Request("a", 1))),
        (rpc.decode_response, b"\0\0\0\0"),
        (rpc.mode_of, '{"mode": true}'),
        (rpc.mode_of, "[]"),
        (rpc.parsed, "[" * 100_000),
    ],
)
def test_invalid_values_are_refused(decode: Callable[[object], object], body: object) -> None:
    with pytest.raises(MalformedFrame):
        decode(body)


def test_damaged_frames_raise_only_the_codecs_error() -> None:
    """Bits are flipped, bytes are cut, added and moved. Only the codec's error is raised, and memory does not
    grow."""
    whole: list[tuple[Callable[[bytes], object], bytes]] = [
        (p.decode_command, p.encode_command(COMMAND)),
        (p.decode_state, p.encode_state(STATE)),
        (p.decode_fall, p.encode_fall(Fall.IS_READY, False)),
        (p.decode_battery, p.encode_battery(Battery(1, 2, 3, 4))),
        (p.decode_odometer, p.encode_odometer(Odometer(1, 2, 3))),
        (rpc.decode_request, CAPTURED),
        (rpc.decode_request, rpc.encode_request(Request("x" * 36, Api.MOVE, rpc.ZERO))),
        (rpc.decode_response, rpc.encode_response(Response("x" * 36, 0, '{"mode": 2}'))),
    ]
    dice = random.Random(5)
    refused = 0
    for _ in range(DISTURBED):
        decode, frame = dice.choice(whole)
        damaged = bytearray(frame)
        for _ in range(dice.randint(1, 4)):
            at = dice.randrange(len(damaged) or 1)
            match dice.randrange(4):
                case 0 if damaged:
                    damaged[at] ^= 1 << dice.randrange(8)
                case 1:
                    del damaged[at : at + dice.randint(1, 40)]
                case 2:
                    damaged[at:at] = dice.randbytes(dice.randint(1, 40))
                case _:
                    damaged[at : at + 4] = dice.choice((b"\xff\xff\xff\xff", b"\0\0\0\0", b"\0\0\xc0\x7f"))
        try:
            decode(bytes(damaged))
        except MalformedFrame:
            refused += 1
    assert refused > DISTURBED / 4
