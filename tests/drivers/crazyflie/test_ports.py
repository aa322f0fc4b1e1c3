"""Test the simulated firmware's ports for memories, parameters, the log, setpoints and localization."""

from __future__ import annotations

import math
import struct
import zlib

import pytest

from strands_actors.drivers.crazyflie import protocol as p
from strands_actors.drivers.crazyflie.protocol import Battery, Bit, Order, Port, Setpoint
from strands_actors.drivers.crazyflie.twin.firmware import ADDRESS
from strands_actors.drivers.crazyflie.twin.memories import Kind
from strands_actors.drivers.crazyflie.twin.parameter_port import Command
from strands_actors.drivers.crazyflie.twin.setpoints import HOVER_THRUST
from strands_actors.drivers.crazyflie.twin.tables import LOG, PARAMETERS

from .bench import Bench

NUMBERS = {each.full: number for number, each in enumerate(PARAMETERS)}
VARIABLES = {each.full: number for number, each in enumerate(LOG)}


def number_of(name: str) -> bytes:
    return struct.pack("<H", NUMBERS[name])


def write(bench: Bench, name: str, value: bytes) -> None:
    assert bench.ask(Port.PARAMETERS, 2, number_of(name) + value) == number_of(name) + value


def read(bench: Bench, name: str) -> bytes:
    answer = bench.ask(Port.PARAMETERS, 1, number_of(name))
    assert answer[:3] == number_of(name) + b"\0"
    return answer[3:]


def logged(bench: Bench, *names: str) -> tuple[float, ...]:
    """Return the values of float variables by a block that is reported once."""
    items = b"".join(struct.pack("<BH", 7, VARIABLES[name]) for name in names)
    assert bench.ask(Port.LOG, 1, b"\6\x63" + items)[2] == 0
    assert bench.ask(Port.LOG, 1, b"\3\x63\0")[2] == 0
    (report,) = bench.firmware.reports()
    assert bench.ask(Port.LOG, 1, b"\2\x63")[2] == 0
    return struct.unpack(f"<{len(names)}f", report[5:])


# -- memories


def test_each_memory_is_described_and_a_deck_is_named_by_its_own() -> None:
    bench = Bench()
    kinds = {}
    for number in range(bench.ask(Port.MEMORY, 0, b"\1")[1]):
        answer = bench.ask(Port.MEMORY, 0, bytes((2, number)))
        assert answer[:2] == bytes((2, number)) and len(answer) == 15
        kinds[answer[2]] = number, struct.unpack("<I", answer[3:7])[0]
    assert set(kinds) == set(Kind)
    assert kinds[Kind.TRAJECTORY][1] == 4096
    number, size = kinds[Kind.ONE_WIRE]
    assert size == 112
    data = bench.ask(Port.MEMORY, 1, struct.pack("<BIB", number, 0, 24))[6:]
    assert data[0] == 0xEB and data[7] == zlib.crc32(data[:7]) & 0xFF
    length = data[9]
    assert data[12 : 12 + data[11]] == b"bcFlow2" and data[10 + length] == zlib.crc32(data[8 : 10 + length]) & 0xFF


def test_an_address_outside_a_memory_gives_error_5() -> None:
    bench = Bench()
    for number, address, count in ((1, 4094, 4), (1, 0xFFFFFFFF, 4), (3, 0x10000000, 4), (1, 0, 30)):
        head = struct.pack("<BI", number, address)
        assert bench.ask(Port.MEMORY, 1, head + bytes((count,))) == head + b"\5"
        if count < 30:
            assert bench.ask(Port.MEMORY, 2, head + bytes(count)) == head + b"\5"
    assert bench.firmware.receive(p.encode(Port.MEMORY, 0, b"\3\1")).replies == (), (
        "no memory can be erased at once"
    )
    assert bench.ask(Port.MEMORY, 1, struct.pack("<BIB", 3, 0, 4))[6:] == b"\3\0\0\0", "no deck has a memory"


@pytest.mark.parametrize(("channel", "data"), [(0, b"\2\5"), (1, b"\5\0\0\0\0\4"), (2, b"\5\0\0\0\0\4")])
def test_a_memory_that_is_not_there_lets_the_firmware_fail_an_assertion(channel: int, data: bytes) -> None:
    bench = Bench()
    bench.fly()
    assert bench.firmware.receive(p.encode(Port.MEMORY, channel, data)).replies == ()
    bench.run(1.0)
    assert bench.notes == ["assertion failed: restarted"] and abs(bench.height_m) < 0.02


