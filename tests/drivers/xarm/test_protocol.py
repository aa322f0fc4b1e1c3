"""Test the codec: frames and reports in pieces of any size, the kind of each request, and invalid input."""

from __future__ import annotations

import math
import random
import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from strands_actors.drivers.common.codecs.malformed import MalformedFrame
from strands_actors.drivers.common.twin import ClientGone, Faults
from strands_actors.drivers.xarm import protocol as p
from strands_actors.drivers.xarm import reports as r
from strands_actors.drivers.xarm.twin import ControlSession, controller_of
from tests.drivers.disturbed import DISTURBED

frames = st.tuples(st.integers(0, 0xFFFF), st.binary(min_size=1, max_size=60))
small = st.floats(-7, 7, width=32)
sevens = st.tuples(*[small] * 7)
nibbles, poses = st.integers(0, 15), st.tuples(*[small] * 6)
reports = st.builds(r.Report, nibbles, nibbles, st.integers(0, 0xFFFF), sevens, poses, sevens)
sizes = st.sampled_from([87, r.REAL_SIZE, r.NORMAL_SIZE, r.RICH_SIZE])


@given(st.lists(frames, max_size=8), st.integers(1, 64))
def test_frames_survive_any_cutting(sent: list[tuple[int, bytes]], size: int) -> None:
    stream = b"".join(p.frame(number, body) for number, body in sent)
    decoder = p.Decoder()
    received = [each for at in range(0, len(stream), size) for each in decoder.feed(stream[at : at + size])]
    assert [(each.number, each.body) for each in received] == sent
    assert {each.protocol for each in received} <= {p.PROTOCOL}


def test_known_frames() -> None:
    """The bytes are those of the vendor's client."""
    assert p.request(1, p.Register.SET_STATE, b"\x04") == bytes.fromhex("0001 0002 0002 0c 04")
    servo = p.request(2, p.Register.SERVO_JOINT, p.servo_data([0.5] * 7))
    assert len(servo) == 47
    assert struct.unpack_from("<f", servo, 7) == (0.5,)
    (heartbeat,) = p.Decoder().feed(bytes.fromhex("0000 0001 0002 0000"))
    assert heartbeat.protocol == p.HEARTBEAT_PROTOCOL
    with pytest.raises(MalformedFrame):
        p.reply_of(heartbeat)
    (received,) = p.Decoder().feed(bytes.fromhex("0007 0003 0004 0f 40 1f 00"))
    reply = p.reply_of(received)
    assert (reply.number, reply.register, reply.state) == (7, p.Register.ERRORS, p.ERROR)
    assert p.errors_of(reply.data) == (31, 0)
    assert p.error_words(31) == "31 (collision)"
    assert p.error_words(99) == "99 (unknown)"


@pytest.mark.parametrize("header", ["0001 0000 0002", "0001 0004 0002", "0001 0002 0000", "0001 0002 0401"])
def test_a_header_that_cannot_be_is_refused(header: str) -> None:
    with pytest.raises(MalformedFrame, match="protocol"):
        list(p.Decoder().feed(bytes.fromhex(header)))


# -- reports


@given(st.lists(reports, max_size=4), st.integers(1, 200), sizes)
def test_reports_survive_any_cutting(sent: list[r.Report], cut: int, size: int) -> None:
    stream = b"".join(bytes(r.pack_report(size, report)) for report in sent)
    decoder = r.ReportDecoder()
    received = [each for at in range(0, len(stream), cut) for each in decoder.feed(stream[at : at + cut])]
    assert [r.parse_report(each) for each in received] == sent


@given(st.floats(width=32))
def test_the_speed_limit_is_one_or_none(limit: float) -> None:
    data = r.pack_report(r.RICH_SIZE, r.Report(2, 1, 0, (0.0,) * 7, (0.0,) * 6, (0.0,) * 7))
    r.pack_rich(data, p.Version(7, 7, "", (1, 12, 10)), "7,7", limit, 30)
    said = r.speed_limit_of(bytes(data))
    assert said == limit if 0.0 < limit < math.inf else said is None
    assert r.speed_limit_of(bytes(data[: r.NORMAL_SIZE])) is None


def test_joints_that_are_nowhere_are_no_report() -> None:
    data = r.pack_report(r.REAL_SIZE, r.Report(2, 1, 0, (math.nan,) * 7, (0.0,) * 6, (0.0,) * 7))
    with pytest.raises(MalformedFrame, match="joints at"):
        r.parse_report(bytes(data))


# -- the version


