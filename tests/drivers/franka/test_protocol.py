"""Test the codec: messages in pieces of any size, states and commands there and back, and the codec's own error
for garbage."""

from __future__ import annotations

import contextlib
import random
import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from strands_actors.drivers.common.codecs.malformed import MalformedFrame
from strands_actors.drivers.franka import protocol as p
from tests.drivers.disturbed import DISTURBED

VERSIONS = tuple(p.DIALECTS)
messages = st.tuples(st.integers(0, 2**32 - 1), st.integers(0, 2**32 - 1), st.binary(max_size=200))
numbers = st.floats(-100, 100, width=32)
seven = st.tuples(*[numbers] * 7)


def a_state(version: int, **fields: tuple[float, ...]) -> bytes:
    dialect = p.DIALECTS[version]
    data = bytearray(dialect.state_bytes)
    for name, values in fields.items():
        dialect.put(data, name, *values)
    return bytes(data)


@given(st.lists(messages, max_size=8), st.integers(1, 64))
def test_messages_survive_any_cutting(sent: list[tuple[int, int, bytes]], size: int) -> None:
    stream = b"".join(p.Message(*message).raw for message in sent)
    decoder = p.Decoder(p.LARGEST_REQUEST)
    received = [message for at in range(0, len(stream), size) for message in decoder.feed(stream[at : at + size])]
    assert [tuple(message) for message in received] == sent


@pytest.mark.parametrize(
    ("version", "state", "command", "move", "fields"),
    [
        (5, 2373, 370, 68, {"q": 1184, "dq": 1296, "generator": 2280, "errors": 2282, "robot_mode": 2364}),
        (10, 1377, 371, 125, {"q": 596, "dq": 652, "generator": 1288, "errors": 1290, "robot_mode": 1372}),
    ],
)
def test_sizes_and_places_are_those_of_libfranka(
    version: int, state: int, command: int, move: int, fields: dict[str, int]
) -> None:
    dialect = p.DIALECTS[version]
    assert (dialect.state_bytes, dialect.command_bytes) == (state, command)
    assert len(dialect.start_joint_motion(1)) == move
    assert {name: dialect.fields[name][0] for name in fields} == fields
    assert len(p.ERRORS) == 41
    assert p.ERRORS[25] == "communication_constraints_violation"


def test_known_requests() -> None:
    five, ten = (p.DIALECTS[version] for version in VERSIONS)
    assert five.connect(7, 0x1234) == bytes.fromhex("00000000 07000000 10000000 0500 3412")
    assert ten.connect(7, 0x1234) == bytes.fromhex("00000000 07000000 10000000 0a00 3412")
    assert five.request("recover", 1)[:4] == struct.pack("<I", 12)
    assert ten.request("recover", 1)[:4] == struct.pack("<I", 10)
    assert ten.request("stop", 3) == bytes.fromhex("02000000 03000000 0c000000")
    assert (five.move_status(6), ten.move_status(8)) == ("reflex_aborted", "reflex_aborted")
    assert (five.move_status(99), five.name_of(99)) == ("status 99", "?")


@pytest.mark.parametrize("version", VERSIONS)
@given(q=seven, dq=seven, mode=st.integers(0, 6), reason=st.integers(0, 40))
def test_a_state_there_and_back(
    version: int, q: tuple[float, ...], dq: tuple[float, ...], mode: int, reason: int
) -> None:
    reflex = tuple(float(at == reason) for at in range(41))
    data = a_state(version, message_id=(77,), q=q, q_d=dq, dq=dq, robot_mode=(mode,), reflex_reason=reflex)
    state = p.DIALECTS[version].state(data)
    assert (state.message_id, state.q, state.q_d, state.dq, state.robot_mode) == (77, q, dq, dq, mode)
    assert state.reasons == (p.ERRORS[reason],)


