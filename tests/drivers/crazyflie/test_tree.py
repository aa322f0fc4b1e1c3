"""Test the drone's whole tree on its twin: real processes, real sockets, a body that flies.

The twin's log and the position of its body decide.
"""

from __future__ import annotations

import contextlib
import os
import signal
import socket
import struct
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from strands import Agent

from strands_actors import Robot, estop
from strands_actors.caller.handle.robot import RealRobot
from strands_actors.drivers.crazyflie import protocol as p
from strands_actors.drivers.crazyflie.config import LANDING_M_S
from strands_actors.drivers.crazyflie.protocol import Bit
from strands_actors.testing import WireLog
from tests.agents.scripted import Scripted
from tests.answers import json_of, pids, state, status, until, why
from tests.drivers.common.twin_process import TwinProcess
from tests.trees import armed, first_safe, robot_on

SLACK_S = 1.0
"""Added to the published bounds, for a busy machine."""
FLOOR_M = 0.02
UPRIGHT_DEG = 5.0


class Drone:
    """A robot on its twin, with the track of its body."""

    def __init__(self, robot: RealRobot, twin: TwinProcess, trace: Path) -> None:
        self.robot = robot
        self.twin = twin
        self.log = WireLog(twin.log_path)
        self._trace = trace

    def take_off(self, height: float = 0.5) -> None:
        armed(self.robot)
        json_of(self.robot.takeoff(height=height, duration=1.0))

    def height_at(self, t_ns: int) -> float:
        return min(self.track(), key=lambda row: abs(row[0] - t_ns / 1e9))[1]

    def fly(self) -> int:
        """Take off and move. Return when the last command was sent."""
        self.take_off()
        for _ in range(10):
            json_of(self.robot.send_action({"vx": 0.3, "z": 0.5}))
            time.sleep(0.05)
        return time.monotonic_ns()

    def track(self, since_ns: int = 0) -> list[tuple[float, float, float]]:
        """Return seconds since then, height and tilt of the body."""
        rows = [tuple(map(float, line.split())) for line in self._trace.read_text().splitlines()[:-1]]
        return [(at - since_ns / 1e9, z, tilt) for at, z, tilt in rows if at >= since_ns / 1e9]

    def lands(self, since_ns: int, within_s: float) -> None:
        """Assert that the body is on the floor in time, was never tilted, and stays there."""
        rest_s = since_ns / 1e9 + within_s + SLACK_S - time.monotonic()
        time.sleep(max(0.0, rest_s))
        track = self.track(since_ns)
        down_s = next((at for at, z, _ in track if z < FLOOR_M), None)
        assert down_s is not None and down_s <= within_s + SLACK_S, track[-1]
        assert all(z < FLOOR_M for at, z, _ in track if at > down_s + 0.5)
        assert track[-1][2] < UPRIGHT_DEG


@contextlib.contextmanager
def drone(directory: Path, **options: Any) -> Iterator[Drone]:
    trace = directory / "trace"
    with (
        TwinProcess(directory, "crazyflie", "crazyflie", options={"trace": str(trace), **options}) as twin,
        robot_on(twin.port, "crazyflie") as robot,
    ):
        yield Drone(robot, twin, trace)


@pytest.fixture
def cf(tmp_path: Path, run_dir: Path) -> Iterator[Drone]:
    with drone(tmp_path) as flying:
        yield flying


# -- the verbs


def test_connecting_and_arming_start_no_motor(cf: Drone) -> None:
    time.sleep(0.5)
    assert {entry.kind for entry in cf.log.entries() if entry.sender == "host"} == {"read"}
    assert "Call takeoff() first" in why(cf.robot.send_action({"z": 0.5})), "an action cannot replace takeoff()"
    assert "Call takeoff() first" in why(cf.robot.send_action({"vz": 0.3}))
    assert max(z for _, z, _ in cf.track()) < FLOOR_M
    assert cf.log.host("setpoint") == []


