"""The policy ``onnx``: manifests, their networks, and a run on the twin. The networks are made here."""

from __future__ import annotations

import json
import math
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import pytest

from strands_actors.caller.handle.robot import RealRobot
from strands_actors.contract.axis import Axis, AxisMode
from strands_actors.contract.wire import Observation
from strands_actors.policies.onnx.microduck import COMMAND, HOME_RAD, read_microduck
from strands_actors.policies.onnx.policy import OnnxPolicy
from strands_actors.policies.sources import choose
from strands_actors.testing import Twin
from tests.answers import until, why
from tests.robot.helpers import at, completed_run, holds

from .tiny_onnx import constant, linear

AXES = (
    Axis(key="pan", unit="deg", low=-110.0, high=110.0),
    Axis(key="grip", unit="percent", low=0.0, high=100.0),
    Axis(key="wheel", unit="rad", low=-1.0, high=1.0, mode=AxisMode.VELOCITY),
)
KEYS = [axis.key for axis in AXES]
JOINTS = [{"name": "pan", "unit": "rad", "offset": 0.5, "scale": 2.0}, {"name": "grip", "unit": "share"}]
MANIFEST: dict[str, Any] = {
    "format": "strands-actors-onnx",
    "version": 1,
    "file": "policy.onnx",
    "control_hz": 30,
    "joints": JOINTS,
    "observation": [{"block": "position"}],
    "action": {"kind": "offset", "scale": 1.0},
}

Rows = Sequence[Sequence[float]]
EYE: Rows = [[1.0, 0.0], [0.0, 1.0]]


def write(folder: Path, network: bytes, manifest: Mapping[str, Any] = MANIFEST, **changes: Any) -> Path:
    (folder / "policy.onnx").write_bytes(network)
    (folder / "manifest.json").write_text(json.dumps({**manifest, **changes}))
    return folder


def policy(folder: Path, **options: Any) -> OnnxPolicy:
    made = OnnxPolicy(KEYS, str(folder), **options)
    made.set_control_frequency(30.0)
    made.set_robot_axes(AXES)
    made.reset()
    return made


def reading(velocity: tuple[float, ...], **sensors: tuple[float, ...]) -> Observation:
    return Observation(1, (0.0,) * len(velocity), (1,) * len(velocity), velocity, sensors)


# -- from readings to numbers, and from numbers to targets


def test_units_offsets_and_scales_of_positions_and_targets(tmp_path: Path) -> None:
    # The network returns its input: each joint is commanded to where it is.
    made = policy(write(tmp_path, linear(EYE, [0.0, 0.0], "batch")))
    seen = {"pan": 90.0, "grip": 40.0, "wheel": 0.0}
    # (pi/2 - 0.5) * 2 comes in, and 0.5 + that / 2 goes out: 90 degrees again.
    assert made.get_actions_sync(seen, "") == [pytest.approx({"pan": 90.0, "grip": 40.0})]


def test_a_chunk_and_the_kind_delta(tmp_path: Path) -> None:
    delta = {"kind": "delta", "scale": 0.5, "chunk": 3}
    made = policy(write(tmp_path, constant(2, [0.0, 0.1, 0.0, 0.2, 0.0, 0.3]), action=delta))
    chunk = made.get_actions_sync({"pan": 10.0, "grip": 40.0}, "")
    assert [round(row["grip"], 3) for row in chunk] == [45.0, 50.0, 55.0]
    assert [row["pan"] for row in chunk] == [pytest.approx(10.0)] * 3


def test_history_last_action_constants_and_commands(tmp_path: Path) -> None:
    blocks = [
        {"block": "last_action"},
        {"block": "constant", "values": [3.0]},
        {"block": "command", "values": [0, 0]},
    ]
    # Inputs of two frames of (last pan, last grip, 3, command 0, command 1). pan: the older last action + 1;
    # grip: the newer command 1.
    rows = [[0.0, 0.0] for _ in range(10)]
    rows[0][0], rows[9][1] = 1.0, 1.0
    joints = [{"name": "pan", "unit": "deg"}, {"name": "grip", "unit": "percent"}]
    folder = write(tmp_path, linear(rows, [1.0, 0.0]), joints=joints, observation=blocks, history=2)
    made = policy(folder, command=[7.0, 8.0])
    seen = {"pan": 0.0, "grip": 0.0}
    got = [made.get_actions_sync(seen, "")[0] for _ in range(4)]
    assert [action["pan"] for action in got] == [1.0, 1.0, 2.0, 2.0]
    assert {action["grip"] for action in got} == {8.0}
    made.reset()
    assert made.get_actions_sync(seen, "")[0]["pan"] == 1.0
    with pytest.raises(ValueError, match="Give at most 2 finite numbers"):
        policy(folder, command=[1.0, 2.0, 3.0])