@pytest.mark.parametrize("version", VERSIONS)
@given(q=seven, finished=st.booleans(), number=st.integers(0, 2**64 - 1))
def test_a_command_there_and_back(version: int, q: tuple[float, ...], finished: bool, number: int) -> None:
    dialect = p.DIALECTS[version]
    command = dialect.command(dialect.position_command(number, q, finished))
    assert (command.message_id, command.q, command.finished) == (number, q, finished)
    assert not any(command.dq) and not any(command.tau)


@pytest.mark.parametrize("version", VERSIONS)
def test_saf_014_an_invalid_state_is_refused(version: int) -> None:
    dialect = p.DIALECTS[version]
    for data in (b"", bytes(dialect.state_bytes - 1), bytes(dialect.state_bytes + 1)):
        with pytest.raises(MalformedFrame, match="bytes"):
            dialect.state(data)
    for name in ("q", "q_d", "dq"):
        with pytest.raises(MalformedFrame, match="no joint has"):
            dialect.state(a_state(version, **{name: (float("nan"),) * 7}))
    for name, number in (("robot_mode", 7), ("generator", 6), ("controller", 4), ("success_rate", 1.5)):
        with pytest.raises(MalformedFrame, match="modes"):
            dialect.state(a_state(version, **{name: (number,)}))
    with pytest.raises(MalformedFrame):
        dialect.command(b"")


@pytest.mark.parametrize("size", [0, 11, p.LARGEST_REQUEST + 1, 2**32 - 1])
def test_a_size_that_no_message_has_is_refused_at_once(size: int) -> None:
    with pytest.raises(MalformedFrame, match="bytes"):
        list(p.Decoder(p.LARGEST_REQUEST).feed(struct.pack("<III", 1, 2, size)))


def test_a_version_that_is_not_known() -> None:
    with pytest.raises(ValueError, match="FCI 4 is not supported"):
        p.Dialect(4)


def test_disturbed_frames_raise_only_the_codecs_error_and_fill_no_memory() -> None:
    chance = random.Random(1337)
    decoder = p.Decoder(p.LARGEST_REQUEST)
    for number in range(DISTURBED):
        dialect = p.DIALECTS[chance.choice(VERSIONS)]
        frame = bytearray(
            chance.choice(
                (
                    dialect.connect(number, 4000),
                    dialect.start_joint_motion(number),
                    dialect.position_command(number, (0.1,) * 7, False),
                    a_state(dialect.version, q=(0.5,) * 7),
                )
            )
        )
        for _ in range(chance.randint(1, 8)):
            frame[chance.randrange(len(frame))] = chance.randrange(256)
        data = bytes(frame[: chance.randint(0, len(frame))])
        try:
            for message in decoder.feed(data):
                p.connect_request(message.payload)
                p.connect_reply(message)
                p.status_of(message)
        except MalformedFrame:
            decoder = p.Decoder(p.LARGEST_REQUEST)
        assert len(decoder._pending) <= p.LARGEST_REQUEST + len(frame)
        for parse in (dialect.state, dialect.command, p.connect_request):
            with contextlib.suppress(MalformedFrame):
                parse(data)
        p.mode_name(chance.randrange(256))


@pytest.mark.parametrize("version", VERSIONS)
@pytest.mark.parametrize("valid", [False, True])
def test_the_cartesian_fields_of_a_command(version: int, valid: bool) -> None:
    """The offsets are those of libfranka."""
    dialect = p.DIALECTS[version]
    data = bytearray(dialect.position_command(7, (0.0,) * 7, False))
    pose, twist, elbow = tuple(map(float, range(16))), tuple(map(float, range(20, 26))), (0.5, -1.0)
    struct.pack_into("<16d", data, 120, *pose)
    struct.pack_into("<6d", data, 248, *twist)
    struct.pack_into("<2d?", data, 296, *elbow, valid)
    command = dialect.command(bytes(data))
    assert (command.pose, command.twist, command.elbow) == (pose, twist, elbow if valid else ())
    assert set(pose + twist) <= set(command.numbers)
