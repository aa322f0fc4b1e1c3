"""Test the daemon's JSON: exact bodies, and only the codec's own error for any input."""

from __future__ import annotations

import contextlib
import json
import math
import random
from collections.abc import Callable
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from strands_actors.drivers.common.codecs.malformed import MalformedFrame
from strands_actors.drivers.reachy import protocol as p
from strands_actors.drivers.reachy.twin import ReachyTwin
from tests.drivers.disturbed import DISTURBED

UUID = "b9cbfc2f-79b0-4181-bce4-8ce04b277b90"
ROW = (10.0, -5.0, 20.0, 1.0, -2.0, 3.0, 15.0, 30.0, -45.0)
STATUS = {
    "type": "daemon_status", "robot_name": "reachy_mini", "state": "running", "wireless_version": False,
    "simulation_enabled": False, "mockup_sim_enabled": True, "version": "1.13.0", "error": None,
    "backend_status": {"motor_control_mode": "enabled", "error": None},
}  # fmt: skip
JOINTS = {"type": "joint_positions", "head_joint_positions": [0.1] * 7, "antennas_joint_positions": [0.2, -0.3]}
HEAD = {"type": "head_pose", "head_pose": [[1.0, 0, 0, 0.01], [0, 1, 0, 0], [0, 0, 1, -0.02], [0, 0, 0, 1]]}
IMU = {
    "type": "imu_data", "accelerometer": [0, 0, 9.8], "gyroscope": [0.1, 0, 0], "quaternion": [1, 0, 0, 0],
    "temperature": 31.5,
}  # fmt: skip

DECODERS: list[tuple[Callable[[bytes], Any], Any]] = [
    (p.decode_sdk, JOINTS),
    (p.decode_sdk, HEAD),
    (p.decode_sdk, IMU),
    (p.decode_status, STATUS),
    (p.decode_mode, {"mode": "enabled"}),
    (p.decode_running, [{"uuid": UUID}]),
    (p.decode_move, {"uuid": UUID}),
    (p.decode_update, {"type": "move_completed", "uuid": UUID, "details": ""}),
    (p.decode_target_answer, {"status": "ok"}),
    (p.decode_direction, {"angle": 1.0, "speech_detected": True}),
    (p.decode_names, ["yes1"]),
]


def test_a_target_in_radians_and_metres_the_right_antenna_first() -> None:
    told = json.loads(p.encode_target(ROW))
    assert told["target_head_pose"] == {
        "x": 0.001, "y": -0.002, "z": 0.003,
        "roll": math.radians(-5), "pitch": math.radians(10), "yaw": math.radians(20),
    }  # fmt: skip
    assert told["target_antennas"] == [math.radians(-45), math.radians(30)]
    assert told["target_body_yaw"] == math.radians(15)
    move = json.loads(p.encode_goto(ROW, 1.5))
    assert move["head_pose"] == told["target_head_pose"] and move["antennas"] == told["target_antennas"]
    assert (move["body_yaw"], move["duration"], move["interpolation"]) == (math.radians(15), 1.5, "minjerk")
    assert json.loads(p.encode_uuid(UUID)) == {"uuid": UUID}


def test_the_daemons_reports_are_decoded() -> None:
    joints = p.decode_sdk(json.dumps(JOINTS))
    assert joints == p.Joints(math.degrees(0.1), math.degrees(-0.3), math.degrees(0.2))
    head = p.decode_sdk(json.dumps(HEAD))
    assert isinstance(head, p.Head) and head.xyz_m == (0.01, 0.0, -0.02) and head.rpy_rad == (0.0, 0.0, 0.0)
    imu = p.decode_sdk(json.dumps(IMU))
    assert isinstance(imu, p.Imu) and imu.accelerometer_m_s2 == (0.0, 0.0, 9.8) and imu.temperature_c == 31.5
    assert p.decode_sdk('{"type":"recorded_data","data":[]}') is None
    status = p.decode_status(json.dumps(STATUS).encode())
    assert (status.state, status.wireless, status.simulated, status.version) == ("running", False, True, "1.13.0")
    assert math.isnan(status.battery_pct), "daemon 1.13.0 reports no charge"
    assert p.decode_status(json.dumps({**STATUS, "battery_pct": 71}).encode()).battery_pct == 71.0
    assert p.decode_status(json.dumps({**STATUS, "backend_status": {"error": "no bus"}}).encode()).error == "no bus"
    assert p.MODES[p.decode_mode(b'{"mode":"gravity_compensation"}')] == "gravity_compensation"
    assert p.decode_running(json.dumps([{"uuid": UUID}]).encode()) == (UUID,)
    assert not p.decode_target_answer(b'{"status":"ignored","reason":"move_running"}')
    left_deg, speech = p.decode_direction(b'{"angle":0.0,"speech_detected":false}') or (0.0, True)
    assert (left_deg, speech) == (90.0, False), "an angle of 0 is to the left"
    assert p.decode_direction(b"null") is None


@given(st.tuples(*[st.floats(-80, 80)] * 3, *[st.floats(-25, 25)] * 3, *[st.floats(-150, 150)] * 3))
def test_a_row_survives_the_wire_and_the_matrix(row: tuple[float, ...]) -> None:
    twin = ReachyTwin("reachy_mini", lambda: 0.0)
    twin.body.position = row
    joints, head, _ = (p.decode_sdk(json.dumps(frame)) for frame in twin._sdk_frames())
    assert isinstance(joints, p.Joints) and isinstance(head, p.Head)
    assert p.row_of(head, joints) == pytest.approx(row, abs=1e-6)


@pytest.mark.parametrize(("decode", "told"), DECODERS)
def test_fuzz_raises_only_the_codecs_error(decode: Callable[[bytes], Any], told: Any) -> None:
    chance = random.Random(7)
    good = json.dumps(told).encode()
    decode(good)
    for _ in range(DISTURBED // len(DECODERS)):
        bad = bytearray(good)
        for _ in range(chance.randint(1, 4)):
            match chance.randrange(3):
                case 0:
                    bad[chance.randrange(len(bad))] = chance.randrange(256)
                case 1:
                    del bad[chance.randrange(len(bad)) :]
                    bad += b"0"
                case _:
                    at = chance.randrange(len(bad))
                    bad[at:at] = chance.choice([b"null", b"1e999", b"[", b'"', b"-", b"NaN", b"{}"])
        with contextlib.suppress(MalformedFrame):
            decode(bytes(bad))


@pytest.mark.parametrize("value", [None, "x", [], {}, [1.0] * 6, [1.0] * 6 + ["x"], [1.0] * 6 + [None], 1e400])
def test_saf_014_invalid_joints(value: object) -> None:
    with pytest.raises(MalformedFrame):
        p.decode_sdk(json.dumps({**JOINTS, "head_joint_positions": value}))


@pytest.mark.parametrize("depth", [10, 100_000])
def test_nested_json_is_malformed(depth: int) -> None:
    with pytest.raises(MalformedFrame):
        p.decode_running(b"[" * depth + b"]" * depth)
