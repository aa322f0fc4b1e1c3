"""Hands on arms: one more axis of the robot, under the gates, stop and reports of the arm.

Each row of ``HANDS`` is a robot with its hand on its twin, with all its processes. The twin's wire log decides.
"""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from strands_actors import Robot
from strands_actors.caller.handle.robot import RealRobot, SimRobot
from strands_actors.testing import Twin
from strands_actors.testing.wirelog import Entry
from tests.answers import json_of, pids, state, status, until, why
from tests.trees import nudge, robot_on

PERCENT = 3.0
"""How far the reading of a hand that stands may be off."""


class Hand(NamedTuple):
    """A robot with its hand.

    Attributes:
        robot: The robot.
        options: The options of its handle.
        twin: The options of its twin.
        joint: Another joint of the robot.
        moves: Return True if a frame lets the fingers move.
        stops: Return True if a frame stops the fingers, and keeps the grip.
        slow: The action that closes the fingers slowly to 10 percent.
        shown: Text that a frame of this action has.
    """

    robot: str
    options: Mapping[str, Any]
    twin: Mapping[str, object]
    joint: str
    moves: Callable[[Entry], bool]
    stops: Callable[[Entry], bool]
    slow: Mapping[str, float]
    shown: bytes


HANDS = (
    Hand(
        "ur5e",
        {"gripper": "robotiq_2f85", "control": "script"},
        {"gripper": "robotiq_2f85"},
        "shoulder_pan_joint",
        lambda entry: entry.data.startswith(b"SET POS") or b"ACT 1" in entry.data,
        lambda entry: entry.data.startswith(b"SET GTO 0"),
        {"gripper": 10.0, "gripper_speed": 0.0, "gripper_force": 20.0},
        b"SET POS 230 SPE 0 FOR 51 GTO 1",
    ),
)


@pytest.fixture(scope="module", params=HANDS, ids=lambda hand: hand.robot)
def hand(request: pytest.FixtureRequest) -> Hand:
    row: Hand = request.param
    return row


@pytest.fixture(scope="module")
def twin(hand: Hand, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Twin]:
    with Twin(hand.robot, tmp_path_factory.mktemp("hand"), options=hand.twin) as process:
        yield process


@pytest.fixture
def arm(hand: Hand, twin: Twin, run_dir: Path) -> Iterator[RealRobot]:
    os.truncate(twin.log.path, 0)
    with robot_on(twin.port, hand.robot, **hand.options) as connected:
        yield connected
    twin.plug()


def frames(twin: Twin, of: Callable[[Entry], bool], since_ns: int = 0) -> list[Entry]:
    return [entry for entry in twin.log.entries(since_ns) if entry.sender == "host" and of(entry)]


def opening(arm: RealRobot | SimRobot) -> float:
    return float(arm.get_observation()["gripper"])


def stands_at(arm: RealRobot | SimRobot, percent: float) -> bool:
    return abs(opening(arm) - percent) < PERCENT


def closing(arm: RealRobot, hand: Hand, twin: Twin) -> None:
    """Open the hand, then close it slowly, and return while it moves."""
    json_of(arm.send_action({"gripper": 90.0}))
    until(lambda: stands_at(arm, 90.0), "the hand is open")
    json_of(arm.send_action(dict(hand.slow)))
    until(lambda: opening(arm) < 80.0, "the hand closes")


def rests(arm: RealRobot) -> float:
    """Return the opening, which must not change for a while."""
    at = opening(arm)
    time.sleep(0.3)
    assert abs(opening(arm) - at) < PERCENT
    return at


def test_an_action_moves_arm_and_fingers_with_speed_and_force(arm: RealRobot, hand: Hand, twin: Twin) -> None:
    began_ns = time.monotonic_ns()
    json_of(nudge(arm, hand.joint))
    time.sleep(0.1)
    assert not frames(twin, hand.moves, began_ns), "a motion of the arm alone does not move the fingers"
    closing(arm, hand, twin)
    assert [entry for entry in frames(twin, hand.moves, began_ns) if hand.shown in entry.data]
    json_of(arm.send_action({"gripper": 40.0}))
    until(lambda: stands_at(arm, 40.0), "the fingers are there")
    assert json_of(arm.state())["joints"]["gripper"] == pytest.approx(40.0, abs=PERCENT)


def test_saf_014_a_refused_action_of_the_hand_writes_nothing(arm: RealRobot, hand: Hand, twin: Twin) -> None:
    began_ns = time.monotonic_ns()
    assert "gripper 120.0 % is past 100.0" in why(arm.send_action({"gripper": 120.0}))
    assert "gripper is nan" in why(arm.send_action({"gripper": float("nan")}))
    assert "gripper_force 130.0 % is past 100.0" in why(arm.send_action({"gripper": 50.0, "gripper_force": 130.0}))
    assert "gripper_speed is given without gripper" in why(arm.send_action({"gripper_speed": 30.0}))
    time.sleep(0.1)
    assert not frames(twin, hand.moves, began_ns)


def test_saf_005_a_stop_ends_the_motion_of_the_fingers(arm: RealRobot, hand: Hand, twin: Twin) -> None:
    closing(arm, hand, twin)
    began_ns = time.monotonic_ns()
    stopped = json_of(arm.stop())
    assert stopped["motors"]["gripper"]["safe"] and stopped["unconfirmed"] == []
    assert frames(twin, hand.stops, began_ns), "the hand was stopped, too"
    stopped_at = rests(arm)
    assert stopped_at > 15.0, "it did not close to its target"
    assert "resume() first" in why(arm.send_action({"gripper": 50.0}))
    resumed_ns = time.monotonic_ns()
    json_of(arm.resume())
    json_of(nudge(arm, hand.joint))
    assert abs(rests(arm) - stopped_at) < PERCENT, "it keeps its opening after a resume, too"
    assert not frames(twin, hand.moves, resumed_ns)


@pytest.mark.parametrize("victims", [("wire",), ("wire", "root")], ids="-".join)
def test_saf_001_a_kill_stops_the_fingers_and_keeps_the_grip(
    arm: RealRobot, hand: Hand, twin: Twin, victims: tuple[str, ...]
) -> None:
    closing(arm, hand, twin)
    running = pids(arm)
    killed_ns = time.monotonic_ns()
    for victim in victims:
        os.kill(running[victim], signal.SIGKILL)
    until(lambda: frames(twin, hand.stops, killed_ns), "the hand is stopped by another process")
    stopped_ns = frames(twin, hand.stops, killed_ns)[0].t_ns
    time.sleep(0.3)
    assert not frames(twin, hand.moves, stopped_ns), "no motion of the fingers begins after the stop"


def test_saf_008_a_lost_port_of_the_hand_is_reported(hand: Hand, twin: Twin, arm: RealRobot) -> None:
    twin.fault("off")
    until(lambda: state(arm) == "lost", "the robot counts as lost")
    assert not status(arm)["connected"]
    twin.fault("ok")
    until(lambda: state(arm) == "disarmed", "it is connected again")


def test_the_simulation_moves_the_fingers(hand: Hand, run_dir: Path) -> None:
    options = {key: value for key, value in hand.options.items() if key in hand.twin}
    with Robot(hand.robot, **options) as simulated:
        assert simulated.connect_eagerly() is None
        json_of(simulated.send_action({"gripper": 40.0}))
        until(lambda: stands_at(simulated, 40.0), "the fingers are there")
        assert json_of(simulated.stop())["motors"]["gripper"]["safe"]
