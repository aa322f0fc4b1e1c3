"""Test the exact bytes to robotd, and that any input raises only the codec's own error."""

from __future__ import annotations

import contextlib
import json
import random
from collections.abc import Callable
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from strands_actors.drivers.common.codecs import json_rpc as rpc
from strands_actors.drivers.common.codecs.malformed import MalformedFrame
from strands_actors.drivers.microduck import protocol as p
from strands_actors.drivers.microduck.twin import DuckTwin
from tests.drivers.disturbed import DISTURBED

STATE = DuckTwin("microduck").state()
HEALTH = {"healthy": True, "battery": {"volts": 7.6, "percent": 63.0}}
POLICIES = {"mode": "walk", "skills": ["kick_left"], "sitting": False, "homed": True}
READERS: list[tuple[Callable[[Any], Any], Any]] = [
    (p.read_hello, {"api_version": 31, "daemon_version": "0.9.0", "revision": None}),
    (p.read_state, STATE),
    (p.read_health, HEALTH),
    (p.read_policies, POLICIES),
    (p.read_mode, {"mode": "walk"}),
    (p.read_skills, {"accepted": True, "skills": ["kick_left"]}),
    (p.read_intent, {"accepted": False, "reason": "no"}),
    (p.read_look, {"head": {"neck_pitch": 0, "head_pitch": 0, "head_yaw": 1, "head_roll": 0}, "clamped": True}),
    (p.read_distances, {"distance_mm": [100] * 64}),
]


def test_calls_are_one_object_a_line() -> None:
    twist = rpc.encode_notification(p.MOVE, p.move(0.2, 0, -0.5))
    assert twist == b'{"jsonrpc":"2.0","method":"robot.move","params":{"vx":0.2,"vy":0.0,"vyaw":-0.5}}\n'
    assert rpc.encode_notification(p.MOVE, p.REST).count(b'":0') == 3
    stop = rpc.encode_request(7, p.STOP, {})
    assert stop == b'{"jsonrpc":"2.0","id":7,"method":"robot.stop","params":{}}\n'
    assert p.is_rest(p.REST) and not p.is_rest(p.move(0, 0, 0)) and not p.is_rest({"vx": False})
    assert p.head((0.1, 0.2, 0.3, 0.4)) == {
        "neck_pitch": 0.1, "head_pitch": 0.2, "head_yaw": 0.3, "head_roll": 0.4,
    }  # fmt: skip
    assert p.pose((-0.01, 0.1, 0.2, 1.0)) == {"z": -0.01, "roll": 0.1, "pitch": 0.2, "active": True}


def test_a_state_as_robotd_sends_it() -> None:
    state = p.read_state(STATE)
    assert state.policy == p.HELD and state.stands and len(state.joints_rad) == 15
    walking = p.read_state({**STATE, "move": {"requested": [0.2, 0, 0], "applied": [0, 0, 0], "limited_by": ["x"]}})
    assert not walking.stands and walking.limited_by == ("x",)
    bare = {key: STATE[key] for key in ("t", "move", "head", "policy", "safety", "loop")}
    older = p.read_state({**bare, "joints": [], "targets": []})
    assert older.joints_rad == () and older.gyro_rad_s == () and older.yaw_rad == 0.0


@pytest.mark.parametrize(("applied", "stands"), [([0.0] * 3, True), ([8e-3, 0, 4e-3], True), ([0, 0, 0.02], False)])
def test_a_duck_stands_when_its_smoothed_twist_is_almost_zero(applied: list[float], stands: bool) -> None:
    """robotd smooths a twist. After a stop it would be a minute until the last digit of it is zero."""
    state = p.read_state({**STATE, "move": {"requested": [0, 0, 0], "applied": applied}})
    assert state.stands is stands
    assert not p.read_state({**STATE, "move": {"requested": [0.01, 0, 0], "applied": applied}}).stands


@pytest.mark.parametrize(
    ("policy", "is_driven"), [("held", False), ("homing", False), ("limp_fall", False), ("sit", True)]
)
def test_a_duck_on_its_way_to_its_home_pose_is_not_driven_yet(policy: str, is_driven: bool) -> None:
    assert p.read_state({**STATE, "policy": policy}).is_driven is is_driven


def test_skills_come_as_a_list_or_before_version_17_as_members() -> None:
    assert p.read_skills({"accepted": True, "walk": "w.onnx", "skills": ["bow"]}) == ("bow",)
    old = {"accepted": True, "walk": "w.onnx", "stand": "s.onnx", "unavailable": None, "kick_left": "k.onnx"}
    assert p.read_skills(old) == ("kick_left",)