def test_the_tester_memory_returns_addresses_and_counts_wrong_packets() -> None:
    bench = Bench()
    head = struct.pack("<BI", 2, 0x0711)
    assert bench.ask(Port.MEMORY, 1, head + b"\3") == head + b"\0\x11\x12\x13"
    assert bench.ask(Port.MEMORY, 2, head + b"\x11\x12\x13")[-1] == 0
    assert bench.firmware.reading.memory_errors == 0
    assert bench.ask(Port.MEMORY, 2, head + b"\x11\x11\x14")[-1] == 0
    assert bench.firmware.reading.memory_errors == 1
    write(bench, "memTst.resetW", b"\1")
    assert bench.firmware.reading.memory_errors == 0


# -- parameters


def test_the_table_of_parameters_is_read_by_number() -> None:
    bench = Bench()
    assert struct.unpack("<H", bench.ask(Port.PARAMETERS, 0, b"\3")[1:3])[0] == len(PARAMETERS)
    item = bench.ask(Port.PARAMETERS, 0, b"\2" + number_of("posCtlPid.xKp"))
    assert item[4:] == b"posCtlPid\0xKp\0" and item[3] & 0x0F == 6
    assert bench.ask(Port.PARAMETERS, 0, b"\2\xff\xff") == b"\2", "past its end"
    assert bench.ask(Port.PARAMETERS, 1, b"\xff\xff") == b"\xff\xff\2"
    assert all(len(f"{each.group}{each.name}") + 2 <= 26 for each in (*PARAMETERS, *LOG)), "a name fits a packet"


def test_a_read_only_parameter_cannot_be_written() -> None:
    bench = Bench()
    before = read(bench, "deck.bcFlow2")
    write_it = p.encode(Port.PARAMETERS, 2, number_of("deck.bcFlow2") + b"\0")
    assert bench.firmware.receive(write_it).replies == ()
    assert read(bench, "deck.bcFlow2") == before == b"\1"


def test_a_parameter_is_set_by_name() -> None:
    bench = Bench()

    def set_by_name(name: bytes, kind: int, value: bytes) -> int:
        head = b"\0" + name.replace(b".", b"\0") + b"\0"
        answer = bench.ask(Port.PARAMETERS, 3, head + bytes((kind,)) + value)
        assert answer[:-1] == head
        return answer[-1]

    assert set_by_name(b"stabilizer.controller", 8, b"\2") == 0 and read(bench, "stabilizer.controller") == b"\2"
    assert set_by_name(b"stabilizer.nothing", 8, b"\2") == 2
    assert set_by_name(b"stabilizer.controller", 9, b"\1\0") == 22
    assert set_by_name(b"deck.bcFlow2", 8, b"\0") == 13


def test_a_stored_value_survives_that_it_is_switched_off() -> None:
    bench = Bench()
    name = "ring.effect"
    head = number_of(name)

    def command(number: int) -> bytes:
        answer = bench.ask(Port.PARAMETERS, 3, bytes((number,)) + head)
        assert answer[:3] == bytes((number,)) + head
        return answer[3:]

    default = read(bench, name)
    assert command(Command.GET_EXTENDED_TYPE) == b"\1" and command(Command.GET_EXTENDED_TYPE_2) == b"\0\1"
    assert command(Command.GET_DEFAULT) == default and command(Command.GET_DEFAULT_2) == b"\0" + default
    assert command(Command.GET_STATE) == b"\0" + default
    write(bench, name, b"\x0a")
    assert command(Command.STORE) == b"\0" and command(Command.GET_STATE) == b"\1" + default + b"\x0a"
    bench.firmware.boot()
    assert read(bench, name) == b"\x0a"
    assert command(Command.CLEAR) == b"\0" and command(Command.GET_STATE) == b"\0" + default
    bench.firmware.boot()
    assert read(bench, name) == default
    for number in range(2, 9):
        assert bench.ask(Port.PARAMETERS, 3, bytes((number,)) + b"\xff\xff")[3:] == b"\2"
    assert bench.firmware.receive(p.encode(Port.PARAMETERS, 3, b"\1" + head)).replies == ()


