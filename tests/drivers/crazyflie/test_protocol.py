"""Test the codecs CRTP and CPX: known bytes, refused input, and noise."""

from __future__ import annotations

import math
import random
import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from strands_actors.drivers.common.codecs.malformed import MalformedFrame
from strands_actors.drivers.crazyflie import cpx
from strands_actors.drivers.crazyflie import protocol as p
from strands_actors.drivers.crazyflie.config import Endpoint, parse_port
from strands_actors.drivers.crazyflie.protocol import Bit
from tests.drivers.disturbed import DISTURBED

FLIGHT_ROW = p.encode(5, 2, b"\1\x10\x20\0" + struct.pack("<7eH", 0.5, 0.1, 0, 0, 90, 1, -2, 27))
POSITION_ROW = p.encode(5, 2, b"\2\0\0\0" + struct.pack("<4fB", 1.0, 2.0, 180.0, 3.75, 3))


# -- commands


def test_setpoints_are_si_here_and_degrees_on_the_wire() -> None:
    assert p.hover(0.1, -0.2, math.pi / 2, 0.4) == bytes((0x7C, 10)) + struct.pack("<4f", 0.1, -0.2, 90.0, 0.4)
    assert p.velocity(0.1, 0.2, 0.3, -math.pi) == bytes((0x7C, 8)) + struct.pack("<4f", 0.1, 0.2, 0.3, -180.0)
    flight, position = p.report_of(FLIGHT_ROW), p.report_of(POSITION_ROW)
    assert flight and position
    assert flight[0] == 0x2010
    assert isinstance(flight[1], p.Flight) and isinstance(position[1], p.Position)
    assert flight[1].wz_rad_s == pytest.approx(math.pi / 2)
    assert flight[1].pitch_rad == pytest.approx(math.radians(2.0)), (
        "pitch up is positive on the wire, pitch down is positive here"
    )
    assert flight[1].bits == Bit.CAN_BE_ARMED | Bit.ARMED | Bit.CAN_FLY | Bit.FLYING
    assert position[1].yaw_rad == pytest.approx(math.pi) and position[1].battery_v == 3.75
    assert position[1].battery_state == p.Battery.LOW_POWER


def test_orders_are_the_firmwares_bytes() -> None:
    assert p.STOP.hex() == "7c00"
    assert p.YIELD.hex() == "7d0000000000"
    assert p.ARM.hex() == "9d0101" and p.DISARM.hex() == "9d0100"
    assert p.EMERGENCY_STOP.hex() == "9d03"
    assert p.land(2.0) == bytes((0x8C, 8, 0)) + struct.pack("<ff?f", 0.0, 0.0, True, 2.0)
    by_speed = bytes((0x8C, 10, 0)) + struct.pack("<f?f?f", 0.0, False, 0.0, True, 0.4)
    assert p.land_with_velocity(0.4) == by_speed
    for order in (p.land(2.0), by_speed):
        question = p.landing_question(order)
        assert question.answered_by(order[:4] + b"\1") and p.landing_status_of(order[:4] + b"\1") == 1


def test_a_safe_hover_differs_from_a_setpoint_of_zero_by_a_sign_only() -> None:
    safe, setpoint = p.hover_still(0.5), p.hover(-0.0, 0.0, 0.0, 0.5)
    assert safe != setpoint
    assert struct.unpack("<4f", safe[2:]) == struct.unpack("<4f", setpoint[2:])


def test_our_blocks_fit_into_the_packets_that_make_and_carry_them() -> None:
    for block in (p.FLIGHT, p.POSITION):
        numbers = range(300, 300 + len(block.variables))
        assert len(p.log_create_question(block, numbers).packet) <= p.LONGEST
        assert 5 + block.layout.size <= p.LONGEST


def test_an_answer_is_matched_by_its_head_without_the_reserved_bits() -> None:
    question = p.SUPERVISOR_QUESTION
    assert question.answered_by(bytes((0x90, 0x8C, 1, 0))) and question.answered_by(bytes((0x9C, 0x8C, 1, 0)))
    for other in (b"", b"\x9c", bytes((0x9D, 0x8C, 1, 0)), bytes((0x9C, 0x0C, 1, 0))):
        assert not question.answered_by(other)


def test_airborne_means_flying_with_motors() -> None:
    assert (Bit.FLYING | Bit.ARMED).airborne
    for bits in (Bit.FLYING, Bit.ARMED, Bit.FLYING | Bit.ARMED | Bit.LOCKED, Bit(0)):
        assert not bits.airborne


# -- refused input


@pytest.mark.parametrize(
    "packet",
    [
        FLIGHT_ROW[:-1],
        FLIGHT_ROW + b"\0",
        POSITION_ROW[:-1],
        p.encode(5, 2, b"\1\0\0\0" + struct.pack("<7eH", math.nan, 0, 0, 0, 0, 0, 0, 0)),
        p.encode(5, 2, b"\2\0\0\0" + struct.pack("<4fB", math.inf, 0, 0, 0, 0)),
        b"",
        bytes(32),
    ],
)
def test_an_invalid_row_is_malformed(packet: bytes) -> None:
    with pytest.raises(MalformedFrame):
        p.report_of(packet)