def test_a_value_that_is_not_measured_is_not_zero() -> None:
    health = p.read_health({"healthy": False, "reason": "no bus"})
    assert health.battery_pct != health.battery_pct and health.reason == "no bus"
    assert p.read_policies({"mode": "walk"}).sitting is None


@pytest.mark.parametrize(
    ("line", "said"),
    [
        (b"[]", "no message"),
        (b"{", "no JSON"),
        (b"\xff\xfe", "no JSON"),
        (b'{"jsonrpc":"1.0","id":1,"result":1}', "no message"),
        (b'{"jsonrpc":"2.0","id":1}', "neither"),
        (b'{"jsonrpc":"2.0","id":true,"result":1}', "an id"),
        (b'{"jsonrpc":"2.0","id":[1],"result":1}', "an id"),
        (b'{"jsonrpc":"2.0","method":3}', "without a method"),
        (b'{"jsonrpc":"2.0","method":"x","params":[1]}', "no names"),
        (b'{"jsonrpc":"2.0","id":1,"error":{"code":"x"}}', "without code"),
        (b"[" * 60_000, "no JSON"),
    ],
)
def test_a_line_that_is_no_message_is_malformed(line: bytes, said: str) -> None:
    with pytest.raises(MalformedFrame, match=said):
        rpc.decode(line)


def test_lines_in_any_pieces_and_never_more_than_the_longest() -> None:
    data = b'{"a":1}\n\n  \n{"b":2}\n{"c"'
    for size in (1, 3, len(data)):
        decoder = rpc.LineDecoder()
        lines = [line for at in range(0, len(data), size) for line in decoder.feed(data[at : at + size])]
        assert lines == [b'{"a":1}', b'{"b":2}']
    with pytest.raises(MalformedFrame, match="more than 10 bytes"):
        list(rpc.LineDecoder(10).feed(b"x" * 11))
    with pytest.raises(MalformedFrame, match="more than 10 bytes"):
        list(rpc.LineDecoder(10).feed(b"x" * 11 + b"\n"))
    assert list(rpc.LineDecoder(10).feed(b"x" * 10 + b"\n")) == [b"x" * 10]


def test_disturbed_answers_raise_only_the_codecs_error() -> None:
    """``STRANDS_ACTORS_FUZZ`` is their number."""
    chance = random.Random(22)
    lines = [rpc.encode_result(1, value) for _, value in READERS] + [rpc.encode_notification(p.STATE, STATE)]
    decoder, taken = rpc.LineDecoder(), 0
    for _ in range(DISTURBED):
        at = chance.randrange(len(lines))
        data = bytearray(lines[at])
        for _ in range(chance.randint(1, 4)):
            where = chance.randrange(len(data))
            match chance.randrange(4):
                case 0:
                    data[where] = chance.randrange(256)
                case 1:
                    del data[where : where + chance.randint(1, 9)]
                case 2:
                    data[where:where] = chance.choice([b"null", b"-1e999", b"[", b'"', b"true", b"\n", b"{}"])
                case _:
                    del data[where:]
            data = data or bytearray(b"0")
        with contextlib.suppress(MalformedFrame):
            for line in decoder.feed(bytes(data) + b"\n"):
                with contextlib.suppress(MalformedFrame):
                    message = rpc.decode(line)
                    value = message.value if isinstance(message, rpc.Result) else getattr(message, "params", None)
                    READERS[min(at, len(READERS) - 1)][0](value)
                    taken += 1
    assert taken > DISTURBED // 50, "some disturbed answers are still valid"


@given(
    st.recursive(
        st.none() | st.booleans() | st.floats() | st.text(), lambda c: st.lists(c) | st.dictionaries(st.text(), c)
    )
)
def test_no_value_of_json_is_taken_for_another(value: Any) -> None:
    for read, _ in READERS:
        with contextlib.suppress(MalformedFrame):
            read(
                value if read is not p.read_state and read is not p.read_distances else {"move": value, "t": value}
            )


@given(st.binary(max_size=200))
def test_no_line_breaks_the_twin(data: bytes) -> None:
    with contextlib.suppress(MalformedFrame):
        for line in rpc.LineDecoder(64).feed(data):
            with contextlib.suppress(MalformedFrame):
                rpc.decode(line)


def test_a_twins_description_can_be_decoded() -> None:
    assert json.loads(rpc.encode_failure(None, rpc.PARSE_ERROR, "x"))["error"] == {"code": -32700, "message": "x"}
    failure = rpc.decode(rpc.encode_failure("a", -32601, "unknown method"))
    assert failure == rpc.Failure("a", -32601, "unknown method")
    assert rpc.decode(rpc.encode_result(3, [1])) == rpc.Result(3, [1])
    assert rpc.decode(b'{"jsonrpc":"2.0","method":"x"}') == rpc.Call("x", {}, None, True)