def test_the_gains_of_the_position_controller_have_their_effect() -> None:
    speeds = []
    for most in (1.0, 0.3):
        bench = Bench()
        bench.fly()
        write(bench, "posCtlPid.xVelMax", struct.pack("<f", most))
        bench.run(1.0, p.encode(Port.SETPOINT, 0, struct.pack("<Bffff", Setpoint.POSITION, 3.0, 0.0, 0.5, 0.0)))
        speeds.append(bench.firmware.body.velocity_m_s[0])
    assert speeds == [pytest.approx(1.0, abs=0.1), pytest.approx(0.3, abs=0.05)]


def test_the_parameter_that_stops_locks_the_drone() -> None:
    bench = Bench()
    bench.fly()
    write(bench, "stabilizer.stop", b"\1")
    bench.run(0.2)
    assert Bit.LOCKED in bench.firmware.bits and not bench.firmware.motors_on


# -- estimator


def test_a_reset_of_the_estimator_settles_again_and_begins_where_it_is_told() -> None:
    bench = Bench()
    bench.run(2.0)
    names = ("kalman.varX", "kalman.varY", "kalman.varZ", "kalman.varPX", "kalman.varPY", "kalman.varPZ")
    assert max(logged(bench, *names)) < 1e-3
    write(bench, "kalman.initialX", struct.pack("<f", 1.5))
    write(bench, "kalman.initialYaw", struct.pack("<f", math.pi / 2))
    write(bench, "kalman.resetEstimation", b"\1")
    (told,) = bench.firmware.reports()
    assert told[1:] == b"\1" + number_of("kalman.resetEstimation") + b"\0", "the firmware takes it back"
    assert logged(bench, "kalman.varX")[0] > 100.0
    bench.run(1.0)
    assert max(logged(bench, *names)) < 1e-3
    assert logged(bench, "stateEstimate.x", "stateEstimate.y", "stateEstimate.yaw") == pytest.approx(
        (1.5, 0.0, 90.0), abs=1e-4
    )
    bench.arm()
    position = struct.pack("<Bffff", Setpoint.POSITION, 1.5, 0.5, 0.6, 90.0)
    bench.run(4.0, p.encode(Port.SETPOINT, 0, position))
    assert logged(bench, "stateEstimate.y")[0] == pytest.approx(0.5, abs=0.03)
    assert bench.firmware.body.xyz_m == pytest.approx((0.5, 0.0, 0.6), abs=0.03), "it began with another yaw"


def test_a_position_from_outside_moves_the_estimate() -> None:
    bench = Bench()
    bench.firmware.receive(p.encode(Port.LOCALIZATION, 0, struct.pack("<fff", 1.0, 2.0, 0.3)))
    assert logged(bench, "stateEstimate.x", "stateEstimate.y", "stateEstimate.z") == pytest.approx((1.0, 2.0, 0.3))
    half = math.radians(30.0) / 2
    pose = struct.pack("<B7f", 8, 0.0, 0.0, 0.0, 0.0, 0.0, math.sin(half), math.cos(half))
    bench.firmware.receive(p.encode(Port.LOCALIZATION, 1, pose))
    assert logged(bench, "stateEstimate.x", "stateEstimate.yaw") == pytest.approx((0.0, 30.0), abs=1e-4)
    assert (
        bench.firmware.receive(p.encode(Port.LOCALIZATION, 0, struct.pack("<fff", math.nan, 0, 0))).kind
        == "garbled"
    )


def test_packed_positions_and_poses_reach_the_drone_with_their_address() -> None:
    bench = Bench()
    others, mine = struct.pack("<B3h", ADDRESS ^ 1, 4000, 4000, 400), struct.pack("<B3h", ADDRESS, 1000, -2000, 300)
    bench.firmware.receive(p.encode(Port.LOCALIZATION, 2, mine + others))
    assert logged(bench, "stateEstimate.x", "stateEstimate.y", "stateEstimate.z") == pytest.approx((1.0, -2.0, 0.3))
    turned = struct.pack("<I", (3 << 30) | round(math.sin(math.pi / 4) / math.sqrt(0.5) * 511))  # a quarter, left
    level = struct.pack("<I", 3 << 30)
    bench.firmware.receive(p.encode(Port.LOCALIZATION, 1, b"\x09" + others + level + mine + turned))
    assert logged(bench, "stateEstimate.x", "stateEstimate.yaw") == pytest.approx((1.0, 90.0), abs=0.1)


# -- log


