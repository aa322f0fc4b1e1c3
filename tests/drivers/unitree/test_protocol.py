"""Compare Unitree's frames with their published layout, and the checksum with a bitwise one."""

from __future__ import annotations

import math
import struct
from collections.abc import Iterable, Sequence
from itertools import chain

import pytest
from hypothesis import given
from hypothesis import strategies as st

from strands_actors.drivers.common.codecs.malformed import MalformedFrame
from strands_actors.drivers.unitree import protocol as p
from strands_actors.drivers.unitree import rpc
from strands_actors.drivers.unitree.protocol import Command, CommandCodec, State, StateCodec, WrongChecksum
from strands_actors.drivers.unitree.robots import TABLES, Model, model_of

ROBOTS = tuple(TABLES.robots)
SINGLE = st.floats(width=32, allow_nan=False, allow_infinity=False)


def rows(model: Model) -> list[tuple[float, ...]]:
    """Return q, dq, tau, kp and kd. Each number shows its row and joint."""
    return [tuple(100.0 * row + at for at in range(len(model.joints))) for row in range(1, 6)]


def flat(rows: Iterable[Sequence[float]]) -> list[float]:
    return list(chain.from_iterable(rows))


def sample(model: Model, soc: int = 77) -> State:
    q, dq, tau, *_ = rows(model)
    return State(
        machine=5 if model.family == "hg" else 0,
        tick=123456,
        quaternion=(1.0, 2.0, 3.0, 4.0),
        gyroscope=(5.0, 6.0, 7.0),
        accelerometer=(8.0, 9.0, 10.0),
        q=q,
        dq=dq,
        tau=tau,
        temperature=tuple(range(len(model.joints))),
        soc=soc if model.family == "go" else None,
    )


def slow_crc(words: list[int]) -> int:
    """Return the CRC-32 as the robot's firmware computes it: bit by bit, most significant first."""
    crc = 0xFFFFFFFF
    for word in words:
        for bit in range(31, -1, -1):
            top = crc >> 31 ^ word >> bit & 1
            crc = (crc << 1 & 0xFFFFFFFF) ^ (0x04C11DB7 if top else 0)
    return crc


def image(body: bytes, first_motor: int) -> bytes:
    """Return the C struct, in which each motor's mode byte is followed by padding."""
    before = b"\0" * (-first_motor % 4)
    after = first_motor + 1 + (-(first_motor + 1) % 4)
    return body[:first_motor] + before + body[first_motor : first_motor + 1] + b"\0\0\0" + body[after:]


@pytest.mark.parametrize(("family", "frame", "first", "size"), [
    ("hg", "command", 2, 1004), ("go", "command", 22, 812), ("hg", "state", 70, 2092),
])  # fmt: skip
def test_the_c_struct_has_the_size_that_the_firmware_sums(family: str, frame: str, first: int, size: int) -> None:
    sizes = {"command": p.COMMAND_BYTES, "state": p.STATE_BYTES}[frame]
    assert len(image(bytes(sizes[family]), first)) == size  # type: ignore[index]  # a family's name


@pytest.mark.parametrize("robot", ROBOTS)
def test_a_command_is_summed_as_the_firmware_does(robot: str) -> None:
    model = model_of(robot)
    body = CommandCodec(model).encode(5, flat(rows(model)))
    whole = image(body, 2 if model.family == "hg" else 22)
    words = list(struct.unpack(f"<{len(whole) // 4}I", whole))
    assert slow_crc(words[:-1]) == words[-1]


def test_the_bitwise_sum_is_crc_32_mpeg_2() -> None:
    """The expected values are from a polynomial division of one word: all ones, and its complement."""
    assert slow_crc([0xFFFFFFFF]) == 0
    assert slow_crc([0]) == 0xC704DD7B


