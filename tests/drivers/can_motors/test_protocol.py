"""The frames of the motors and the bytes of the adapters."""

from __future__ import annotations

import math
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from strands_actors.drivers.can_motors.adapters import ADAPTERS, DamiaoSerial, RobStrideSerial, Slcan, SocketCan
from strands_actors.drivers.can_motors.protocol import (
    CODECS,
    Command,
    Damiao,
    Feedback,
    Frame,
    Parameter,
    Ranges,
    RobStride,
    State,
)
from strands_actors.drivers.can_motors.robots import TYPES, Motor
from strands_actors.drivers.can_motors.twin.adapters import AnyAdapter

RANGES = Ranges(12.5, 30.0, 10.0, 500.0, 5.0)


def codec(family: str = "damiao", sign: int = 1, offset: float = 0.0) -> Any:
    return CODECS[family](1, 0x11, RANGES, sign, offset)


def test_a_damiao_command_has_the_bytes_of_the_vendors_library() -> None:
    # Worked out by hand from the formula of DM_CAN.py: q 16 bits, dq, kp, kd, tau 12 bits each.
    frame = codec().command(Command(q=0.0, dq=0.0, tau=0.0, kp=500.0, kd=5.0))
    assert frame == Frame(1, bytes.fromhex("8000 7fff fffff 800".replace(" ", "")))
    assert codec().enable().data.hex() == "fffffffffffffffc"
    assert codec().disable() == Frame(1, bytes.fromhex("fffffffffffffffd"))
    assert codec().read(9) == Frame(0x7FF, bytes.fromhex("0100330900000000"))
    assert codec().write(9, 4000) == Frame(0x7FF, bytes.fromhex("01005509a00f0000"))
    assert codec().ask() == Frame(0x7FF, bytes.fromhex("0100cc0000000000"))


def test_a_robstride_command_has_its_torque_in_the_id() -> None:
    frame = codec("robstride").command(Command(q=0.0, tau=10.0, kp=500.0, kd=0.0))
    assert frame == Frame(0x01FFFF01, bytes.fromhex("80007fffffff0000"), True)
    assert codec("robstride").enable() == Frame(0x0300FD01, bytes(8), True)
    assert codec("robstride").clear() == Frame(0x0400FD01, b"\x01" + bytes(7), True)
    assert codec("robstride").write(0x7028, 4000).data.hex() == "28700000a00f0000"


@pytest.mark.parametrize("family", CODECS)
def test_zero_speed_tells_a_hold_from_a_setpoint(family: str) -> None:
    setpoint, hold = (codec(family).command(Command(0.1, kp=10.0, hold=hold)).data for hold in (False, True))
    assert setpoint != hold
    # A setpoint never has the speed of a hold, even if its own speed rounds to it.
    tiny = 1e-6
    assert codec(family).command(Command(0.1, dq=tiny, kp=10.0)).data == setpoint


@pytest.mark.parametrize(("sign", "offset"), [(1, 0.0), (-1, 0.5)])
def test_feedback_is_that_of_the_joint(sign: int, offset: float) -> None:
    made = codec(sign=sign, offset=offset)
    position = round((sign * 0.3 + offset + 12.5) / 25 * 65535)
    velocity = round((sign * 1.5 + 30) / 60 * 4095)
    data = bytes((0x11,)) + (position << 24 | velocity << 12 | 2048).to_bytes(5, "big") + bytes((30, 40))
    decoded = made.decode(Frame(0x11, data))
    assert isinstance(decoded, Feedback)
    assert decoded.position == pytest.approx(0.3, abs=1e-3)
    assert decoded.velocity == pytest.approx(1.5, abs=0.02)
    assert (decoded.driver_c, decoded.rotor_c, decoded.state) == (30.0, 40.0, State.ENABLED)


def test_states_of_both_families() -> None:
    def damiao(state: int) -> object:
        return codec().decode(Frame(0x11, bytes((state << 4 | 1,)) + bytes(7))).state

    assert damiao(0xD) is State.LOST_COMMUNICATION
    assert damiao(0x9) is State.UNDERVOLTAGE
    assert damiao(0x4) is State.UNKNOWN, "a state that is not documented is a fault"

    def robstride(bits: int) -> object:
        return codec("robstride").decode(Frame(0x020001FD | bits << 16, bytes(8), True)).state

    assert robstride(0x80) is State.ENABLED
    assert robstride(0) is State.DISABLED
    assert robstride(0x81) is State.UNDERVOLTAGE


def test_a_parameter_is_no_feedback() -> None:
    decoded = codec().decode(Frame(0x11, bytes.fromhex("0100330900000000")))
    assert decoded == Parameter(9, bytes(4))
    assert Parameter(21, bytes.fromhex("00004841")).real == 12.5