def test_a_log_block_is_created_extended_and_reported_once_or_by_the_millisecond() -> None:
    bench = Bench()
    variable = struct.pack("<BH", 7, VARIABLES["pm.vbat"])
    assert bench.ask(Port.LOG, 1, b"\6\1" + variable) == b"\6\1\0"
    assert bench.ask(Port.LOG, 1, b"\6\1" + variable)[2] == 17
    assert bench.ask(Port.LOG, 1, b"\7\1" + 5 * variable)[2] == 0
    assert bench.ask(Port.LOG, 1, b"\7\1" + variable)[2] == 7
    assert bench.ask(Port.LOG, 1, b"\7\2" + variable)[2] == 2
    assert bench.ask(Port.LOG, 1, b"\6\2" + b"\7\xfe\xff")[2] == 2
    for number in range(3, 17):
        assert bench.ask(Port.LOG, 1, bytes((6, number)))[2] == 0
    assert bench.ask(Port.LOG, 1, b"\6\x63")[2] == 12, "sixteen blocks at most"
    assert bench.ask(Port.LOG, 1, b"\3\1\0")[2] == 0
    assert len(list(bench.firmware.reports())) == 1 and list(bench.firmware.reports()) == []
    assert bench.ask(Port.LOG, 1, b"\x08\1" + struct.pack("<H", 50))[2] == 0
    assert len(list(bench.firmware.reports())) == 1
    bench.run(0.05)
    (report,) = bench.firmware.reports()
    assert struct.unpack("<6f", report[5:]) == (4.0,) * 6
    assert bench.ask(Port.LOG, 1, b"\4\1")[2] == 0
    bench.run(0.1)
    assert list(bench.firmware.reports()) == []
    assert bench.ask(Port.LOG, 1, b"\x09\1")[2] == 8
    assert bench.ask(Port.LOG, 0, b"\2\xff\xff") == b"\2"


# -- setpoints


def test_it_follows_every_kind_of_setpoint() -> None:
    def flown(kind: int, layout: str, *values: float, seconds: float = 2.0) -> Bench:
        bench = Bench()
        bench.fly(1.0)
        bench.run(seconds, p.encode(Port.SETPOINT, 0, bytes((kind,)) + struct.pack(layout, *values)))
        return bench

    there = flown(Setpoint.POSITION, "<ffff", 0.5, -0.5, 1.2, 45.0, seconds=4.0)
    assert there.firmware.body.xyz_m == pytest.approx((0.5, -0.5, 1.2), abs=0.03)
    assert math.degrees(there.firmware.body.rpy_rad[2]) == pytest.approx(45.0, abs=3.0)
    for kind, turn in ((Setpoint.HOVER, 1), (Setpoint.OLD_HOVER, -1)):
        hovers = flown(kind, "<ffff", 0.2, 0.0, 30.0 * turn, 0.8)
        assert hovers.height_m == pytest.approx(0.8, abs=0.03)
        assert math.degrees(hovers.firmware.body.wz_rad_s) == pytest.approx(30.0, abs=2.0)
    for kind, turn in ((Setpoint.VELOCITY_WORLD, 1), (Setpoint.OLD_VELOCITY_WORLD, -1)):
        flies = flown(kind, "<ffff", 0.2, 0.3, 0.1, 30.0 * turn)
        assert flies.firmware.body.velocity_m_s == pytest.approx((0.2, 0.3, 0.1), abs=0.05)
        assert math.degrees(flies.firmware.body.wz_rad_s) == pytest.approx(30.0, abs=2.0)
    for kind, turn in ((Setpoint.Z_DISTANCE, 1), (Setpoint.OLD_Z_DISTANCE, -1)):
        tilts = flown(kind, "<ffff", 0.0, -5.0, 20.0 * turn, 1.0, seconds=1.0)
        assert math.degrees(tilts.firmware.body.rpy_rad[1]) == pytest.approx(5.0, abs=1.0), "nose down"
        assert tilts.firmware.body.velocity_m_s[0] > 0.3
        assert math.degrees(tilts.firmware.body.wz_rad_s) == pytest.approx(20.0, abs=2.0)
    climbs = flown(Setpoint.ALTITUDE_HOLD, "<ffff", 5.0, 0.0, 0.0, 0.2, seconds=1.0)
    assert climbs.firmware.body.velocity_m_s[2] == pytest.approx(0.2, abs=0.05)
    assert climbs.firmware.body.velocity_m_s[1] < -0.3, "a positive roll leads to the right"
    manual = flown(Setpoint.MANUAL, "<fffH?", 0.0, 0.0, 0.0, round(HOVER_THRUST * 1.2), False, seconds=0.5)
    assert manual.firmware.body.velocity_m_s[2] > 0.5