def test_velocities_sensors_and_gravity_come_from_the_whole_reading(tmp_path: Path) -> None:
    blocks = [{"block": "velocity", "scale": 2.0}, {"block": "sensor", "key": "gyro_rad_s", "size": 3}]
    rows = [[0.0, 0.0] for _ in range(8)]
    rows[0][0], rows[5][1] = 1.0, 1.0
    joints = [{"name": "pan", "unit": "rad"}, {"name": "grip", "unit": "percent"}]
    made = policy(
        write(tmp_path, linear(rows, [0.0, 0.0]), joints=joints, observation=[*blocks, {"block": "gravity"}])
    )
    seen = {"pan": 0.0, "grip": 0.0}
    with pytest.raises(ValueError, match="reads velocities, and the robot reports none"):
        made.get_actions_sync(seen, "")
    made.set_reading(reading((90.0, 0.0, 0.0)))
    with pytest.raises(ValueError, match="reads 3 values of gyro_rad_s, and the robot has no sensors"):
        made.get_actions_sync(seen, "")
    down = (0.0, math.pi / 2, 0.0)
    made.set_reading(reading((90.0, 0.0, 0.0), gyro_rad_s=(0.1, 0.2, 0.3), rpy_rad=down))
    # pan: twice 90 degrees per second in rad. grip: gravity along x, since the body points down.
    assert made.get_actions_sync(seen, "")[0] == pytest.approx({"pan": 180.0, "grip": 1.0})


# -- a manifest that lies


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"format": "other"}, "its format is 'other', version 1"),
        ({"joints": []}, "joints has 0 names"),
        ({"joints": [JOINTS[0], JOINTS[0]]}, "joints has 2 names, 1 of them different"),
        ({"joints": [{"name": "pan"}]}, r"missing required field `unit` - at `\$.joints\[0\]`"),
        (
            {"joints": [{"name": "pan", "unit": "rad", "scale": 0}]},
            "joint pan: offset or scale is no usable number",
        ),
        ({"joints": [{"name": "pan", "unit": "rad", "typo": 0}]}, "unknown field `typo`"),
        ({"control_hz": 0}, "control_hz is 0"),
        ({"control_hz": "fast"}, r"Expected `float`, got `str` - at `\$.control_hz`"),
        ({"file": "../policy.onnx"}, "Give the plain name of an .onnx file"),
        ({"file": "model.pt"}, "Give the plain name of an .onnx file"),
        ({"file": "other.onnx"}, "names other.onnx, and .* has no such file"),
        ({"history": 2, "action": {"kind": "offset", "chunk": 2}}, "a history needs chunk 1"),
        ({"history": 10**6}, "history is 1000000"),
        ({"action": {"kind": "torque"}}, "Invalid enum value 'torque'"),
        ({"observation": [{"block": "camera"}]}, "Invalid value 'camera'"),
        ({"observation": [{"block": "sensor", "key": "x", "size": -1}]}, "a sensor's size is not from 1"),
        ({"observation": []}, "observation has 0 numbers"),
    ],
)
def test_a_wrong_manifest_is_refused_by_its_field(tmp_path: Path, changes: dict[str, Any], text: str) -> None:
    folder = write(tmp_path, constant(2, [0.0, 0.0]), **changes)
    with pytest.raises(ValueError, match=text):
        choose(folder, {})


@pytest.mark.parametrize("content", [b"", b"[]", b"\xff", b"{" * 100_000, b'{"format": NaN}', bytes(1 << 21)])
def test_bytes_that_are_no_manifest_are_refused(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "manifest.json").write_bytes(content)
    with pytest.raises(ValueError, match=r"manifest\.json is (no JSON object|larger than)"):
        choose(tmp_path, {})


def test_a_network_without_a_manifest_is_refused(tmp_path: Path) -> None:
    (tmp_path / "policy.onnx").write_bytes(constant(2, [0.0, 0.0]))
    with pytest.raises(ValueError, match=r"has no manifest\.json beside it"):
        choose(tmp_path, {})