@pytest.mark.parametrize("robot", ROBOTS)
def test_a_command_puts_every_joint_into_its_slot(robot: str) -> None:
    model = model_of(robot)
    columns = rows(model)
    body = CommandCodec(model).encode(5, flat(columns))
    stride, first = (28, 4) if model.family == "hg" else (36, 24)
    assert len(body) == {"hg": 1000, "go": 808}[model.family]
    for at, joint in enumerate(model.joints):
        mode_at = (2 if model.family == "hg" else 22) if joint.slot == 0 else first - 4 + stride * joint.slot
        assert body[mode_at] == joint.mode
        q, dq, tau, kp, kd = struct.unpack_from("<5f", body, first + stride * joint.slot)
        assert (q, dq, tau, kp, kd) == tuple(column[at] for column in columns)
    unused = set(range(p.SLOTS[model.family])) - set(model.slots)
    for slot in unused:
        start = first - 4 + stride * slot
        assert not any(body[start : start + stride])
    if model.family == "hg":
        assert tuple(body[:2]) == (0, 5)
    else:
        assert body[:3] == b"\xfe\xef\xff"


@pytest.mark.parametrize("robot", ROBOTS)
def test_a_state_is_read_from_where_it_stands(robot: str) -> None:
    model = model_of(robot)
    state = sample(model)
    body = StateCodec(model).encode(state)
    hg = model.family == "hg"
    assert len(body) == (2088 if hg else 1176)
    assert struct.unpack_from("<10f", body, 16 if hg else 24) == tuple(float(n) for n in range(1, 11))
    assert struct.unpack_from("<I", body, 12 if hg else 1096) == (123456,)
    stride, first = (56, 72) if hg else (48, 80)
    for at, joint in enumerate(model.joints):
        q, dq, _, tau = struct.unpack_from("<4f", body, first + stride * joint.slot)
        assert (q, dq, tau) == (state.q[at], state.dq[at], state.tau[at])
    if hg:
        assert body[9] == 5
    else:
        assert body[1039] == 77
    assert StateCodec(model).decode(body) == state
    assert StateCodec(model).decode(memoryview(body)) == state


@pytest.mark.parametrize("robot", ["unitree_g1", "unitree_h1"])
def test_a_command_reads_back(robot: str) -> None:
    model = model_of(robot)

    @given(st.lists(SINGLE, min_size=len(model.joints), max_size=len(model.joints)), st.integers(0, 255))
    def reads_back(q: list[float], machine: int) -> None:
        codec = CommandCodec(model)
        zero = (0.0,) * len(q)
        command = codec.decode(codec.encode(machine, flat((q, zero, zero, zero, zero))))
        machine_said = machine if model.family == "hg" else 0
        assert command == Command(machine_said, codec.modes, tuple(q), zero, zero, zero, zero)

    reads_back()


@pytest.mark.parametrize("robot", ["unitree_g1", "unitree_go2"])
@given(data=st.data())
def test_one_wrong_bit_is_no_command(robot: str, data: st.DataObject) -> None:
    model = model_of(robot)
    codec = CommandCodec(model)
    body = bytearray(codec.encode(5, flat(rows(model))))
    # The padding bytes of CDR are not in the C struct.
    padding = {3} if model.family == "hg" else {23}
    at = data.draw(st.integers(0, len(body) - 1).filter(lambda byte: byte not in padding))
    body[at] ^= 1 << data.draw(st.integers(0, 7))
    with pytest.raises(MalformedFrame):
        codec.decode(bytes(body))


@pytest.mark.parametrize("robot", ROBOTS)
def test_a_frame_neither_keeps_nor_changes_an_earlier_frame(robot: str) -> None:
    model = model_of(robot)
    codec, zeros = CommandCodec(model), [0.0] * (5 * len(model.joints))
    first = codec.encode(5, flat(rows(model)))
    kept = bytes(first)
    assert codec.encode(0, zeros) == CommandCodec(model).encode(0, zeros)
    with pytest.raises((struct.error, OverflowError)):
        codec.encode(0, [*zeros[:-1], 1e300])  # overflows single precision
    assert codec.encode(0, zeros) == CommandCodec(model).encode(0, zeros)
    assert first == kept == codec.encode(5, flat(rows(model)))


def test_the_frame_of_the_other_family_is_no_command() -> None:
    hg, go = model_of("unitree_g1"), model_of("unitree_go2")
    with pytest.raises(MalformedFrame, match="1000 bytes, not 808"):
        CommandCodec(hg).decode(CommandCodec(go).encode(0, flat(rows(go))))


