"""Test the flights that the high-level commander plans, and those that are uploaded."""

from __future__ import annotations

import math
import struct
from collections.abc import Sequence

import pytest

from strands_actors.drivers.common.codecs.malformed import MalformedFrame
from strands_actors.drivers.crazyflie import protocol as p
from strands_actors.drivers.crazyflie.protocol import Bit, HighLevel, Port
from strands_actors.drivers.crazyflie.twin.memories import Kind
from strands_actors.drivers.crazyflie.twin.trajectories import (
    PIECE,
    Flight,
    Moment,
    compressed_pieces_in,
    piece_between,
    pieces_in,
    spiral,
    straight,
)

from .bench import Bench

TRAJECTORY = 1
"""Number of the memory for trajectories."""


def ahead(way_m: float, duration_s: float, x0_m: float = 0.0) -> bytes:
    """Encode a piece that flies along x from rest to rest at one metre, turning by a quarter."""
    piece = piece_between(Moment((x0_m, 0.0, 1.0), 0.0), Moment((x0_m + way_m, 0.0, 1.0), math.pi / 2), duration_s)
    rows = (piece.x, piece.y, piece.z, piece.yaw)
    return PIECE.pack(*(value for row in rows for value in row), duration_s)


def upload(bench: Bench, data: bytes, address: int = 0) -> None:
    """Write bytes into the memory for trajectories, in packets of 25 bytes."""
    for start in range(0, len(data), 25):
        head = struct.pack("<BI", TRAJECTORY, address + start)
        assert bench.ask(Port.MEMORY, 2, head + data[start : start + 25]) == head + b"\0"


def define(bench: Bench, count: int, number: int = 1, kind: int = 0, offset: int = 0) -> int:
    return bench.order(struct.pack("<BBBBIB", HighLevel.DEFINE_TRAJECTORY, number, 1, kind, offset, count))


def start(bench: Bench, number: int = 1, scale: float = 1.0, relative: bool = False, reverse: bool = False) -> int:
    return bench.order(struct.pack("<BB??Bf", HighLevel.START_TRAJECTORY, 0, relative, reverse, number, scale))


def take_off(bench: Bench, height_m: float = 1.0) -> None:
    bench.arm()
    assert bench.order(struct.pack("<BBff?f", HighLevel.TAKEOFF, 0, height_m, 0.0, True, 2.0)) == 0
    bench.run(3.0)
    assert bench.height_m == pytest.approx(height_m, abs=0.03)


def place(bench: Bench) -> Sequence[float]:
    return bench.firmware.body.xyz_m


def near(x: float, y: float, z: float, within_m: float = 0.04) -> object:
    return pytest.approx((x, y, z), abs=within_m)


# -- pure


def test_a_planned_piece_has_its_ends_without_jerk() -> None:
    begin = Moment((0.0, 1.0, 0.5), 0.1, (0.2, -0.1, 0.0), 0.3, (0.5, 0.0, -0.2))
    end = Moment((1.0, -1.0, 1.5), 1.2, (0.1, 0.4, 0.2), -0.2, (0.0, 0.3, 0.1))
    piece = piece_between(begin, end, 2.5)
    for moment, t_s in ((begin, 0.0), (end, 2.5)):
        for one, other in zip(piece.moment_at(t_s), moment, strict=True):
            assert one == pytest.approx(other, abs=1e-9)
    assert piece.x[3] == 0.0, "no jerk at the start"
    late, later = piece.moment_at(2.5 - 2e-4).acceleration_m_s2[0], piece.moment_at(2.5).acceleration_m_s2[0]
    assert abs(later - late) / 2e-4 < 0.05, "no jerk at the end"


