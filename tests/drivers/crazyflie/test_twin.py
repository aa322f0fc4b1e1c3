"""Test the twin with an independent client, and what its firmware does by itself."""

from __future__ import annotations

import json
import math
import struct
import subprocess
import sys
from pathlib import Path

import pytest

from strands_actors.drivers.crazyflie import protocol as p
from strands_actors.drivers.crazyflie.protocol import Bit
from strands_actors.drivers.crazyflie.twin.body import Target
from strands_actors.testing import Twin

from .bench import Bench

CLIENT = Path(__file__).with_name("crtp_client.py")


def test_a_client_of_others_scans_reads_its_tables_flies_it_and_lands_it(tmp_path: Path) -> None:
    with Twin("crazyflie", tmp_path) as twin:
        host, _, port = twin.port.rpartition(":")
        done = subprocess.run(
            [sys.executable, "-I", str(CLIENT), host, port], capture_output=True, text=True, timeout=60, check=False
        )
        assert done.returncode == 0, done.stderr
        kinds = {entry.kind for entry in twin.log.entries() if entry.sender == "host"}
    seen = json.loads(done.stdout)
    assert seen["answers_a_scan"] == "ff"
    assert (seen["name"], seen["protocol"]) == ("Bitcraze Crazyflie", 12)
    assert {variable for variable, _ in (*p.FLIGHT.variables, *p.POSITION.variables)} <= set(seen["log"])
    assert "commander.enHighLevel" in seen["parameters"]
    assert (seen["read"], seen["written"]) == (2, 1)
    assert seen["block"] == [0, 0]
    assert not Bit(seen["before"]) & (Bit.ARMED | Bit.FLYING)
    assert seen["armed"] == [0x81, 1, 1]
    height, yaw, volts = seen["up"]
    assert height == pytest.approx(0.5, abs=0.05) and 60 < yaw < 110 and volts == 4.0
    assert seen["rows"] > 50, "50 rows a second"
    assert Bit(seen["flying"]).airborne
    assert seen["land"][:1] == [8] and seen["land"][-1] == 0
    assert abs(seen["down"][0]) < 0.02
    assert Bit.TRAJECTORY_FINISHED in Bit(seen["landed"])
    assert {"poll", "read", "arm", "setpoint", "yield", "safe"} <= kinds


def test_it_does_not_move_before_it_is_armed() -> None:
    bench = Bench()
    bench.run(1.0, p.hover(0.0, 0.0, 0.0, 0.5))
    assert abs(bench.height_m) < 0.01 and not bench.firmware.bits.airborne


def test_it_moves_as_commanded_in_its_frame_and_in_the_worlds() -> None:
    bench = Bench()
    bench.fly()
    bench.run(1.0, p.hover(0.0, 0.0, math.pi / 2, 0.5))
    assert math.degrees(bench.firmware.body.rpy_rad[2]) == pytest.approx(90, abs=15)
    bench.run(1.0, p.hover(0.4, 0.0, 0.0, 0.5))
    assert bench.firmware.body.velocity_m_s[1] == pytest.approx(0.4, abs=0.1), (
        "ahead of the drone is left in the world"
    )
    bench.run(1.0, p.velocity(0.4, 0.0, 0.2, 0.0))
    vx, vy, vz = bench.firmware.body.velocity_m_s
    assert (vx, vy, vz) == (pytest.approx(0.4, abs=0.1), pytest.approx(0.0, abs=0.1), pytest.approx(0.2, abs=0.05))


def test_saf_013_without_setpoints_it_levels_out_after_half_a_second_and_cuts_after_two() -> None:
    bench = Bench()
    bench.fly()
    bench.run(0.5, p.hover(0.8, 0.0, 0.0, 0.5))
    bench.run(0.45)
    assert bench.notes == []
    bench.run(0.15)
    assert bench.notes == ["watchdog: level"]
    bench.run(0.5)
    assert bench.tilt_deg < 1.0 and bench.height_m > 0.4
    bench.run(1.0)
    assert bench.notes[1:] == ["watchdog: motors off", "supervisor: locked"]
    bench.run(1.0)
    assert abs(bench.height_m) < 0.02