@given(st.binary(max_size=3000))
def test_noise_raises_only_the_codecs_error(noise: bytes) -> None:
    model = model_of("unitree_g1")
    for read in (
        CommandCodec(model).decode,
        StateCodec(model).decode,
        rpc.decode_request,
        rpc.decode_response,
        p.decode_battery,
    ):
        with pytest.raises(MalformedFrame):
            read(noise)


@pytest.mark.parametrize("robot", ROBOTS)
@pytest.mark.parametrize("row", ["quaternion", "gyroscope", "accelerometer", "q", "dq", "tau"])
@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_saf_014_a_state_with_a_non_finite_number_is_refused(robot: str, row: str, value: float) -> None:
    """The wire holds joints at the positions in a state."""
    codec = StateCodec(model_of(robot))
    state = sample(model_of(robot))
    broken = state._replace(**{row: (*getattr(state, row)[:-1], value)})
    with pytest.raises(MalformedFrame, match="not finite"):
        codec.decode(codec.encode(broken))
    assert codec.decode(codec.encode(state)).q == state.q, "the codec keeps nothing of the refused state"


def test_a_battery_is_read_from_its_state_of_charge() -> None:
    body = bytearray(164)
    body[100] = 42
    assert p.decode_battery(bytes(body)) == 42
    body[100] = 101
    with pytest.raises(MalformedFrame, match="101 percent"):
        p.decode_battery(bytes(body))


# -- services


def test_a_request_has_the_published_layout() -> None:
    body = rpc.encode_request(rpc.Request(7, rpc.SET_FSM_ID, '{"data": 1}', True))
    assert struct.unpack_from("<qqqi?", body) == (7, 7101, 0, 0, True)
    assert body[32:36] == struct.pack("<I", 12)
    assert body[36:48] == b'{"data": 1}\0'
    assert body[48:] == bytes(4)  # an empty sequence of bytes


def test_a_response_has_the_published_layout() -> None:
    body = rpc.encode_response(rpc.Response(7, rpc.GET_FSM_ID, 0, "ab"))
    assert struct.unpack_from("<qqi", body) == (7, 7001, 0)
    assert body[20:24] == struct.pack("<I", 3)
    assert body[24:28] == b"ab\0\0"
    assert body[28:] == bytes(4)


@given(st.integers(-(2**63), 2**63 - 1), st.integers(0, 10_000), st.text(max_size=200), st.booleans())
def test_requests_and_responses_read_back(number: int, api: int, text: str, flag: bool) -> None:
    request = rpc.Request(number, api, text, flag)
    assert rpc.decode_request(rpc.encode_request(request)) == request
    response = rpc.Response(number, api, -5, text)
    assert rpc.decode_response(rpc.encode_response(response)) == response


@pytest.mark.parametrize("data", ["", "{}", '{"data": "801"}', '{"data": true}', "[1]", "nan", "["])
def test_an_invalid_fsm_id_is_refused(data: str) -> None:
    with pytest.raises(MalformedFrame):
        rpc.fsm_id(rpc.Response(1, rpc.GET_FSM_ID, 0, data))


def test_the_answers_of_the_services() -> None:
    assert rpc.fsm_id(rpc.Response(1, rpc.GET_FSM_ID, 0, '{"data": 801}')) == 801
    assert rpc.mode_name(rpc.Response(1, rpc.CHECK_MODE, 0, '{"form":"0","name":"ai"}')) == "ai"
    assert rpc.Response(1, 1, 0).error == ""
    assert rpc.Response(1, 1, 3104).error == "the service does not answer (3104)"
    assert rpc.Response(1, 1, 9999).error == "an error (9999)"


# -- the tables


@pytest.mark.parametrize(("robot", "family", "joints", "slots"), [
    ("unitree_g1", "hg", 29, tuple(range(29))),
    ("unitree_go2", "go", 12, tuple(range(12))),
    ("b2", "go", 12, tuple(range(12))),
    ("unitree_h1", "go", 19, (*range(9), *range(10, 20))),
    ("unitree_h1_2", "hg", 27, tuple(range(27))),
])  # fmt: skip
def test_the_robots_and_their_slots(robot: str, family: str, joints: int, slots: tuple[int, ...]) -> None:
    model = model_of(robot)
    assert (model.family, len(model.joints), model.slots) == (family, joints, slots)
    assert len(set(model.axes)) == joints
    for joint in model.joints:
        assert joint.low < 0.1 and joint.low < joint.high
        assert 0 < joint.kp <= model.max_kp and 0 < joint.kd <= model.max_kd
        assert joint.torque > 0 and joint.speed > 0