def test_a_full_state_gives_place_speed_and_yaw() -> None:
    """The quaternion is packed as the vendor's client does it: a turn of 90 degrees to the left."""
    bench = Bench()
    bench.fly()
    size = round(511 * math.sin(math.radians(45.0)) / math.sqrt(0.5))
    for largest, packed in ((3, 3 << 30 | size), (2, 2 << 30 | size)):
        state = struct.pack("<9hI3h", 300, -200, 700, 0, 0, 0, 0, 0, 0, packed, 0, 0, 0)
        bench.run(4.0, p.encode(Port.SETPOINT, 0, bytes((Setpoint.FULL_STATE,)) + state))
        assert bench.firmware.body.xyz_m == pytest.approx((0.3, -0.2, 0.7), abs=0.03), largest
        assert math.degrees(bench.firmware.body.rpy_rad[2]) == pytest.approx(90.0, abs=3.0), largest


def test_the_old_port_flies_by_thrust_after_a_setpoint_without_thrust() -> None:
    def rpyt(thrust: int) -> bytes:
        return p.encode(Port.RPYT, 0, struct.pack("<fffH", 0.0, 0.0, 0.0, thrust))

    bench = Bench()
    bench.arm()
    bench.run(0.5, rpyt(45000))
    assert not bench.firmware.motors_on, "the thrust is locked"
    bench.run(0.1, rpyt(0))
    bench.run(0.5, rpyt(45000))
    assert bench.firmware.body.velocity_m_s[2] > 0.5
    bench.run(0.1, rpyt(999))
    assert not bench.firmware.motors_on, "less than 1000 is none"


@pytest.mark.parametrize(
    ("mode", "roll", "pitch", "thrust", "speed", "place"),
    [
        ("posSet", 0.0, -0.5, 500, None, (0.5, 0.0, 0.5)),
        ("althold", 0.0, 0.0, 32767, (0.0, 0.0, 0.0), None),
        ("althold", 0.0, 0.0, 42597, (0.0, 0.0, 0.3), None),
        ("poshold", 0.0, 9.0, round(HOVER_THRUST), (0.3, 0.0, 0.0), None),
        ("poshold", 9.0, 0.0, round(HOVER_THRUST), (0.0, 0.3, 0.0), None),
    ],
)
def test_a_flight_mode_gives_other_meanings_to_the_numbers_of_the_old_port(
    mode: str,
    roll: float,
    pitch: float,
    thrust: int,
    speed: tuple[float, float, float] | None,
    place: tuple[float, float, float] | None,
) -> None:
    bench = Bench()
    bench.fly()
    write(bench, f"flightmode.{mode}", b"\1")
    bench.firmware.receive(p.encode(Port.RPYT, 0, struct.pack("<fffH", 0.0, 0.0, 0.0, 0)))
    bench.run(2.0, p.encode(Port.RPYT, 0, struct.pack("<fffH", roll, pitch, 0.0, thrust)))
    if speed is not None:
        assert bench.firmware.body.velocity_m_s == pytest.approx(speed, abs=0.03)
    if place is not None:
        assert bench.firmware.body.xyz_m == pytest.approx(place, abs=0.05)


def test_manual_rates_and_numbers_that_are_not_finite_are_no_setpoints() -> None:
    bench = Bench()
    bench.fly()
    rates = bytes((Setpoint.MANUAL,)) + struct.pack("<fffH?", 0.0, 0.0, 0.0, 40000, True)
    for data in (
        rates,
        struct.pack("<Bffff", Setpoint.HOVER, math.nan, 0.0, 0.0, 0.5),
        bytes((Setpoint.POSITION, 0)),
    ):
        assert bench.firmware.receive(p.encode(Port.SETPOINT, 0, data)).kind == "garbled"


# -- supervisor


def test_each_flag_of_the_supervisor_is_asked_for_alone() -> None:
    bench = Bench()
    assert bench.ask(Port.SUPERVISOR, 0, b"\1") == b"\x81\1", "it can be armed"
    bench.fly()
    assert [bench.ask(Port.SUPERVISOR, 0, bytes((number,)))[1] for number in (1, 2, 4, 5, 7)] == [0, 1, 1, 1, 0]
    assert bench.firmware.receive(p.encode(Port.SUPERVISOR, 0, b"\x0d")).replies == ()