def test_a_flight_is_stretched_reversed_and_shifted() -> None:
    pieces = [
        piece_between(Moment((0.0, 0.0, 1.0), 0.0), Moment((1.0, 0.0, 1.0), 0.0), 1.0),
        piece_between(Moment((1.0, 0.0, 1.0), 0.0), Moment((1.0, 2.0, 1.0), 0.0), 2.0),
    ]
    slow = Flight(pieces, 10.0, 2.0)
    assert slow.ends_s == 16.0
    assert slow.moment_at(12.0).xyz_m == pytest.approx((1.0, 0.0, 1.0))
    assert slow.moment_at(14.0).velocity_m_s[1] == pytest.approx(
        Flight(pieces, 10.0).moment_at(12.0).velocity_m_s[1] / 2
    )
    assert slow.moment_at(99.0) == Moment((pytest.approx(1.0), pytest.approx(2.0), 1.0), 0.0), "it stays at its end"
    back = Flight(pieces, 0.0, reverse=True)
    assert back.moment_at(0.0).xyz_m == pytest.approx((1.0, 2.0, 1.0)) and back.moment_at(1.0).velocity_m_s[1] < 0
    assert back.moment_at(3.0).xyz_m == pytest.approx((0.0, 0.0, 1.0))
    shifted = Flight(pieces, 0.0)
    shifted.shift_to((5.0, 5.0, 0.5))
    assert shifted.moment_at(3.0).xyz_m == pytest.approx((6.0, 7.0, 0.5))
    turned = Flight(pieces, 0.0)
    turned.shift_to((5.0, 5.0, 0.5), math.pi / 2)
    assert turned.moment_at(1.0).xyz_m == pytest.approx((5.0, 6.0, 0.5))
    assert turned.moment_at(0.5).velocity_m_s[1] > 0.5 and turned.moment_at(0.0).yaw_rad == pytest.approx(
        math.pi / 2
    )


def test_a_straight_piece_has_one_speed() -> None:
    piece = straight(Moment((0.0, 0.0, 1.0), 0.0), (2.0, 0.0, 1.0), 1.0, 4.0)
    for t_s in (0.0, 1.0, 2.5, 4.0):
        assert piece.moment_at(t_s).velocity_m_s == pytest.approx((0.5, 0.0, 0.0))
        assert piece.moment_at(t_s).yaw_rate_rad_s == pytest.approx(0.25)


@pytest.mark.parametrize(("style", "end"), [(0, (0.5, 0.5)), (2, (0.5, -0.5)), (1, (-0.5, 0.5)), (3, (0.5, 0.5))])
def test_a_spiral_goes_around_a_centre_beside_the_drone(style: int, end: tuple[float, float]) -> None:
    """A quarter of a circle to the left or (clockwise) to the right; sideways, the centre is ahead or behind."""
    piece = spiral(Moment((0.0, 0.0, 1.0), 0.0), math.pi / 2, (0.5, 0.5), 0.2, 4.0, style)
    begin, last = piece.moment_at(0.0), piece.moment_at(4.0)
    assert last.xyz_m == pytest.approx((*end, 1.2), abs=1e-9)
    speed = [0.5 * math.pi / 8, 0.0]
    assert begin.velocity_m_s[:2] == pytest.approx(speed[::-1] if style & 1 else speed, abs=1e-9)
    assert abs(last.yaw_rad) == pytest.approx(math.pi / 2)


def test_compressed_pieces_are_curves_by_their_control_points() -> None:
    """The example of the vendor's page: a header 0x0a 0xd0 0x07 has cubic curves for x and y, for 2000 ms."""
    memory = struct.pack("<4h", 0, 0, 1000, 900) + b"\x0a\xd0\x07" + struct.pack("<6h", 0, 1000, 1000, 0, 900, 0)
    memory += b"\x41\xe8\x03" + struct.pack("<2h", 2000, 1800) + bytes(3)
    first, second = compressed_pieces_in(memory, 0)
    assert first.duration_s == 2.0 and second.duration_s == 1.0
    assert first.moment_at(0.0) == Moment(
        (0.0, 0.0, 1.0),
        pytest.approx(math.pi / 2),
        pytest.approx((0.0, 0.0, 0.0)),
        0.0,
        pytest.approx((1.5, 1.35, 0.0)),
    )
    assert first.moment_at(2.0).xyz_m == pytest.approx((1.0, 0.0, 1.0))
    assert first.moment_at(1.0).xyz_m == pytest.approx((0.5, 0.3375, 1.0))
    end = second.moment_at(1.0)
    assert end.xyz_m == pytest.approx((2.0, 0.0, 1.0)) and end.yaw_rad == pytest.approx(math.pi)