def test_the_motor_order_of_the_sdk() -> None:
    assert model_of("g1").axes[:7] == (
        "left_hip_pitch", "left_hip_roll", "left_hip_yaw", "left_knee", "left_ankle_pitch", "left_ankle_roll",
        "right_hip_pitch",
    )  # fmt: skip
    assert model_of("g1").axes[12:16] == ("waist_yaw", "waist_roll", "waist_pitch", "left_shoulder_pitch")
    assert model_of("go2").axes[:4] == ("FR_hip_joint", "FR_thigh_joint", "FR_calf_joint", "FL_hip_joint")
    assert model_of("b2").axes == model_of("go2").axes
    h1 = dict(zip(model_of("h1").axes, model_of("h1").slots, strict=True))
    assert (h1["right_hip_roll"], h1["torso"], h1["left_ankle"], h1["left_elbow"]) == (0, 6, 10, 19)
    assert model_of("h1_2").axes[12:14] == ("torso_joint", "left_shoulder_pitch_joint")


@pytest.mark.parametrize(("joint", "low", "high", "torque", "speed"), [
    ("left_hip_roll", -0.5236, 2.9671, 88, 20),  # the smaller of two sources, each
    ("right_hip_roll", -2.9671, 0.5236, 88, 20),
    ("left_knee", -0.087267, 2.8798, 139, 20),
    ("right_shoulder_roll", -2.2515, 1.5882, 25, 37),
    ("waist_pitch", -0.52, 0.52, 35, 30),
    ("right_wrist_yaw", -1.61443, 1.61443, 5, 22),
])  # fmt: skip
def test_the_limits_of_the_joints_of_a_g1(joint: str, low: float, high: float, torque: float, speed: float) -> None:
    found = next(row for row in model_of("g1").joints if row.key == joint)
    assert (found.low, found.high, found.torque, found.speed) == (low, high, torque, speed)


def test_left_and_right_mirror_each_other() -> None:
    for robot in ("unitree_g1", "unitree_h1", "unitree_h1_2"):
        joints = {joint.key: joint for joint in model_of(robot).joints}
        for key, left in joints.items():
            if key.startswith("left_"):
                right = joints[key.replace("left_", "right_", 1)]
                assert {(left.low, left.high), (-left.high, -left.low)} >= {(right.low, right.high)}
                assert (left.torque, left.speed, left.kp, left.kd) == (
                    right.torque, right.speed, right.kp, right.kd,
                )  # fmt: skip


def test_a_state_has_roll_pitch_and_yaw() -> None:
    """Some clients do not convert the quaternion themselves."""
    half = math.sqrt(0.5)
    for robot, at in (("unitree_g1", 56), ("unitree_go2", 64)):
        model = model_of(robot)
        count = len(model.joints)
        zero = (0.0,) * count
        state = State(5, 1, (half, half, 0.0, 0.0), (0.0,) * 3, (0.0,) * 3, zero, zero, zero, (30,) * count, 80)
        body = StateCodec(model).encode(state)
        assert struct.unpack_from("<3f", body, at) == pytest.approx((math.pi / 2, 0.0, 0.0), abs=1e-6)


def test_a_state_without_a_checksum_is_for_simulators() -> None:
    model = model_of("unitree_g1")
    zero = (0.0,) * 29
    state = State(0, 1, (1.0, 0.0, 0.0, 0.0), (0.0,) * 3, (0.0,) * 3, zero, zero, zero, (30,) * 29, None)
    sealed = StateCodec(model).encode(state)
    unsealed, wrong = sealed[:-4] + bytes(4), sealed[:-4] + b"\x01\0\0\0"
    assert StateCodec(model, unsealed=True).decode(unsealed) == StateCodec(model).decode(sealed)
    assert StateCodec(model, unsealed=True).decode(sealed).machine == 0
    for codec, body in ((StateCodec(model), unsealed), (StateCodec(model, unsealed=True), wrong)):
        with pytest.raises(WrongChecksum):
            codec.decode(body)