def test_a_drone_that_does_not_take_off_disarms_itself_after_half_a_minute() -> None:
    bench = Bench()
    bench.arm()
    bench.run(29.0)
    assert bench.firmware.armed and Bit.CAN_FLY in bench.firmware.bits
    bench.run(2.0)
    assert not bench.firmware.armed and Bit.CAN_BE_ARMED in bench.firmware.bits


def test_the_port_of_the_platform_arms_and_disarms_and_leaves_other_commands_unanswered() -> None:
    bench = Bench()
    assert bench.ask(Port.PLATFORM, 0, b"\1\1")[:3] == b"\1\1\1"
    bench.run(0.2)
    assert Bit.ARMED in bench.firmware.bits
    assert bench.ask(Port.PLATFORM, 0, b"\1\0")[:3] == b"\1\1\0"
    bench.run(0.2)
    assert Bit.ARMED not in bench.firmware.bits
    for command in (Order.EMERGENCY_STOP, 7):
        assert bench.firmware.receive(p.encode(Port.PLATFORM, 0, bytes((command, 1)))).replies == ()
    bench.run(0.2)
    assert Bit.LOCKED not in bench.firmware.bits


def test_a_low_voltage_is_reported_after_five_seconds() -> None:
    bench = Bench()

    def state() -> int:
        assert bench.ask(Port.LOG, 1, b"\6\x63\x04" + struct.pack("<H", VARIABLES["pm.state"]))[2] == 0
        assert bench.ask(Port.LOG, 1, b"\3\x63\0")[2] == 0
        (report,) = bench.firmware.reports()
        assert bench.ask(Port.LOG, 1, b"\2\x63")[2] == 0
        return report[5]

    bench.firmware.battery_v = 3.3
    bench.run(4.8)
    assert state() == Battery.BATTERY
    bench.run(0.4)
    assert state() == Battery.LOW_POWER
    bench.firmware.battery_v = 3.8
    bench.run(0.1)
    assert state() == Battery.BATTERY


def test_a_landed_drone_disarms_itself() -> None:
    bench = Bench()
    bench.fly()
    for packet in (p.land(1.0), p.YIELD):
        bench.firmware.receive(packet)
    bench.run(2.5)
    assert Bit.FLYING in bench.firmware.bits, "it counts as flying for two seconds"
    bench.run(1.0)
    assert Bit.FLYING not in bench.firmware.bits and bench.firmware.armed
    bench.run(4.0)
    assert not bench.firmware.armed and Bit.CAN_BE_ARMED in bench.firmware.bits


def test_an_old_stop_setpoint_locks_the_drone_and_a_yield_prevents_it() -> None:
    for yields in (False, True):
        bench = Bench()
        bench.fly()
        bench.firmware.receive(p.STOP)
        if yields:
            bench.firmware.receive(p.YIELD)
        bench.run(3.0)
        assert bench.firmware.locked == (not yields)


def test_a_crashed_drone_flies_after_a_recovery_that_it_accepts_only_upright() -> None:
    bench = Bench()
    bench.fly()
    bench.firmware.body.tip_over()
    bench.run(0.5)
    assert bench.notes == ["supervisor: crashed"]
    assert bench.ask(Port.SUPERVISOR, 1, b"\2") == b"\x82\0\0"
    bench.firmware.body.stand_up()
    bench.run(0.5)
    assert bench.firmware.bits & (Bit.CRASHED | Bit.TUMBLED) == Bit.CRASHED
    assert bench.ask(Port.SUPERVISOR, 1, b"\2") == b"\x82\1\1"
    bench.run(0.2)
    bench.fly()


@pytest.mark.parametrize("keep_alive", [p.encode(Port.SUPERVISOR, 1, b"\4"), p.encode(Port.LOCALIZATION, 1, b"\4")])
def test_the_watchdog_of_the_emergency_stop_runs_from_its_first_packet(keep_alive: bytes) -> None:
    bench = Bench()
    bench.fly()
    hover = p.hover(0.0, 0.0, 0.0, 0.5)
    for _ in range(5):
        bench.firmware.receive(keep_alive)
        bench.run(0.9, hover)
    assert bench.firmware.motors_on
    bench.run(0.3, hover)
    assert bench.firmware.locked