@pytest.mark.parametrize("frame", [Frame(0x12, bytes(8)), Frame(0x11, bytes(7)), Frame(0x11, bytes(8), True)])
def test_a_frame_of_another_sender_is_ignored(frame: Frame) -> None:
    assert codec().decode(frame) is None
    assert codec("robstride").decode(frame) is None


numbers = st.floats(-40, 40, allow_nan=False)


@settings(max_examples=30)
@given(
    name=st.sampled_from(sorted(TYPES)),
    q=numbers,
    dq=numbers,
    tau=numbers,
    kp=st.floats(0, 600),
    kd=st.floats(0, 200),
    sign=st.sampled_from([1, -1]),
)
def test_any_command_has_eight_bytes(
    name: str, q: float, dq: float, tau: float, kp: float, kd: float, sign: int
) -> None:
    motor = Motor(key="joint", motor=name, id=5, sign=1, low=-1, high=1, speed=1, torque=1, kp=1, kd=1)
    made = CODECS[motor.type.family](5, 21, motor.type.ranges, sign, 0.0)
    frame = made.command(Command(q, dq, tau, kp, kd))
    assert len(frame.data) == 8
    assert frame.id < 1 << 29


frames = st.builds(Frame, st.integers(0, 0x7FF), st.binary(min_size=8, max_size=8), st.just(False)) | st.builds(
    Frame, st.integers(0, 0x1FFFFFFF), st.binary(min_size=8, max_size=8), st.just(True)
)


@pytest.mark.parametrize("adapter", [SocketCan, Slcan, RobStrideSerial])
@settings(max_examples=30)
@given(sent=st.lists(frames, max_size=5), noise=st.binary(max_size=40), cut=st.integers(1, 20))
def test_an_adapter_finds_the_frames_after_noise(
    adapter: type[Any], sent: list[Frame], noise: bytes, cut: int
) -> None:
    made = adapter()
    if adapter is not SocketCan:
        list(made.feed(noise.replace(b"AT", b"at")))
        list(made.feed(made.END))
    data = b"".join(map(adapter().encode, sent))
    if adapter is SocketCan:
        cut = 16
    received = [frame for start in range(0, len(data), cut) for frame in made.feed(data[start : start + cut])]
    assert received[-len(sent) :] == sent or adapter is RobStrideSerial


@settings(max_examples=30)
@given(sent=st.lists(frames, min_size=1, max_size=5), cut=st.integers(1, 20))
def test_damiaos_adapter(sent: list[Frame], cut: int) -> None:
    robot, client = AnyAdapter(), DamiaoSerial()
    data = b"".join(map(client.encode, sent))
    heard = [frame for start in range(0, len(data), cut) for _, frame, _ in robot.frames(data[start : start + cut])]
    assert heard == sent
    back = b"".join(robot.encode(frame) for frame in sent)
    assert [frame for start in range(0, len(back), cut) for frame in client.feed(back[start : start + cut])] == sent


@pytest.mark.parametrize("name", ADAPTERS)
@settings(max_examples=30)
@given(pieces=st.lists(st.binary(max_size=60), max_size=8))
def test_noise_is_dropped(name: str, pieces: list[bytes]) -> None:
    """Nothing but frames comes out, and the memory is bounded."""
    made: Any = ADAPTERS[name]()
    for piece in pieces:
        for frame in made.feed(piece):
            assert len(frame.data) <= 8
            assert math.isfinite(frame.id)
    assert len(getattr(made, "_rest", b"")) <= 64


@settings(max_examples=30)
@given(pieces=st.lists(st.binary(max_size=60), max_size=8))
def test_the_twins_adapter_survives_noise(pieces: list[bytes]) -> None:
    made = AnyAdapter()
    for piece in pieces:
        for request, _, _ in made.frames(piece):
            assert request
    assert len(made._rest) <= 256


def test_an_incomplete_line_does_not_spoil_the_next() -> None:
    adapter, frame = Slcan(), Frame(1, bytes(8))
    list(adapter.feed(b"t001812"))
    assert list(adapter.feed(adapter.END + adapter.encode(frame))) == [frame]


def test_robstrides_parameter_has_the_index_of_its_request() -> None:
    data = bytes.fromhex("28700000a00f0000")
    decoded = codec("robstride").decode(Frame(0x110001FD, data, True))
    assert isinstance(decoded, Parameter)
    assert (decoded.number, decoded.whole) == (RobStride.TIMEOUT, 4000)
    assert Damiao.TIMEOUT == 9
