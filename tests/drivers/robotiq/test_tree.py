"""Test a gripper's whole tree on its twin: real processes and real sockets. The twin's log decides."""

from __future__ import annotations

import os
import signal
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from strands_actors import Robot
from strands_actors.caller.handle.robot import RealRobot
from strands_actors.caller.session.portal import portal
from strands_actors.contract.driver import Reason
from strands_actors.supervisors.gate.messages import StopReport
from strands_actors.supervisors.stop_result import Confirmed
from strands_actors.testing import WireLog
from tests.answers import json_of, pids, until, why
from tests.drivers.common.twin_process import TwinProcess

STATUS_WITHIN_S = 0.5
STOP_WITHIN_S = 3.0
"""Generous, for a busy machine. The published bound is measured elsewhere."""

SLOWLY = {"gripper": 0.9, "speed": 0.0}
"""Takes 3.6 s."""


@pytest.fixture
def twin(tmp_path: Path) -> Iterator[TwinProcess]:
    with TwinProcess(tmp_path, "robotiq_2f85", "robotiq", options={"activation_s": 0.2}) as process:
        yield process
        process.process.send_signal(signal.SIGCONT)


@pytest.fixture
def gripper(twin: TwinProcess) -> Iterator[RealRobot]:
    """Yield a robot that is not connected yet."""
    robot = Robot("robotiq_2f85", mode="real", port=twin.port)
    yield robot
    twin.process.send_signal(signal.SIGCONT)
    robot.cleanup()


@pytest.fixture
def armed(gripper: RealRobot) -> RealRobot:
    assert gripper.connect_eagerly() is None
    return gripper


def status(robot: RealRobot) -> dict[str, Any]:
    """Return the status. The tree always has to answer."""
    began_s = time.monotonic()
    json = json_of(robot.get_status())
    assert time.monotonic() - began_s < STATUS_WITHIN_S
    return json


def state(robot: RealRobot) -> str | None:
    found: str | None = status(robot).get("state")
    return found


def until_state(robot: RealRobot, *wanted: str) -> None:
    until(lambda: state(robot) in wanted, f"it is {' or '.join(wanted)}")


def move(robot: RealRobot, closed: float) -> None:
    """Move fast, and wait until it has arrived."""
    assert json_of(robot.send_action({"gripper": closed}))["gripper"] == closed
    until(lambda: abs(robot.get_observation().get("gripper", 9.0) - closed) < 0.01, f"it is at {closed}")


def works_again(robot: RealRobot, twin: TwinProcess, since_ns: int) -> None:
    """Assert the recovery after a loss in motion: first a hold, then no motion before a resume."""
    until_state(robot, "disarmed")
    log = WireLog(twin.log_path)
    assert log.host("safe", since_ns)
    assert log.setpoints_after_safe(since_ns) == 0
    assert "resume() first" in why(robot.send_action({"gripper": 0.5}))
    json_of(robot.resume())
    move(robot, 0.3)
    json_of(robot.stop())


# -- a day's work


