"""Test the codec: encoded messages decode to the same, and any other input raises its own error."""

from __future__ import annotations

import math
import random
from collections.abc import Callable
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from strands_actors.drivers.common.codecs import protobuf as pb
from strands_actors.drivers.common.codecs.grpc_messages import ClientEnd, ServerEnd
from strands_actors.drivers.common.codecs.malformed import MalformedFrame
from strands_actors.drivers.rby1 import protocol as p
from strands_actors.drivers.rby1.commands import (
    PARTS,
    Feedback,
    Finish,
    JointPosition,
    Status,
    decode_duration,
    encode_command,
    encode_duration,
    split,
)
from strands_actors.drivers.rby1.model import Limits, limits_of
from strands_actors.drivers.rby1.protocol import Manager, ManagerState, RobotInfo
from strands_actors.drivers.rby1.robots import TABLES
from strands_actors.drivers.rby1.states import RobotState
from strands_actors.drivers.rby1.twin.requests import Request
from strands_actors.drivers.rby1.twin.service import kind_of
from strands_actors.drivers.rby1.twin.urdf import urdf_of
from tests.drivers.disturbed import DISTURBED

from .rig import moves

rad = st.floats(-7.0, 7.0)
seconds = st.integers(0, 1 << 20).map(lambda value: value / 64)  # exact in both forms


def positions(count: int) -> st.SearchStrategy[JointPosition]:
    return st.builds(JointPosition, st.tuples(*[rad] * count), seconds, seconds)


some_parts = st.fixed_dictionaries({}, optional={name: positions(count) for name, count in PARTS.items()})
managers = st.builds(
    ManagerState, st.integers(0, 4), st.integers(0, 3), st.floats(0, 1), st.tuples(*[st.integers(0, 23)] * 3)
)
rows = st.tuples(*[rad] * 24)


@given(some_parts, st.integers(0, 100))
def test_a_command_is_read_as_it_was_written(parts: dict[str, JointPosition], priority: int) -> None:
    data = encode_command(parts, priority)
    request = Request.decode(data)
    read = {name: JointPosition(move.position, move.minimum_s, move.hold_s) for name, move in moves(data).items()}
    assert (read, request.priority, request.stops, request.others) == (parts, priority, False, ())


@given(st.floats(0.0, 1e6))
def test_a_duration_is_exact_to_a_nanosecond(value: float) -> None:
    assert decode_duration(encode_duration(value)) == pytest.approx(value, abs=2e-9)


@given(managers)
def test_a_manager_state_is_read_as_it_was_written(state: ManagerState) -> None:
    assert p.decode_manager_answer(p.encode_manager_answer(state)) == state


@given(
    st.builds(
        RobotState,
        rows,
        rows,
        rows,
        rows,
        rows,
        st.tuples(*[st.integers(0, 90).map(float)] * 24),
        st.tuples(*[st.booleans()] * 24),
        st.tuples(*[st.integers(0, 2)] * 4),
        st.tuples(st.integers(0, 1)),
        rad,
        rad,
        st.tuples(rad, rad, rad),
        st.tuples(rad, rad, rad),
        managers,
        st.integers(0, 2**62),
    )
)
def test_a_state_is_read_as_it_was_written(state: RobotState) -> None:
    assert RobotState.decode(state.encode()) == state


def test_rows_are_read_packed_or_not() -> None:
    rows = (0.25, -1.5)
    for packed in (True, False):
        state = b"".join(pb.double_fields(number, rows, packed) for number in (31, 32, 34))
        celsius = (
            pb.bytes_field(48, bytes((30, 31))) if packed else pb.varint_field(48, 30) + pb.varint_field(48, 31)
        )
        read = RobotState.decode(pb.bytes_field(2, state + celsius))
        assert (read.position, read.velocity, read.torque, read.temperature) == (rows, rows, rows, (30.0, 31.0))


def test_the_robots_identity_is_decoded() -> None:
    info = RobotInfo("A", "1.2", ("right_wheel", "torso_0"), ("5v", "48v"), ("EMO",), (("torso", (1,)),))
    read = RobotInfo.decode(info.encode())
    assert (read.model, read.version, read.joints, read.supplies) == ("A", "1.2", info.joints, info.supplies)
    assert dict(read.parts)["torso"] == (1,)


@pytest.mark.parametrize("finish", list(Finish))
def test_answers_to_a_command_are_decoded(finish: Finish) -> None:
    done = Feedback.decode(Feedback(Status.FINISHED, finish).encode())
    assert done.dropped == ("" if finish is Finish.OK else finish.name)
    assert Feedback.decode(Feedback(Status.RUNNING, finish).encode()).dropped == ""
    assert Feedback(Status.FINISHED, 99).dropped == "finish code 99"


def test_the_header_of_an_answer_shows_success() -> None:
    assert p.error_of(p.headed(b"")) == p.error_of(b"") == ""
    error = pb.varint_field(1, 2) + pb.bytes_field(2, b"busy")
    assert p.error_of(pb.bytes_field(1, pb.bytes_field(4, error))) == "busy"
    assert p.error_of(pb.bytes_field(1, pb.bytes_field(4, pb.varint_field(1, 3)))) == "error 3"


def test_a_row_is_split_by_part() -> None:
    parts = split(range(22))
    assert parts["torso"] == tuple(range(6)) and parts["head"] == (20, 21)


# -- its model