@pytest.mark.parametrize(
    ("network", "text"),
    [
        (constant(3, [0.0, 0.0]), "reads tensor.float. of shape .1, 3., and the observation .* has 2 numbers"),
        (constant(2, [0.0, 0.0, 0.0]), "writes float32 of shape .1, 3., and the manifest has 1 rows of 2 joints"),
        (linear(EYE, [0.0, 0.0], extra_input=True), "has 2 inputs and 1 outputs .obs, memory, actions."),
        (b"not a network", "is no network that onnxruntime can load"),
        (b"", "is no network that onnxruntime can load"),
    ],
    ids=["inputs", "outputs", "recurrent", "text", "empty"],
)
def test_a_manifest_that_does_not_fit_its_network_is_refused(tmp_path: Path, network: bytes, text: str) -> None:
    with pytest.raises(ValueError, match=text):
        policy(write(tmp_path, network))


def test_a_network_with_weights_in_other_files_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    weights = tmp_path.parent / "weights.bin"
    for place in (weights, tmp_path / "weights.bin"):
        place.write_bytes(bytes(16))
    for name in ("weights.bin", "../weights.bin", str(weights)):
        with pytest.raises(ValueError, match="is no network that onnxruntime can load"):
            policy(write(tmp_path, linear(EYE, [0.0, 0.0], weights_in=name)))


def test_a_manifest_that_does_not_fit_the_robot_is_refused(tmp_path: Path) -> None:
    network = constant(2, [0.0, 0.0])
    with pytest.raises(ValueError, match="commands tail, and the robot has pan, grip, wheel"):
        policy(write(tmp_path, network, joints=[JOINTS[0], {"name": "tail", "unit": "rad"}]))
    with pytest.raises(ValueError, match="has grip in 'rad', and the robot takes a position in 'percent'"):
        policy(write(tmp_path, network, joints=[JOINTS[0], {"name": "grip", "unit": "rad"}]))
    with pytest.raises(ValueError, match="the robot takes a velocity in 'rad'"):
        policy(write(tmp_path, network, joints=[JOINTS[0], {"name": "wheel", "unit": "rad"}]))
    made = policy(write(tmp_path, network))
    with pytest.raises(ValueError, match="states 30 Hz, and the run has 50 Hz"):
        made.set_control_frequency(50.0)


# -- manifests of the Microduck community

DUCK_AXES = tuple(Axis(key=name, unit="rad", low=-3.0, high=3.0) for name in (*HOME_RAD, "mouth"))
DUCK: dict[str, Any] = {
    "schema_version": 2,
    "model_api": 1,
    "obs_len": 61,
    "action_len": 14,
    "robot": {"model": "microduck", "hw_rev": 1, "servos": "xl330", "control_hz": 50},
    "name": "polite-bow",
    "kind": "episodic",
    "duration_s": 0.04,
    "command": {"encoding": "constant", "idle": [0.5, 0, 0], "twist": "unused (zeros)"},
    "training": {"commit": "0bf9897"},
}


def test_a_microduck_skill_gets_its_61_numbers_in_their_order(tmp_path: Path) -> None:
    # Output 0 copies one of the 61 inputs, output 13 another one.
    for first, last, expected in (
        (0, 2, (0.1, 0.3)),  # gyro
        (3, 5, (0.0, -1.0)),  # gravity, standing
        (6, 19, (0.25, 0.5)),  # positions minus the home pose
        (20, 33, (1.5, 2.5)),  # velocities, without the mouth
        (48, 50, (0.2, 0.7)),  # the twist
    ):
        rows = [[0.0] * 14 for _ in range(61)]
        rows[first][0], rows[last][13] = 1.0, 1.0
        made = OnnxPolicy(
            [axis.key for axis in DUCK_AXES],
            str(write(tmp_path, linear(rows, [0.0] * 14), DUCK)),
            "",
            [0.2, 0.0, 0.7],
        )
        made.set_control_frequency(50.0)
        made.set_robot_axes(DUCK_AXES)
        velocity = (1.5, *(0.0,) * 12, 2.5, 9.0)
        made.set_reading(reading(velocity, gyro_rad_s=(0.1, 0.2, 0.3), rpy_rad=(0.0, 0.0, 1.0)))
        seen = {**HOME_RAD, "left_hip_yaw": 0.25, "right_ankle": HOME_RAD["right_ankle"] + 0.5, "mouth": 1.0}
        (action,) = made.get_actions_sync(seen, "")
        assert list(action) == list(HOME_RAD)
        got = (action["left_hip_yaw"], action["right_ankle"] - HOME_RAD["right_ankle"])
        assert got == pytest.approx(expected, abs=1e-6), (first, last)
        assert action["left_knee"] == pytest.approx(HOME_RAD["left_knee"])