@pytest.mark.long
def test_it_takes_off_moves_hovers_and_lands_by_its_program(cf: Drone) -> None:
    answer = json_of(cf.robot.takeoff())
    assert answer["height"] == pytest.approx(0.5, abs=0.06)
    assert cf.log.host("arm"), "takeoff arms the drone"
    began_ns = time.monotonic_ns()
    sent = json_of(cf.robot.send_action({"vx": 0.3, "wz": 1.0, "z": 0.6}))
    assert sent == {
        "commanded": "hover",
        "args": {"vx": 0.3, "vy": 0.0, "wz": 1.0, "z": 0.6},
        "setpoint_hz": 20.0,
        "unit": "m/s (wz: rad/s, z: m)",
    }
    setpoint = until(lambda: cf.log.host("setpoint", began_ns), "a setpoint")[0]
    assert struct.unpack("<ff", setpoint.data[10:18]) == (pytest.approx(57.3, abs=0.1), pytest.approx(0.6))
    hover = first_safe(cf.log, setpoint.t_ns, "hold")  # before it, the hover of the takeoff was fed
    assert (hover.t_ns - began_ns) / 1e9 > 0.25, "a command lives 300 ms"
    assert state(cf.robot) == "holding"
    sensors = status(cf.robot)["sensors"]
    assert sensors["battery_v"] == [4.0] and Bit(int(sensors["supervisor"][0])).airborne
    landing_ns = time.monotonic_ns()
    landed = json_of(cf.robot.land(duration=1.0))
    assert landed == {"landed": True, "duration": pytest.approx(1.4, abs=0.3)}, (
        "the drone does not land faster than its limit"
    )
    cf.lands(landing_ns, 2.0)
    cf.take_off()  # a program that landed may go on


def test_saf_001_a_landing_ends_the_twist_that_is_flown(cf: Drone) -> None:
    cf.take_off()
    json_of(cf.robot.set_twist(vx=0.3))
    landing_ns = time.monotonic_ns()
    assert json_of(cf.robot.land(duration=0.5))["landed"]
    land = first_safe(cf.log, landing_ns, "land")
    cf.log.no_setpoint_after_safe(land.t_ns)
    cf.lands(landing_ns, 3.0)


def test_saf_001_a_setpoint_is_resent_for_its_lifetime_and_then_it_hovers(cf: Drone) -> None:
    cf.take_off()
    began_ns = time.monotonic_ns()
    json_of(cf.robot.send_action({"vx": 0.4}))
    first = until(lambda: cf.log.host("setpoint", began_ns), "a setpoint")[0]
    hold = first_safe(cf.log, first.t_ns, "hold")  # before it, the hover of the takeoff was fed
    sent = [one for one in cf.log.host("setpoint", began_ns) if one.t_ns < hold.t_ns]
    assert 3 <= len(sent) <= 9, "the setpoint is re-sent at 20 Hz for its lifetime"
    assert all(one.data == sent[0].data for one in sent)
    time.sleep(1.0)
    cf.log.no_setpoint_after_safe(hold.t_ns)
    holds = cf.log.host("safe", hold.t_ns)
    assert 8 <= len(holds) <= 40, "the hover is re-sent at 20 Hz"
    assert max(tilt for at, _, tilt in cf.track(hold.t_ns) if at > 0.6) < UPRIGHT_DEG
    json_of(cf.robot.send_action({"vx": 0.1}))  # a late writer may go on


@pytest.mark.long
def test_a_stop_lands_it_and_nothing_flies_again_before_a_resume(cf: Drone) -> None:
    cf.fly()
    began_ns = time.monotonic_ns()
    stopped = json_of(cf.robot.stop())
    assert (stopped["safe_state"], stopped["path"], stopped["unconfirmed"]) == ("land", "wire", [])
    land = first_safe(cf.log, began_ns, "land")
    cf.log.no_setpoint_after_safe(land.t_ns)
    cf.lands(began_ns, 3.0)
    assert cf.log.host("disarm", began_ns)
    assert "Call resume() first" in why(cf.robot.takeoff())
    assert "Call resume() first" in why(cf.robot.send_action({"vx": 0.1}))
    quiet_ns = time.monotonic_ns()
    json_of(cf.robot.resume())
    time.sleep(0.3)
    assert not cf.log.host("setpoint", quiet_ns) and not cf.log.host("arm", quiet_ns), (
        "no setpoint is sent after the stop, not even by a resume"
    )
    cf.take_off()