def test_requests_without_a_command_do_not_feed_the_watchdog() -> None:
    bench = Bench()
    bench.fly()
    bench.run(2.2, p.NULL)
    assert bench.notes == ["watchdog: level", "watchdog: motors off", "supervisor: locked"]


def test_a_landing_that_it_has_taken_is_flown_to_the_end_by_itself() -> None:
    bench = Bench()
    bench.fly()
    bench.firmware.receive(p.land(2.0))
    bench.firmware.receive(p.YIELD)
    bench.run(1.0)
    assert 0.1 < bench.height_m < 0.4 and Bit.HIGH_LEVEL_ACTIVE in bench.firmware.bits
    bench.run(1.5)
    assert abs(bench.height_m) < 0.02 and bench.tilt_deg < 5.0
    assert not bench.firmware.motors_on and Bit.TRAJECTORY_FINISHED in bench.firmware.bits


def test_a_landing_waits_while_the_last_setpoint_has_it() -> None:
    bench = Bench()
    bench.fly()
    bench.firmware.receive(p.land(1.0))
    bench.run(0.05)
    assert Bit.HIGH_LEVEL_ACTIVE in bench.firmware.bits, "this bit does not show which setpoint is followed"
    bench.run(0.85)
    assert bench.height_m > 0.45, "the last setpoint still has priority over the landing"
    bench.firmware.receive(p.YIELD)
    bench.run(0.05)
    assert bench.firmware.body.velocity_m_s[2] < -0.2


def test_yielding_to_a_high_level_commander_without_a_plan_cuts_the_motors() -> None:
    bench = Bench()
    bench.fly()
    bench.firmware.receive(p.YIELD)
    bench.run(0.2)
    assert not bench.firmware.motors_on and bench.firmware.body.velocity_m_s[2] < -1.0


def test_a_landing_by_velocity_lasts_by_its_height_and_ends_with_motors_off() -> None:
    bench = Bench()
    bench.fly(1.0)
    assert bench.firmware.receive(p.land_with_velocity(0.4)) == (
        "safe",
        (p.land_with_velocity(0.4)[:4] + b"\0",),
        "land",
    )
    bench.firmware.receive(p.YIELD)
    bench.run(2.45)
    assert bench.firmware.motors_on and Bit.TRAJECTORY_FINISHED not in bench.firmware.bits
    bench.run(0.1)
    assert not bench.firmware.motors_on, "the motors stop when the trajectory ends"
    assert abs(bench.height_m) < 0.02 and Bit.TRAJECTORY_FINISHED in bench.firmware.bits
    assert Bit.HIGH_LEVEL_ACTIVE not in bench.firmware.bits


def test_its_planner_refuses_invalid_orders() -> None:
    takeoff = p.encode(8, 0, struct.pack("<BBff?f", p.HighLevel.TAKEOFF, 0, 1.0, 0.0, True, 2.0))

    def status(packet: bytes) -> int:
        (answer,) = bench.firmware.receive(packet).replies
        assert answer[:4] == packet[:4]
        return answer[4]

    bench = Bench()
    assert status(p.land_with_velocity(0.4)) == status(takeoff) == 16, "a drone that is not armed refuses to fly"
    bench.firmware.receive(p.ARM)
    assert status(takeoff) == 16, "the supervisor has not run since"
    bench.run(0.15)
    assert status(takeoff) == 0
    bench.run(0.5)
    assert status(takeoff) == 1, "a second takeoff is refused during a trajectory"
    bench.run(2.0)
    assert status(takeoff) == 1, "a second takeoff is refused during the hover"
    assert status(p.land_with_velocity(0.4)) == 0
    assert status(p.land_with_velocity(0.4)) == status(p.land(1.0)) == status(takeoff) == 1, (
        "all plans are refused during the landing"
    )
    bench.firmware.receive(p.hover(0.0, 0.0, 0.0, 0.5))
    assert status(p.land(1.0)) == 0, "after a setpoint a new landing is accepted"
    assert status(p.encode(8, 0, b"\x63\0\0")) == 8