def test_an_episode_ends_in_the_idle_twist(tmp_path: Path) -> None:
    rows = [[0.0] * 14 for _ in range(61)]
    rows[48][0] = 1.0
    made = OnnxPolicy(list(HOME_RAD), str(write(tmp_path, linear(rows, [0.0] * 14), DUCK)), "", [0.2])
    made.set_robot_axes(DUCK_AXES)
    made.set_reading(reading((0.0,) * 14, gyro_rad_s=(0.0,) * 3, rpy_rad=(0.0,) * 3))
    twists = [made.get_actions_sync(HOME_RAD, "")[0]["left_hip_yaw"] for _ in range(4)]
    assert twists == pytest.approx([0.2, 0.2, 0.5, 0.5])


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"obs_len": 51}, "obs_len is 51 and action_len 14. A Microduck has 61 and 14"),
        ({"action_len": 15}, "action_len 15"),
        ({"robot": {"model": "openduck"}}, "robot is 'openduck' at 50 Hz"),
        ({"robot": {"model": "microduck", "control_hz": 100}}, "at 100 Hz"),
        ({"model_api": 2}, "model_api is 2, a recurrent network"),
        ({"command": {"encoding": "phase", "period_s": 2.0}}, "the encoding 'phase', which only robotd gives"),
        ({"action_scale": 0}, "action_scale, duration_s or idle is no usable number"),
        ({"duration_s": -1}, "and a duration above 0"),
        ({"kind": "forever"}, "kind is 'forever'"),
        ({"file": "../../etc/policy.onnx"}, "Give the plain name"),
        ({"obs_len": "many"}, r"Expected `int`, got `str` - at `\$.obs_len`"),
    ],
)
def test_a_wrong_claim_of_a_microduck_manifest_is_refused(changes: dict[str, Any], text: str) -> None:
    with pytest.raises(ValueError, match=text):
        read_microduck(json.dumps({**DUCK, **changes}).encode())


def test_a_set_of_skills_needs_the_name_of_one(tmp_path: Path) -> None:
    entries = [
        {"file": "kick_left.onnx", "kind": "episodic", "duration_s": 1.0},
        {"file": "walk.onnx", "name": "gait"},
    ]
    content = {"schema_version": 2, "policies": entries}
    (tmp_path / "manifest.json").write_text(json.dumps(content))
    (tmp_path / "walk.onnx").write_bytes(constant(61, [0.0] * 14))
    assert choose(tmp_path, {"skill": "gait"}).options == {"folder": str(tmp_path), "skill": "gait"}
    assert len(HOME_RAD) == 14 and OnnxPolicy(list(HOME_RAD), str(tmp_path), "gait", [0.0] * COMMAND)
    for skill in ("", "roulade"):
        with pytest.raises(ValueError, match=r"is a set\. Give skill, one of gait, kick_left"):
            OnnxPolicy(list(HOME_RAD), str(tmp_path), skill)
    with pytest.raises(ValueError, match=r"names kick_left\.onnx, and .* has no such file"):
        OnnxPolicy(list(HOME_RAD), str(tmp_path), "kick_left")


# -- on the twin


def test_a_network_drives_the_arm_and_its_lies_do_not(arm: RealRobot, twin: Twin, tmp_path: Path) -> None:
    joints = [{"name": "shoulder_pan", "unit": "rad"}, {"name": "gripper", "unit": "percent"}]
    target = math.radians(arm.get_observation()["shoulder_pan"] + 4.0)
    step = {"kind": "absolute", "chunk": 1}
    began_ns = time.monotonic_ns()
    folder = write(tmp_path, constant(2, [target, 20.0]), joints=joints, action=step)
    assert completed_run(arm, folder, seconds=0.5)["source"] == "folder"
    at(arm, "shoulder_pan", math.degrees(target), within=2.0)
    assert until(lambda: holds(twin.log, began_ns), "the arm holds")

    began_ns = time.monotonic_ns()
    for bias, text in (
        ([math.nan, 20.0], "gate: move: shoulder_pan is nan. Send a finite number"),
        ([9.0, 20.0], "gate: move: shoulder_pan 515"),
        ([0.0, 20.0, 1.0], "policy: ValueError: onnx: "),
    ):
        answer = arm.run(write(tmp_path, constant(2, bias), joints=joints, action=step), seconds=5.0)
        assert text in why(answer)
    assert not twin.log.host("setpoint", began_ns)