def test_saf_007_an_emergency_stop_cuts_the_motors_and_locks(cf: Drone) -> None:
    cf.fly()
    began_ns = time.monotonic_ns()
    stopped = json_of(cf.robot.emergency_stop())
    assert (stopped["safe_state"], stopped["unconfirmed"]) == ("off", [])
    first_safe(cf.log, began_ns, "off")
    time.sleep(1.0)
    assert cf.track()[-1][1] < FLOOR_M, "the drone fell"
    assert "e-stopped by" in why(cf.robot.takeoff())
    assert "Switch it off and on" in why(cf.robot.resume()), "resume lifts our lock, but not the drone's"
    cf.twin.command("power-cycle")  # its log is gone with it, so the link is opened again
    until(lambda: cf.robot.resume() and cf.robot.takeoff()["status"] == "success", "it flies again")


@pytest.mark.long
@pytest.mark.parametrize("how", ["stop", "land", "kill"])
def test_saf_005_from_the_ceiling_it_is_flown_to_the_floor_before_its_motors_are_cut(cf: Drone, how: str) -> None:
    cf.take_off(1.95)
    began_ns = time.monotonic_ns()
    if how == "stop":
        stopped = json_of(cf.robot.stop())
        assert (stopped["safe_state"], stopped["unconfirmed"]) == ("land", [])
    elif how == "land":
        landed = json_of(cf.robot.land(duration=0.5))
        assert landed == {"landed": True, "duration": pytest.approx(4.9, abs=0.2)}
    else:
        os.kill(pids(cf.robot)["wire"], signal.SIGKILL)
    assert first_safe(cf.log, began_ns, "land").t_ns < first_safe(cf.log, began_ns, "limp").t_ns
    cf.lands(began_ns, 6.0)
    assert cf.height_at(first_safe(cf.log, began_ns, "limp").t_ns) < 0.1
    track = cf.track(began_ns)
    speeds = [(later[1] - row[1]) / (later[0] - row[0]) for row, later in zip(track, track[10:], strict=False)]
    assert min(speeds) > -1.5, "the drone never fell"


def test_an_emergency_stop_is_not_held_up_by_a_landing(cf: Drone) -> None:
    cf.fly()
    began_ns = time.monotonic_ns()
    landing = threading.Thread(target=cf.robot.stop)
    landing.start()
    first_safe(cf.log, began_ns, "land")
    cut_ns = time.monotonic_ns()
    cf.robot.emergency_stop()
    landing.join()
    first_safe(cf.log, cut_ns, "off")


def test_a_stop_during_a_takeoff_wins(cf: Drone) -> None:
    rising = threading.Thread(target=cf.robot.takeoff, kwargs={"height": 1.0, "duration": 3.0})
    rising.start()
    until(lambda: any(z > 0.2 for _, z, _ in cf.track()), "it rises")
    began_ns = time.monotonic_ns()
    json_of(cf.robot.stop())
    rising.join()
    land = first_safe(cf.log, began_ns, "land")
    cf.log.no_setpoint_after_safe(land.t_ns)
    cf.lands(began_ns, 3.0)


# -- what ends a flight


@pytest.mark.quick_cases(1)
@pytest.mark.parametrize(
    ("role", "number"),
    [("wire", signal.SIGKILL), ("wire", signal.SIGSTOP), ("root", signal.SIGKILL), ("root", signal.SIGSTOP)],
)
def test_saf_003_a_kill_in_flight_ends_on_the_floor_upright_within_three_seconds(
    cf: Drone, role: str, number: signal.Signals
) -> None:
    cf.fly()
    pid = pids(cf.robot)[role]
    began_ns = time.monotonic_ns()
    os.kill(pid, number)
    land = first_safe(cf.log, began_ns, "land")
    cf.lands(began_ns, 3.0)
    cf.log.no_setpoint_after_safe(land.t_ns)
    if number == signal.SIGSTOP:
        with contextlib.suppress(ProcessLookupError):
            os.kill(pid, signal.SIGCONT)
        time.sleep(0.3)
        cf.log.no_setpoint_after_safe(land.t_ns)