def test_short_answers_are_malformed() -> None:
    for reader in (p.version_of, p.supervisor_of, p.is_armed, p.log_count_of, p.log_name_of, p.status_of):
        with pytest.raises(MalformedFrame):
            reader(b"\x9c\x8c")
    with pytest.raises(MalformedFrame):
        p.landing_status_of(p.land(2.0)[:4])


@given(st.binary(max_size=40))
def test_any_bytes_are_a_row_a_foreign_packet_or_malformed(data: bytes) -> None:
    try:
        row = p.report_of(data)
    except MalformedFrame:
        return
    assert row is None or isinstance(row[1], p.Flight | p.Position)


def test_disturbed_packets_raise_only_malformed() -> None:
    chance = random.Random(5)
    readers = (
        p.report_of,
        p.version_of,
        p.supervisor_of,
        p.is_armed,
        p.log_count_of,
        p.log_name_of,
        p.status_of,
        p.landing_status_of,
        p.firmware_of,
    )
    for _ in range(DISTURBED):
        packet = bytearray(chance.choice((FLIGHT_ROW, POSITION_ROW, p.ARM, p.land(2.0))))
        for _ in range(chance.randint(1, 4)):
            packet[chance.randrange(len(packet))] = chance.randrange(256)
        cut = bytes(packet[: chance.randint(0, len(packet))])
        for reader in readers:
            try:
                reader(cut)
            except MalformedFrame:
                continue


# -- CPX


@given(st.lists(st.binary(min_size=1, max_size=31), max_size=8), st.integers(1, 7))
def test_cpx_carries_packets_in_any_pieces(packets: list[bytes], piece: int) -> None:
    wrapped = [cpx.packet(cpx.Function.CRTP, packet) for packet in packets]
    for frame, decoder in ((cpx.tcp_frame, cpx.TcpDecoder()), (cpx.uart_frame, cpx.UartDecoder())):
        line = b"".join(frame(packet) for packet in wrapped)
        found: list[bytes] = []
        for at in range(0, len(line), piece):
            found += decoder.feed(line[at : at + piece])
        assert [cpx.parse(packet) for packet in found] == [(cpx.Function.CRTP, packet) for packet in packets]


def test_a_serial_line_recovers_from_noise_and_counts_it() -> None:
    frame = cpx.uart_frame(cpx.packet(cpx.Function.CRTP, b"hello"))
    damaged = frame[:-1] + bytes((frame[-1] ^ 1,))
    decoder = cpx.UartDecoder()
    assert decoder.feed(b"noise" + cpx.READY + damaged + frame) == [b"", frame[2:-1]]
    assert decoder.damaged >= 2


def test_tcp_gives_up_on_a_length_that_no_packet_has() -> None:
    with pytest.raises(MalformedFrame):
        cpx.TcpDecoder().feed(b"\xff\xff")
    for packet in (b"", b"\x19", b"\x19\x43"):
        with pytest.raises(MalformedFrame):
            cpx.parse(packet)
    with pytest.raises(ValueError, match="at most 100"):
        cpx.uart_frame(bytes(101))


def test_noise_on_a_serial_line_takes_no_memory() -> None:
    chance, decoder = random.Random(7), cpx.UartDecoder()
    for _ in range(DISTURBED // 20):
        decoder.feed(chance.randbytes(64))
        assert len(decoder._buffer) <= cpx.LONGEST + 3


# -- position


@pytest.mark.parametrize(
    ("port", "endpoint"),
    [
        ("192.0.2.1", Endpoint("udp", host="192.0.2.1", number=19850)),
        ("udp://192.0.2.1:19851", Endpoint("udp", host="192.0.2.1", number=19851)),
        ("tcp://192.0.2.1:5000", Endpoint("tcp", host="192.0.2.1", number=5000)),
        ("serial://ttyUSB0", Endpoint("serial", path="/dev/ttyUSB0")),
        ("serial:///dev/ttyACM1", Endpoint("serial", path="/dev/ttyACM1")),
        ("radio://0/80/2M", Endpoint("radio", channel=80, rate=2, address=bytes.fromhex("E7E7E7E7E7"))),
        (
            "radio://1/5/250K/E7E7E7E701",
            Endpoint("radio", number=1, channel=5, rate=0, address=bytes.fromhex("E7E7E7E701")),
        ),
        ("usb://0", Endpoint("usb")),
    ],
)
def test_a_port_gives_the_drones_address(port: str, endpoint: Endpoint) -> None:
    assert parse_port(port) == endpoint


@pytest.mark.parametrize(
    "port",
    [
        "",
        "udp://",
        "ftp://x",
        "radio://0/126/2M",
        "radio://0/80/3M",
        "radio://0/80/2M/E7E7",
        "usb://x",
        "serial://",
    ],
)
def test_an_invalid_port_is_refused_with_valid_ones(port: str) -> None:
    with pytest.raises(ValueError, match=r"Give"):
        parse_port(port)