def test_a_trajectory_outside_the_memory_is_malformed() -> None:
    with pytest.raises(MalformedFrame):
        pieces_in(bytes(4096), 0, 32)
    assert len(pieces_in(bytes(4096), 0, 31)) == 31
    with pytest.raises(MalformedFrame):
        compressed_pieces_in(bytes(4096), 4090)


# -- flown


def test_an_uploaded_trajectory_is_flown_with_its_yaw_and_held_at_its_end() -> None:
    bench = Bench()
    take_off(bench)
    upload(bench, ahead(1.0, 2.0) + ahead(-0.5, 2.0, 1.0))
    assert define(bench, 2) == start(bench) == 0
    bench.run(2.0)
    assert place(bench) == near(1.0, 0.0, 1.0, 0.2)
    assert Bit.HIGH_LEVEL_ACTIVE in bench.firmware.bits and Bit.TRAJECTORY_FINISHED not in bench.firmware.bits
    bench.run(3.0)
    assert place(bench) == near(0.5, 0.0, 1.0) and Bit.TRAJECTORY_FINISHED in bench.firmware.bits
    assert bench.firmware.body.rpy_rad[2] == pytest.approx(math.pi / 2, abs=0.05)
    assert bench.order(struct.pack("<BBff?f", HighLevel.LAND, 0, 0.0, 0.0, True, 2.0)) == 0
    bench.run(2.5)
    assert not bench.firmware.motors_on and abs(bench.height_m) < 0.02


@pytest.mark.parametrize(
    ("scale", "relative", "reverse", "end"),
    [
        (1.0, True, False, (0.5, 0.0, 1.5)),
        (2.0, False, False, (0.5, 0.0, 1.0)),
        (1.0, False, True, (0.0, 0.0, 1.0)),
    ],
)
def test_a_trajectory_is_flown_relative_slower_or_backwards(
    scale: float, relative: bool, reverse: bool, end: tuple[float, float, float]
) -> None:
    bench = Bench()
    take_off(bench, 1.5 if relative else 1.0)
    upload(bench, ahead(0.5, 2.0))
    assert define(bench, 1) == start(bench, 1, scale, relative, reverse) == 0
    bench.run(2.5)
    assert (Bit.TRAJECTORY_FINISHED in bench.firmware.bits) == (scale == 1.0)
    bench.run(3.0)
    assert place(bench) == near(*end)


@pytest.mark.parametrize(("turned", "end"), [(False, (0.5, 0.0)), (True, (0.0, 0.5))])
def test_a_trajectory_is_turned_to_the_present_yaw(turned: bool, end: tuple[float, float]) -> None:
    bench = Bench()
    take_off(bench)
    assert bench.order(struct.pack("<BB?5f", HighLevel.GO_TO, 0, True, 0.0, 0.0, 0.0, math.pi / 2, 1.0)) == 0
    bench.run(2.0)
    upload(bench, ahead(0.5, 2.0))
    assert define(bench, 1) == 0
    assert bench.order(struct.pack("<BB???Bf", HighLevel.START_TRAJECTORY_2, 0, True, turned, False, 1, 1.0)) == 0
    bench.run(4.0)
    assert place(bench) == near(*end, 1.0, 0.08)
    yaw_rad = math.pi if turned else math.pi / 2
    assert math.remainder(bench.firmware.body.rpy_rad[2] - yaw_rad, math.tau) == pytest.approx(0.0, abs=0.05)


def test_a_compressed_trajectory_is_flown() -> None:
    bench = Bench()
    take_off(bench)
    curve = struct.pack("<4h", 0, 0, 0, 0) + b"\x0a\xb8\x0b" + struct.pack("<6h", 0, 1000, 1000, 0, 500, 500)
    upload(bench, curve, 200)
    assert define(bench, 2, 3, 1, 200) == 0
    assert start(bench, 3, 2.0, True) == 8 and start(bench, 3, 1.0, True, True) == 8, "only as it is"
    assert start(bench, 3, 1.0, True) == 0
    bench.run(4.0)
    assert place(bench) == near(1.0, 0.5, 1.0)