@pytest.mark.long
def test_saf_016_root_and_wire_at_once_leave_it_to_the_standby(cf: Drone) -> None:
    cf.fly()
    victims = [pids(cf.robot)[role] for role in ("root", "wire")]
    began_ns = time.monotonic_ns()
    for pid in victims:
        os.kill(pid, signal.SIGKILL)
    land = first_safe(cf.log, began_ns, "land")
    cf.lands(began_ns, 3.0)
    cf.log.no_setpoint_after_safe(land.t_ns)


@pytest.mark.long
def test_the_firmware_acts_after_all_our_processes_end_at_once(cf: Drone) -> None:
    cf.fly()
    victims = [pids(cf.robot)[role] for role in ("root", "standby", "wire")]
    for pid in victims:
        os.kill(pid, signal.SIGSTOP)  # stopped first, so that no process notices another's end
    began_ns = time.monotonic_ns()
    for pid in victims:
        os.kill(pid, signal.SIGKILL)
    time.sleep(0.3)
    assert not cf.log.host("setpoint", began_ns + 100_000_000), "no process re-sends a setpoint"
    cf.lands(began_ns, 3.0)
    notes = [entry.data.decode() for entry in cf.log.entries(began_ns) if entry.kind == "note"]
    assert notes == ["watchdog: level", "watchdog: motors off", "supervisor: locked"]


def test_saf_004_a_frozen_wire_feeds_no_hover(cf: Drone) -> None:
    cf.take_off()
    began_ns = time.monotonic_ns()
    os.kill(pids(cf.robot)["wire"], signal.SIGSTOP)
    land = first_safe(cf.log, began_ns, "land")
    held = [one for one in cf.log.host("safe", began_ns) if one.safe_state == "hold"]
    assert all(one.t_ns < land.t_ns for one in held)
    cf.lands(began_ns, 3.0)


def test_saf_020_a_lost_link_lands_it_when_it_is_back(cf: Drone) -> None:
    cf.fly()
    cf.twin.command("unplug")
    until(lambda: state(cf.robot) in ("lost", "down", None), "it is noticed")
    back_ns = time.monotonic_ns()
    cf.twin.command("plug")
    until(lambda: any(one.sender == "host" for one in cf.log.entries(back_ns)), "it is spoken to")
    first = next(one for one in cf.log.entries(back_ns) if one.sender == "host")
    assert first.data in (p.land_with_velocity(LANDING_M_S), p.STOP), (
        "the first packet on the new link ends the flight"
    )
    until(lambda: state(cf.robot) == "disarmed", "it is back, disarmed")
    assert cf.log.host("setpoint", back_ns) == []
    assert cf.track()[-1][1] < FLOOR_M


@pytest.mark.long
def test_saf_010_a_command_that_waits_in_a_stopped_drone_is_followed_by_the_landing(cf: Drone) -> None:
    cf.fly()
    os.kill(cf.twin.process.pid, signal.SIGSTOP)
    cf.robot.send_action({"vx": 0.5})
    time.sleep(0.1)
    assert "not confirmed" in why(cf.robot.stop())
    back_ns = time.monotonic_ns()
    os.kill(cf.twin.process.pid, signal.SIGCONT)
    until(lambda: state(cf.robot) == "disarmed", "it is confirmed when it can be")
    frames = [one for one in cf.log.entries(back_ns) if one.sender == "host" and one.kind in ("setpoint", "safe")]
    kinds = [one.kind for one in frames]
    assert "setpoint" not in kinds[kinds.index("safe") :], (
        "a landing follows all setpoints that were carried out late"
    )
    assert cf.track()[-1][1] < FLOOR_M