def test_connect_observe_act_refuse_stop_resume(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("STRANDS_ACTORS_TWIN_LOG", str(tmp_path / "wire.ndjson"))
    log = WireLog(tmp_path / "wire.ndjson")
    with Robot("robotiq_2f85", mode="real", transport="twin") as robot:
        reported = status(robot)
        assert (reported["state"], reported["connected"], reported["unit_id"]) == ("armed", True, 9)
        assert reported["firmware_watchdog"].startswith("The firmware has no watchdog")
        assert set(reported["fallbacks"].values()) == {"hold"}
        assert reported["sensors"]["activation"] == [3.0]
        assert [entry.kind for entry in log.entries() if entry.sender == "host" and entry.kind != "read"] == [
            "safe",
            "enable",
            "safe",
        ]
        assert robot.get_observation() == {"gripper": pytest.approx(3 / 255)}
        assert json_of(robot.send_action({"aperture_mm": 34.0, "force": 0.2})) == {
            "robot": "robotiq_2f85",
            "commanded_key": "aperture_mm",
            "gripper": 0.6,
            "position": 153,
            "aperture_mm": 34.0,
            "speed": 255,
            "force": 51,
            "holding": None,  # it was just armed, so it has no command yet
        }
        until(lambda: robot.get_observation()["gripper.pos"] == pytest.approx(0.6), "it is there")
        until(lambda: status(robot)["holding"] is False, "nothing is held")
        assert (status(robot)["position"], status(robot)["aperture_mm"]) == (153, 34.0)
        requested = len(log.host("setpoint"))
        assert "is past 85" in why(robot.send_action({"aperture_mm": 86}))
        assert "are both given" in why(robot.send_action({"gripper": 0.5, "position": 42.5}))
        assert "runs no separate policy" in why(robot.run_policy(lambda observation: {"gripper": 0.1}))
        assert "runs no separate policy" in why(robot.start_task("grip"))
        before_ns = time.monotonic_ns()
        assert (
            len([entry for entry in log.host("setpoint") if entry.t_ns < before_ns]) - requested <= 1
        )  # a re-send

        json = json_of(robot.stop())
        assert (json["stopped"], json["safe_state"]) == (True, "hold")
        assert json["motors"]["gripper"]["safe"] is True
        since_ns = time.monotonic_ns()
        assert "resume() first" in why(robot.send_action({"gripper": 0.1}))
        assert json_of(robot.resume())["position"] == {"gripper": pytest.approx(0.6)}
        assert log.host("setpoint", since_ns) == [] and log.host("enable", since_ns) == []
        move(robot, 0.2)
        since_ns = time.monotonic_ns()
    assert log.host("safe", since_ns)[-1].safe_state == "hold"
    assert log.setpoints_after_safe(since_ns) == 0


def test_a_command_is_kept_while_the_caller_lives(armed: RealRobot, twin: TwinProcess) -> None:
    since_ns = time.monotonic_ns()
    move(armed, 0.4)
    until(lambda: len(WireLog(twin.log_path).host("setpoint", since_ns)) >= 3, "it is re-sent")
    assert state(armed) == "armed"


def test_a_lost_writer_makes_it_hold_and_the_next_command_moves_it(armed: RealRobot, twin: TwinProcess) -> None:
    json_of(armed.send_action(SLOWLY))
    since_ns = time.monotonic_ns()
    tree = armed._tree
    assert tree is not None
    report = portal().call(tree.stop, Reason.LEASE)
    assert isinstance(report, Confirmed)
    assert state(armed) == "holding"
    assert WireLog(twin.log_path).setpoints_after_safe(since_ns) == 0
    move(armed, 0.2)
    assert state(armed) == "armed"


def test_an_emergency_stop_locks_although_the_grip_is_kept(armed: RealRobot, twin: TwinProcess) -> None:
    json_of(armed.send_action(SLOWLY))
    since_ns = time.monotonic_ns()
    tree = armed._tree
    assert tree is not None
    report = portal().call(tree.stop, Reason.ESTOP, True)
    assert isinstance(report, Confirmed) and isinstance(report.proof, StopReport)
    assert report.proof.safe_state == "hold"
    assert state(armed) == "disarmed"
    assert "e-stopped by" in why(armed.send_action({"gripper": 0.1}))
    assert WireLog(twin.log_path).setpoints_after_safe(since_ns) == 0
    json_of(armed.resume())
    move(armed, 0.2)


# -- the wire


def test_one_answer_too_late_and_everything_still_works(armed: RealRobot, twin: TwinProcess) -> None:
    wire = pids(armed)["wire"]
    twin.command("fault delayed")
    time.sleep(0.3)  # some answers of each kind
    json_of(armed.send_action({"gripper": 0.5}))
    twin.command("fault ok")
    move(armed, 0.7)
    json_of(armed.stop())
    json_of(armed.resume())
    move(armed, 0.2)
    assert pids(armed)["wire"] == wire


def test_the_cable_is_pulled_and_put_back(armed: RealRobot, twin: TwinProcess) -> None:
    json_of(armed.send_action(SLOWLY))
    until(lambda: armed.get_observation()["gripper"] > 0.1, "it moves")
    twin.command("unplug")
    until(lambda: not status(armed)["connected"], "the loss is noticed")
    assert "not connected" in why(armed.send_action({"gripper": 0.5}))
    assert "not confirmed" in why(armed.stop())
    since_ns = time.monotonic_ns()
    twin.command("plug")
    works_again(armed, twin, since_ns)


def test_the_power_is_cut(armed: RealRobot, twin: TwinProcess) -> None:
    """It comes back with new registers. It is not activated, and a re-sent command does not activate it."""
    json_of(armed.send_action(SLOWLY))
    since_ns = time.monotonic_ns()
    twin.command("power-cycle")
    until_state(armed, "disarmed")
    assert WireLog(twin.log_path).host("enable", since_ns) == []
    until(lambda: status(armed)["sensors"]["activation"] == [0.0], "it is read again")
    works_again(armed, twin, since_ns)


@pytest.mark.parametrize("fault", ["garbage", "off"])
def test_the_tree_recovers_from_invalid_answers(armed: RealRobot, twin: TwinProcess, fault: str) -> None:
    json_of(armed.send_action(SLOWLY))
    twin.command(f"fault {fault}")
    until(lambda: not status(armed)["connected"], "the loss is noticed")
    since_ns = time.monotonic_ns()
    twin.command("fault ok")
    works_again(armed, twin, since_ns)


# -- the gripper freezes


class Connecting(threading.Thread):
    def __init__(self, robot: RealRobot) -> None:
        super().__init__(daemon=True)
        self._robot = robot
        self.problem: str | None = "still connecting"

    def run(self) -> None:
        self.problem = self._robot.connect_eagerly()


@pytest.mark.quick_cases(2)
@pytest.mark.parametrize("frames", [0, 1, 2, 3, 4, 5, 6, 7, 9, 11])
def test_it_freezes_while_it_is_connected(gripper: RealRobot, twin: TwinProcess, frames: int) -> None:
    if frames == 0:
        twin.process.send_signal(signal.SIGSTOP)
    connecting = Connecting(gripper)
    connecting.start()
    until(lambda: len(twin.logged("host")) >= frames, f"{frames} frames")
    twin.process.send_signal(signal.SIGSTOP)
    for _ in range(10):
        status(gripper)
        time.sleep(0.05)
    began_s = time.monotonic()
    gripper.stop()
    assert time.monotonic() - began_s < STOP_WITHIN_S
    connecting.join(20.0)
    assert not connecting.is_alive()
    assert connecting.problem is None or connecting.problem.startswith(("connect: ", "resume: "))
    twin.process.send_signal(signal.SIGCONT)
    until(lambda: gripper.connect_eagerly() is None, "it is connected")
    move(gripper, 0.3)


@pytest.mark.quick_cases(2)
@pytest.mark.parametrize("delay_s", [0.0, 0.01, 0.05, 0.3])
def test_it_freezes_while_it_moves(armed: RealRobot, twin: TwinProcess, delay_s: float) -> None:
    json_of(armed.send_action(SLOWLY))
    time.sleep(delay_s)
    twin.process.send_signal(signal.SIGSTOP)
    began_s = time.monotonic()
    answer = armed.stop()
    assert time.monotonic() - began_s < STOP_WITHIN_S
    assert "not confirmed by gripper" in why(answer)
    until(lambda: not status(armed)["connected"], "the loss is noticed")
    assert "not connected" in why(armed.send_action({"gripper": 0.1}))
    since_ns = time.monotonic_ns()
    twin.process.send_signal(signal.SIGCONT)
    works_again(armed, twin, since_ns)


def test_a_short_freeze_needs_no_action(armed: RealRobot, twin: TwinProcess) -> None:
    json_of(armed.send_action(SLOWLY))
    twin.process.send_signal(signal.SIGSTOP)
    time.sleep(0.2)
    twin.process.send_signal(signal.SIGCONT)
    until(lambda: armed.get_observation()["gripper"] > 0.3, "it goes on")
    assert state(armed) == "armed"
    move(armed, 0.2)


def test_no_process_is_left(gripper: RealRobot, twin: TwinProcess) -> None:
    assert gripper.connect_eagerly() is None
    victims = [pids(gripper)[role] for role in ("root", "wire")]
    json_of(gripper.cleanup())
    until(lambda: not any(_runs(pid) for pid in victims), "every process is gone")


def _runs(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    return True