def test_a_landing_on_the_floor_turns_the_motors_of_an_armed_drone_for_a_moment() -> None:
    bench = Bench()
    bench.arm()
    assert bench.firmware.receive(p.land(0.2)).replies[0][-1] == 0
    bench.run(0.1)
    assert bench.firmware.motors_on
    bench.run(0.15)
    assert not bench.firmware.motors_on and abs(bench.height_m) < 0.02


def test_a_simulation_lands_it_with_motors_on_to_the_floor() -> None:
    bench = Bench()
    bench.firmware.simulated = True
    bench.firmware.fly(Target(z_m=1.5))
    bench.run(4.0)
    assert bench.height_m > 1.4
    bench.firmware.descend()
    while bench.firmware.motors_on:
        bench.run(0.05)
    assert bench.height_m < 0.05


def test_an_emergency_stop_drops_it_and_only_a_new_boot_unlocks_it() -> None:
    bench = Bench()
    bench.fly()
    assert bench.firmware.receive(p.EMERGENCY_STOP).safe_state == "off"
    bench.run(1.0)
    assert abs(bench.height_m) < 0.02
    bench.firmware.receive(p.ARM)
    bench.run(1.0, p.hover(0.0, 0.0, 0.0, 0.5))
    assert abs(bench.height_m) < 0.02 and Bit.LOCKED in bench.firmware.bits
    bench.firmware.boot()
    bench.fly()


def test_its_rows_have_its_time_since_boot() -> None:
    bench = Bench()

    def told_ms() -> list[int]:
        stamps = []
        for _ in range(3):
            bench.run(0.05)
            stamps += [int.from_bytes(row[2:5], "little") for row in bench.firmware.reports()]
        return stamps

    def listen() -> None:
        numbers = range(len(p.FLIGHT.variables))
        for question in (p.log_create_question(p.FLIGHT, numbers), p.log_start_question(p.FLIGHT, 0.05)):
            bench.firmware.receive(question.packet)

    bench.run(5.0)
    listen()
    assert told_ms() == [5050, 5100, 5150]
    bench.firmware.boot()
    assert told_ms() == [], "after a reboot the drone has no log blocks"
    listen()
    assert told_ms() == [200, 250, 300]


def test_it_notices_that_it_lies_on_its_back() -> None:
    bench = Bench()
    bench.fly()
    bench.firmware.body.tip_over()
    bench.run(1.0)
    assert bench.firmware.bits & Bit.TUMBLED and Bit.CRASHED in bench.firmware.bits
    assert bench.firmware.receive(p.ARM).replies[0][2:] == bytes((0, 0)), "a drone on its back refuses to arm"
    assert not bench.firmware.motors_on


@pytest.mark.parametrize(
    "packet", [b"", bytes(40), b"\x7c\x0a\0", b"\x7c", b"\x9c", b"\x8c\x08", b"\x5c\x02", b"\x2d\xff"]
)
def test_a_malformed_packet_is_logged_as_such_and_not_obeyed(packet: bytes) -> None:
    bench = Bench()
    assert bench.firmware.receive(packet).kind == "garbled"
    assert not bench.firmware.motors_on


def test_a_log_block_that_cannot_be_is_refused() -> None:
    firmware = Bench().firmware
    assert firmware.receive(p.encode(5, 1, b"\6\1" + b"\7\xfe\xff")).replies[0][-1] == 2
    assert firmware.receive(p.encode(5, 1, b"\6\2" + 7 * b"\7\3\0")).replies[0][-1] == 7
    assert firmware.receive(p.encode(5, 1, b"\6\3\7\3\0")).replies[0][-1] == 0
    for number in (1, 2, 3):
        again = p.encode(5, 1, bytes((6, number, 7, 3, 0)))
        assert firmware.receive(again).replies[0][-1] == p.EXISTS, "a block that was refused is there, too"
    assert firmware.receive(p.encode(5, 1, b"\3\4\5")).replies[0][-1] == 2