@pytest.mark.parametrize(
    ("order", "safe_state", "named"),
    [("battery 3.1", "land", "the battery has only 3.10 V"), ("tip-over", "limp", "tumbled")],
)
def test_saf_012_a_fault_in_the_air_ends_the_flight(cf: Drone, order: str, safe_state: str, named: str) -> None:
    cf.take_off()
    began_ns = time.monotonic_ns()
    cf.twin.command(order)
    first_safe(cf.log, began_ns, safe_state)
    until(lambda: state(cf.robot) == "disarmed", "it is disarmed")
    assert named in status(cf.robot)["cause"]
    assert not cf.log.host("setpoint", began_ns)
    cf.robot.resume()
    assert cf.robot.takeoff()["status"] == "error", "the drone refuses another takeoff"


@pytest.mark.long
def test_saf_012_a_battery_that_is_no_longer_reported_lands_the_drone(cf: Drone) -> None:
    cf.take_off()
    began_ns = time.monotonic_ns()
    host, _, port = cf.twin.port.rpartition(":")
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as another:
        another.sendto(p.encode(p.Port.LOG, 1, bytes((4, p.POSITION.number))), (host, int(port)))
    land = first_safe(cf.log, began_ns, "land")
    cf.log.no_setpoint_after_safe(land.t_ns)
    until(lambda: state(cf.robot) == "disarmed", "it is disarmed")
    assert "not reported its battery" in status(cf.robot)["cause"]


# -- lossy links


@pytest.mark.long
@pytest.mark.parametrize("loss", [0.05, 0.2])
def test_saf_005_a_lossy_slow_link_never_hangs(tmp_path: Path, run_dir: Path, loss: float) -> None:
    with drone(tmp_path, loss=loss, delay_s=0.1) as cf:
        cf.take_off()
        accepted = 0
        for _ in range(20):
            accepted += cf.robot.send_action({"vx": 0.2, "z": 0.5})["status"] == "success"
            time.sleep(0.05)
        assert accepted >= 15
        began_ns = time.monotonic_ns()
        stopped = json_of(cf.robot.stop())
        assert stopped["safe_state"] == "land" and time.monotonic_ns() - began_ns < 10.5e9
        cf.lands(began_ns, 5.0)


@pytest.mark.long
@pytest.mark.parametrize("link", ["tcp", "serial"])
def test_the_same_over_another_link(tmp_path: Path, run_dir: Path, link: str) -> None:
    with drone(tmp_path, link=link) as cf:
        assert cf.twin.port.startswith(f"{link}://")
        cf.fly()
        began_ns = time.monotonic_ns()
        os.kill(pids(cf.robot)["wire"], signal.SIGKILL)
        land = first_safe(cf.log, began_ns, "land")
        cf.lands(began_ns, 3.0)
        cf.log.no_setpoint_after_safe(land.t_ns)


def test_old_firmware_is_refused(tmp_path: Path, run_dir: Path) -> None:
    with TwinProcess(tmp_path, "crazyflie", "crazyflie", options={"protocol": 10}) as twin:
        robot = Robot("crazyflie", mode="real", port=twin.port)
        try:
            assert "CRTP protocol 10" in str(robot.connect_eagerly())
        finally:
            robot.cleanup()


# -- with others


@pytest.mark.long
def test_an_agent_can_land_it_and_cannot_take_off(cf: Drone) -> None:
    cf.take_off()
    began_ns = time.monotonic_ns()
    model = Scripted([("crazyflie", {"action": "takeoff"})], [("crazyflie", {"action": "land"})], "done")
    Agent(model=model, tools=[cf.robot], callback_handler=None)("bring it down")
    first_safe(cf.log, began_ns, "land")
    cf.lands(began_ns, 3.0)
    assert state(cf.robot) == "disarmed"
    assert not cf.log.host("arm", began_ns)


def test_saf_007_an_estop_cuts_it(cf: Drone) -> None:
    cf.take_off()
    began_ns = time.monotonic_ns()
    (outcome,) = estop(by="a button", within_s=5.0)
    assert (outcome.outcome, outcome.safe_state) == ("safe", "off")
    cf.log.no_setpoint_after_safe(first_safe(cf.log, began_ns, "off").t_ns)