def test_limits_are_read_from_the_robots_own_model() -> None:
    table = TABLES.table("rby1")
    joints = [joint["key"] for joint in table["joints"]]
    limits = limits_of(urdf_of(table), joints)
    assert list(zip(limits.low, limits.high, strict=True)) == [tuple(j["range_rad"]) for j in table["joints"]]
    assert list(limits.speed) == [j["speed_rad_s"] for j in table["joints"]]


def test_limits_are_read_past_prefixes_and_transmissions() -> None:
    """As in MuJoCo: a prefix needs no declaration, and a transmission is no joint."""
    joint = '<joint name="a"><limit lower="-1" upper="1" velocity="2"/></joint>'
    more = '<drake:x/><gazebo><plugin:y/></gazebo><transmission><joint name="a"/></transmission>'
    assert limits_of(f"<robot>{joint}{more}</robot>", ["a"]) == Limits((-1.0,), (1.0,), (2.0,))


@pytest.mark.parametrize(
    ("limit", "says"),
    [
        ("", "no limits of a"),
        ('<limit lower="0" upper="1"/>', "no limits of a"),
        ('<limit lower="1" upper="0" velocity="1"/>', "no limits of a"),
        ('<limit lower="0" upper="inf" velocity="1"/>', "no limits of a"),
        ('<limit lower="0" upper="1" velocity="0"/>', "no limits of a"),
        ('<limit lower="x" upper="1" velocity="1"/>', "no limits of a"),
    ],
)
def test_impossible_limits_are_ignored(limit: str, says: str) -> None:
    with pytest.raises(MalformedFrame, match=says):
        limits_of(f'<robot><joint name="a">{limit}</joint></robot>', ["a"])


@pytest.mark.parametrize(
    "urdf", ['<!DOCTYPE x [<!ENTITY a "a">]><robot>&a;</robot>', "<robot>" + " " * 600_000, "\0"]
)
def test_a_model_that_is_no_plain_urdf_is_refused(urdf: str) -> None:
    with pytest.raises(MalformedFrame, match="URDF"):
        limits_of(urdf, ["a"])


# -- invalid input

READERS: dict[str, Callable[[bytes], Any]] = {
    "command": Request.decode,
    "state": RobotState.decode,
    "info": RobotInfo.decode,
    "manager": p.decode_manager_answer,
    "done": p.decode_done,
    "error": p.error_of,
    "order": p.decode_order,
    "rate": p.decode_rate,
    "model": p.decode_model,
    "feedback": Feedback.decode,
}


def samples() -> dict[str, bytes]:
    state = RobotState(*[(0.1,) * 24] * 6, (True,) * 24, (1,) * 4, (0,), manager=ManagerState(2, 1))
    part = JointPosition((0.1,) * 7, 0.02, 0.3)
    return {
        "command": encode_command({"right_arm": part, "left_arm": part}, 1),
        "state": state.encode(),
        "info": RobotInfo("A", "1.2", ("a", "b"), ("48v",), ("EMO",)).encode(),
        "manager": p.encode_manager_answer(ManagerState(Manager.ENABLED)),
        "done": p.headed(p.encode_done(p.Done.INTERNAL_ERROR, "why")),
        "error": p.headed(b""),
        "order": p.encode_order("48v", 1),
        "rate": p.encode_rate(100.0),
        "model": p.encode_model("<robot/>"),
        "feedback": Feedback(Status.FINISHED, Finish.PREEMPTED).encode(),
    }


def test_disturbed_messages_raise_only_the_codecs_error() -> None:
    chance = random.Random(50051)
    good = samples()
    for name, data in good.items():
        READERS[name](data)
    names, refused = list(good), 0
    for _ in range(DISTURBED):
        name = chance.choice(names)
        copy = bytearray(good[name])
        for _ in range(chance.randint(1, 3)):
            at = chance.randrange(len(copy) + 1)
            match chance.randrange(3):
                case 0 if at < len(copy):
                    copy[at] ^= 1 << chance.randrange(8)
                case 1:
                    del copy[at : at + chance.randint(1, 9)]
                case _:
                    copy[at:at] = chance.randbytes(chance.randint(1, 9))
        try:
            READERS[name](bytes(copy))
        except MalformedFrame:
            refused += 1
    assert refused > DISTURBED // 20


def test_a_disturbed_command_moves_only_the_joints_that_it_names() -> None:
    """Both ends of HTTP/2 take part. A call that cannot be decoded is no setpoint."""
    client, server = ClientEnd("h:1"), ServerEnd()
    stream = client.call(p.Method.COMMAND_STREAM)
    client.send(stream, b"\xff\xff")
    received = [event for event in server.feed(client.outgoing()) if getattr(event, "message", None)]
    assert len(received) == 1
    with pytest.raises(MalformedFrame):
        kind_of(p.Method.COMMAND_STREAM, b"\xff\xff")


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_invalid_numbers_are_refused(value: float) -> None:
    bad = encode_command({"torso": JointPosition((value, *(0.0,) * 5))}, 1)
    with pytest.raises(MalformedFrame, match="joints at"):
        Request.decode(bad)
    with pytest.raises(MalformedFrame, match="not finite"):
        RobotState.decode(RobotState(*[(value,) * 2] * 5, (30.0,) * 2, (True,) * 2).encode())


def test_a_part_with_another_number_of_joints_is_refused() -> None:
    with pytest.raises(MalformedFrame, match="5 positions for 6 joints"):
        Request.decode(encode_command({"torso": JointPosition((0.0,) * 5)}, 1))
