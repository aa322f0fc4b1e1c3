"""Test the rover's JSON over HTTP: exact bodies, and only the codec's own error for any input."""

from __future__ import annotations

import contextlib
import json
import math
import random
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from strands_actors.drivers.common.codecs.malformed import MalformedFrame
from strands_actors.drivers.earthrover import protocol as p
from tests.drivers.disturbed import DISTURBED

DATA: dict[str, Any] = {
    "battery": 88,
    "signal_level": 5,
    "orientation": 12,
    "lamp": 1,
    "speed": 0.25,
    "gps_signal": 30.0,
    "latitude": 22.75,
    "longitude": 114.09,
    "vibration": 0.1,
    "timestamp": 1724189733.2,
    "accels": [[0.0, 0.1, 1.0, 1.0], [0.2, 0.3, 0.9, 2.0]],
    "rpms": [[1, 2, 3, 4, 5.0]],
}


def data(**changes: Any) -> p.Data:
    return p.decode_data(json.dumps({**DATA, **changes}).encode())


def test_a_setpoint_is_written_in_fractions_and_a_stop_in_whole_numbers() -> None:
    assert p.encode_setpoint(0.5, -0.25, 0.5) == b'{"command":{"linear":0.5,"angular":-0.25,"lamp":1}}'
    assert p.encode_stop(0.0) == b'{"command":{"linear":0,"angular":0,"lamp":0}}'
    assert p.encode_stop(1.0) == b'{"command":{"linear":0,"angular":0,"lamp":1}}'


@given(st.floats(-1, 1), st.floats(-1, 1), st.floats(-1, 1))
def test_no_setpoint_passes_for_a_stop(linear: float, angular: float, lamp: float) -> None:
    command = p.decode_command(p.encode_setpoint(linear, angular, lamp))
    assert command is not None and not p.is_stop(command)
    assert (command["linear"], command["angular"]) == (linear, angular)
    stop = p.decode_command(p.encode_stop(lamp))
    assert stop is not None and p.is_stop(stop) and stop["lamp"] == command["lamp"]


@pytest.mark.parametrize("body", [b"{}", b'{"command":{}}', b'{"command":1}', b'{"linear":1}'])
def test_a_body_without_a_command_is_ignored(body: bytes) -> None:
    assert p.decode_command(body) is None


def test_data_is_read_with_its_newest_rows() -> None:
    reported = data()
    assert (reported.stamp_s, reported.speed, reported.battery_pct, reported.lamp) == (
        1724189733.2,
        0.25,
        88.0,
        1.0,
    )
    assert reported.vectors == {"accels": (0.2, 0.3, 0.9), "rpms": (1.0, 2.0, 3.0, 4.0)}


@pytest.mark.parametrize("latitude", [1000, -1000, 90.1, None, "x", True])
def test_a_position_without_a_fix_is_ignored(latitude: object) -> None:
    reported = data(latitude=latitude)
    assert math.isnan(reported.latitude_deg) and math.isnan(reported.longitude_deg)
    assert (data().latitude_deg, data().longitude_deg) == (22.75, 114.09)


@pytest.mark.parametrize("name", ["speed", "timestamp"])
@pytest.mark.parametrize("value", [None, "fast", True, [1]])
def test_data_that_cannot_confirm_a_stop_is_refused(name: str, value: object) -> None:
    with pytest.raises(MalformedFrame, match="timestamp or a speed"):
        data(**{name: value})


def test_disturbed_bodies_raise_only_the_codecs_error() -> None:
    chance = random.Random(1)
    good = [
        json.dumps(DATA).encode(),
        p.encode_stop(0),
        b"[" * 5000,
        b'{"front_frame":"/9j/4A==","timestamp":1}',
        b'{"timestamp":1e999,"speed":0}',
        b"\xff\xfe",
    ]
    for _ in range(DISTURBED):
        body = disturbed(chance, chance.choice(good))
        for decode in (p.decode_data, p.decode_command, lambda body: p.decode_picture(body, "front")):
            with contextlib.suppress(MalformedFrame):
                decode(body)  # type: ignore[operator]


def disturbed(chance: random.Random, data: bytes) -> bytes:
    bytes_ = bytearray(data)
    for _ in range(chance.randint(1, 4)):
        at = chance.randrange(len(bytes_) + 1)
        match chance.randrange(3):
            case 0:
                bytes_[at : at + 1] = bytes([chance.randrange(256)])
            case 1:
                del bytes_[at : at + chance.randint(1, 8)]
            case _:
                bytes_[at:at] = bytes_[: chance.randint(0, 12)]
    return bytes(bytes_) or b"x"