def test_an_undefined_trajectory_flies_nowhere_and_a_tenth_cannot_be_defined() -> None:
    bench = Bench()
    take_off(bench)
    assert define(bench, 1, 10) == 8
    assert start(bench, 7) == 0, "the firmware answers success"
    bench.run(1.0)
    assert place(bench) == near(0.0, 0.0, 1.0)
    define(bench, 32, 2)
    reaction = bench.firmware.receive(p.encode(Port.HIGH_LEVEL, 0, b"\5\0\0\0\2" + struct.pack("<f", 1.0)))
    assert reaction.kind == "garbled", "its pieces are outside the memory"
    bench.run(0.5)
    assert place(bench) == near(0.0, 0.0, 1.0)


def test_a_trajectory_with_a_number_that_is_not_finite_disables_the_commander() -> None:
    bench = Bench()
    take_off(bench)
    upload(bench, PIECE.pack(*[math.nan] * 32, 2.0))
    assert define(bench, 1) == start(bench) == 0
    bench.run(0.2)
    assert Bit.HIGH_LEVEL_DISABLED in bench.firmware.bits and bench.firmware.motors_on, "its last setpoint is left"
    bench.run(2.0)
    assert bench.firmware.locked


def test_it_goes_to_places_straight_or_smooth_and_around() -> None:
    bench = Bench()
    take_off(bench)
    go_to = struct.pack("<BB??5f", HighLevel.GO_TO_2, 0, False, False, 0.5, -0.3, 0.7, math.pi / 2, 2.0)
    assert bench.order(go_to) == 0
    bench.run(3.0)
    assert place(bench) == near(0.5, -0.3, 0.7)
    assert bench.firmware.body.rpy_rad[2] == pytest.approx(math.pi / 2, abs=0.05)
    assert bench.order(struct.pack("<BB?5f", HighLevel.GO_TO, 0, True, 0.5, 0.3, 0.3, -math.pi / 2, 2.0)) == 0
    bench.run(3.0)
    assert place(bench) == near(1.0, 0.0, 1.0)
    assert bench.order(struct.pack("<BB??5f", HighLevel.GO_TO_2, 0, True, True, -1.0, 0.0, 0.0, 0.0, 2.0)) == 0
    bench.run(1.0)
    assert bench.firmware.body.velocity_m_s[0] == pytest.approx(-0.5, abs=0.1)
    bench.run(2.0)
    assert bench.order(struct.pack("<BB??5f", HighLevel.SPIRAL, 0, False, False, math.pi, 0.4, 0.4, 0.0, 4.0)) == 0
    bench.run(5.0)
    assert place(bench) == near(0.0, 0.8, 1.0, 0.1)


def test_a_takeoff_and_a_landing_turn_to_a_yaw_and_go_by_speed() -> None:
    bench = Bench()
    bench.arm()
    up = struct.pack("<BBf?f?f", HighLevel.TAKEOFF_WITH_VELOCITY, 0, 0.8, False, 1.0, False, 0.0)
    assert bench.order(up) == 0
    bench.run(1.55)
    assert Bit.TRAJECTORY_FINISHED not in bench.firmware.bits, "hlCommander.vtoff: 0.5 m/s"
    bench.run(1.5)
    assert bench.height_m == pytest.approx(0.8, abs=0.02)
    assert bench.firmware.body.rpy_rad[2] == pytest.approx(1.0, abs=0.05)


def test_an_order_for_another_group_has_no_effect() -> None:
    bench = Bench()
    bench.arm()
    assert bench.order(bytes((HighLevel.SET_GROUP_MASK, 2))) == 0
    for group, rises in ((1, False), (3, True)):
        assert bench.order(struct.pack("<BBff?f", HighLevel.TAKEOFF, group, 0.5, 0.0, True, 1.0)) == 0
        bench.run(1.0)
        assert (bench.height_m > 0.3) == rises


def test_trajectories_are_lost_when_it_is_switched_off_and_other_memories_are_not() -> None:
    bench = Bench()
    upload(bench, b"\x11" * 25)
    eeprom = struct.pack("<BI", 0, 100)
    assert bench.ask(Port.MEMORY, 2, eeprom + b"\x22")[-1] == 0
    bench.firmware.boot()
    assert bench.ask(Port.MEMORY, 1, struct.pack("<BIB", TRAJECTORY, 0, 2))[-2:] == b"\0\0"
    assert bench.ask(Port.MEMORY, 1, eeprom + b"\1")[-1] == 0x22
    assert bench.firmware.memories.describe(TRAJECTORY)[0] == Kind.TRAJECTORY