@pytest.mark.parametrize(
    ("text", "version"),
    [
        ("7,7,XF1300012345,AC1300012345,v1.12.10", p.Version(7, 7, "XF1300012345", (1, 12, 10))),
        ("7,3,XF1000012345, ,v1.8.6-beta", p.Version(7, 3, "XF1000012345", (1, 8, 6))),
        ("6,12,,,v2.5.0", p.Version(6, 12, "", (2, 5, 0))),
    ],
)
def test_the_version_string_is_read(text: str, version: p.Version) -> None:
    assert p.parse_version(text.encode().ljust(40, b"\0")) == version


@pytest.mark.parametrize("text", ["", "v1.2.3", "7,7,XF1300012345", "x,7,XF,AC,v1.2.3"])
def test_a_version_without_a_type_is_refused(text: str) -> None:
    with pytest.raises(MalformedFrame, match="names no type"):
        p.parse_version(text.encode())


# -- the kind of a request


@pytest.mark.parametrize(
    ("register", "data", "kind"),
    [
        (p.Register.SET_STATE, b"\x04", ("safe", "stop")),
        (p.Register.SET_STATE, b"\x00", ("enable", None)),
        (p.Register.SET_STATE, b"\x03", ("config", None)),
        (p.Register.MOTION_ENABLE, b"\x08\x01", ("enable", None)),
        (p.Register.MOTION_ENABLE, b"\x08\x00", ("config", None)),
        (p.Register.SET_MODE, b"\x01", ("enable", None)),
        (p.Register.SERVO_JOINT, p.servo_data([0.1] * 7), ("setpoint", None)),
        (p.Register.SERVO_JOINT, p.servo_data([0.1] * 7, hold=True), ("safe", "hold")),
        (p.Register.SERVO_JOINT, b"", ("setpoint", None)),
        (p.Register.JOINT_VELOCITY, p.floats([0.0] * 7) + b"\x01", ("setpoint", None)),
        (p.Register.ERRORS, b"", ("read", None)),
        (p.Register.CLEAR_ERROR, b"", ("config", None)),
        (200, b"", ("other", None)),
    ],
)
def test_the_kind_of_a_request(register: int, data: bytes, kind: tuple[str, str | None]) -> None:
    assert p.classify(bytes((register,)) + data) == kind


# -- invalid input


@given(st.binary(max_size=300))
def test_any_bytes_are_incomplete_or_refused(data: bytes) -> None:
    for decode in (_hear_control, _hear_reports):
        try:
            decode(data)
        except MalformedFrame as error:
            assert str(error)


def _hear_control(data: bytes) -> None:
    for each in p.Decoder().feed(data):
        p.classify(each.body)
        reply = p.reply_of(each)
        p.errors_of(reply.data)


def _hear_reports(data: bytes) -> None:
    for each in r.ReportDecoder().feed(data):
        r.parse_report(each)
        r.speed_limit_of(each)


def test_disturbed_streams_raise_only_the_codecs_error_and_keep_nothing() -> None:
    """``STRANDS_ACTORS_FUZZ`` is their number."""
    chance = random.Random(24)
    report = bytes(r.pack_report(r.REAL_SIZE, r.Report(2, 1, 0, (0.1,) * 7, (1.0,) * 6, (0.0,) * 7)))
    whole = [
        p.request(1, p.Register.SERVO_JOINT, p.servo_data([0.5] * 7)),
        p.frame(2, bytes((p.Register.ERRORS, 0x40, 31, 0))),
        p.frame(3, bytes((p.Register.VERSION, 0)) + b"7,7,XF1300012345,AC1300012345,v1.12.10"),
        report,
    ]
    refused = 0
    for _ in range(DISTURBED):
        data = bytearray(b"".join(chance.choices(whole, k=3)))
        for _ in range(chance.randint(1, 4)):
            data[chance.randrange(len(data))] = chance.randrange(256)
        del data[chance.randrange(len(data)) :]
        for decoder in (p.Decoder(), r.ReportDecoder()):
            try:
                for each in decoder.feed(bytes(data)):
                    if isinstance(each, bytes):
                        r.parse_report(each)
                    else:
                        p.classify(each.body)
                        p.parse_version(p.reply_of(each).data)
            except MalformedFrame:
                refused += 1
            assert len(decoder._pending) <= len(data)
    assert refused > DISTURBED / 10, "many of the disturbed streams are refused"


def test_no_bytes_break_the_twins_controller() -> None:
    chance = random.Random(25)
    session = ControlSession(controller_of("xarm7"), Faults())
    for _ in range(3000):
        register = chance.choice([*p.Register, chance.randrange(256)])
        body = bytes((register, *(chance.randrange(256) for _ in range(chance.randint(0, 45)))))
        (exchange,) = session.receive(p.frame(9, body), None)
        assert exchange.request == p.frame(9, body)
    with pytest.raises(ClientGone):
        list(session.receive(b"\xff" * 20, None))
