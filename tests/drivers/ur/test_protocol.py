"""Test the codec: frames in pieces of any size, recipes there and back, the kind of each frame."""

from __future__ import annotations

import math
import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from strands_actors.drivers.common.codecs.malformed import MalformedFrame
from strands_actors.drivers.ur import protocol as p
from strands_actors.drivers.ur.twin import commands as c

packets = st.tuples(st.integers(0, 255), st.binary(max_size=200))


@given(st.lists(packets, max_size=8), st.integers(1, 64))
def test_packets_survive_any_cutting(sent: list[tuple[int, bytes]], size: int) -> None:
    stream = b"".join(p.frame(kind, payload) for kind, payload in sent)
    decoder = p.Decoder()
    received = [packet for at in range(0, len(stream), size) for packet in decoder.feed(stream[at : at + size])]
    assert [tuple(packet) for packet in received] == sent


@given(st.binary(max_size=300))
def test_garbage_is_incomplete_or_refused(data: bytes) -> None:
    decoder = p.Decoder()
    try:
        for packet in decoder.feed(data):
            assert len(packet.payload) <= len(data)
    except MalformedFrame as error:
        assert "bytes" in str(error)


def test_a_known_packet() -> None:
    assert p.version_request() == bytes.fromhex("0005560002")
    assert p.outputs_request(125.0, ["timestamp", "actual_q"])[:3] == struct.pack(">HB", 29, ord("O"))


NAMES = ("timestamp", "actual_q", "robot_mode", "runtime_state")
KINDS = ("DOUBLE", "VECTOR6D", "INT32", "UINT32")
finite = st.floats(allow_nan=False, allow_infinity=False)


@given(finite, st.tuples(*[finite] * 6), st.integers(-(2**31), 2**31 - 1), st.integers(0, 2**32 - 1))
def test_a_recipe_there_and_back(time_s: float, q: tuple[float, ...], mode: int, state: int) -> None:
    recipe = p.outputs_answer(b"\x07" + ",".join(KINDS).encode(), NAMES)
    values: dict[str, p.Value] = dict(zip(NAMES, (time_s, q, mode, state), strict=True))
    (packet,) = p.Decoder().feed(recipe.pack(values))
    assert packet.kind == p.Kind.DATA
    assert packet.payload[0] == 7
    assert recipe.unpack(packet.payload) == values


def test_missing_parts_of_a_controller_are_named() -> None:
    with pytest.raises(MalformedFrame, match="actual_q"):
        p.outputs_answer(b"\x01DOUBLE,NOT_FOUND,INT32,UINT32", NAMES)
    with pytest.raises(MalformedFrame):
        p.outputs_answer(b"\x01DOUBLE", NAMES)
    recipe = p.outputs_answer(b"\x01" + ",".join(KINDS).encode(), NAMES)
    with pytest.raises(MalformedFrame):
        recipe.unpack(b"\x01")


@pytest.mark.parametrize(
    ("number", "kind"),
    [
        (c.Command.SERVO_J, "setpoint"),
        (c.Command.MOVE_J, "setpoint"),
        (c.Command.SPEED_J, "setpoint"),
        (c.Command.SERVO_STOP, "safe"),
        (c.Command.STOP_SCRIPT, "safe"),
        (c.Command.SET_WATCHDOG, "config"),
        (c.Command.NONE, "keepalive"),
    ],
)
def test_the_kind_of_a_command(number: int, kind: str) -> None:
    assert c.classify_command(number) == kind


def test_the_kind_of_lines_and_programs() -> None:
    assert c.classify_dashboard("stop\n") == c.classify_dashboard("power off") == "safe"
    assert c.classify_dashboard("brake release") == "enable"
    assert c.classify_dashboard("robotmode") == "read"
    assert c.classify_script(p.STOP_SCRIPT) == "safe"
    assert c.classify_script(b"def move():\n  movej([0,0,0,0,0,0])\nend\n") == "enable"
    assert c.classify_script(b"stopj(2)\nmovej([0,0,0,0,0,0])\n") == "enable"


def test_modes_have_names_and_strange_ones_numbers() -> None:
    assert p.mode_name(p.RobotMode, 3) == "POWER_OFF (3)"
    assert p.mode_name(p.SafetyMode, 3) == "PROTECTIVE_STOP (3)"
    assert p.mode_name(p.RobotMode, 42) == "unknown (42)"
    assert set(c.SAFETY_BITS) == set(p.SafetyMode)
    assert math.isclose(p.STOP_DECELERATION_RAD_S2, 4.0)


def test_saf_022_data_of_another_recipe_is_not_read_as_ours() -> None:
    ours, other = (p.Recipe(number, ["timestamp"], ["DOUBLE"]) for number in (1, 2))
    assert ours.unpack(ours.pack({"timestamp": 1.0})[3:]) == {"timestamp": 1.0}
    with pytest.raises(MalformedFrame, match="data of recipe 2, 1 was agreed"):
        ours.unpack(other.pack({"timestamp": 1.0})[3:])
