"""The robot freezes while it moves. All calls still return, and the robot is disarmed when it is
connected again.
"""

from __future__ import annotations

import time
from collections.abc import Iterator

import pytest

from strands_actors.caller.handle.robot import RealRobot
from strands_actors.testing import Twin
from tests.answers import json_of, state, status, until, why

from .helpers import IDS, goals, holds, limps, moves

STATUS_S = 0.2
STOP_S = 3.0


@pytest.fixture
def frozen(arm: RealRobot, twin: Twin) -> Iterator[Twin]:
    moves(arm)
    twin.pause()
    yield twin
    twin.go_on()  # before the arm is cleaned up


def status_time_s(arm: RealRobot) -> float:
    began_s = time.monotonic()
    status(arm)
    return time.monotonic() - began_s


def test_status_still_answers_and_reports_that_the_robot_is_not_connected(arm: RealRobot, frozen: Twin) -> None:
    times_s = []
    deadline_s = time.monotonic() + 2.0
    while time.monotonic() < deadline_s:
        times_s.append(status_time_s(arm))
        time.sleep(0.02)
    assert max(times_s) < STATUS_S
    reported = status(arm)
    assert reported["connected"] is False
    assert reported["connect_error"]
    assert not arm.is_connected
    assert "move: not connected" in why(arm.send_action({"shoulder_pan": 0.0}))


@pytest.mark.parametrize("after_s", [0.0, 1.2])
def test_stop_is_an_error_that_names_every_motor(arm: RealRobot, frozen: Twin, after_s: float) -> None:
    time.sleep(after_s)
    began_s = time.monotonic()
    answer = arm.stop()
    assert time.monotonic() - began_s < STOP_S
    for name, servo in IDS.items():
        assert f"{name} (id {servo})" in why(answer)
    assert answer["content"][1]["json"]["unconfirmed"] == list(IDS)
    assert status_time_s(arm) < STATUS_S

    frozen.go_on()
    # If the robot was frozen too briefly for a lost link, its stop is still unconfirmed.
    until(
        lambda: status(arm)["connected"] and state(arm) in ("disarmed", "unconfirmed"),
        "the robot is connected again",
    )
    json_of(arm.stop())
    assert state(arm) == "disarmed"
    assert "resume() first" in why(arm.send_action({"shoulder_pan": 0.0}))


def test_a_frozen_robot_recovers_disarmed_and_resumes_at_its_position(arm: RealRobot, frozen: Twin) -> None:
    until(lambda: not status(arm)["connected"], "the loss is reported")
    thawed_ns = time.monotonic_ns()
    frozen.go_on()
    until(lambda: state(arm) == "disarmed", "the robot is connected again, disarmed")
    safe = limps(frozen.log, thawed_ns)[0]
    json_of(arm.resume())
    assert frozen.log.setpoints_after_safe(safe.t_ns) == 0
    hold = holds(frozen.log, safe.t_ns)[0]
    arm.send_action({"gripper": 50.0})
    first = until(lambda: frozen.log.host("setpoint", hold.t_ns), "a setpoint")[0]
    assert goals(first)[1] == goals(hold)[1]
