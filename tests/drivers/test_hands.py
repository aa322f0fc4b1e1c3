"""Test the hands of arms on their twins, a row a hand: real processes and sockets. The log of the wire decides."""

from __future__ import annotations

import functools
import os
import signal
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from strands_actors import Robot
from strands_actors.caller.handle.robot import RealRobot
from strands_actors.drivers.franka import hand_protocol as franka
from strands_actors.drivers.kinova import protocol as kinova
from strands_actors.drivers.xarm import protocol as xarm
from strands_actors.testing import Twin
from strands_actors.testing.wirelog import Entry
from tests.answers import json_of, pids, resumed, state, status, until, why
from tests.trees import connected, made_safe, robot_on, shared_twin


class Hand(NamedTuple):
    """A hand of an arm.

    Attributes:
        robot: The arm.
        gripper: The option ``gripper``.
        joint: A joint of the arm.
        goals: Openings in percent to which it is sent, from open on.
        slow: Options with which a motion takes a while; None for a hand that switches.
        meets: The opening at which it meets the object.
        faults: Orders to the twin that make it fail, each with the text in the status, and the order that repairs.
    """

    robot: str
    gripper: str
    joint: str
    goals: tuple[float, ...]
    slow: dict[str, Any] | None
    meets: float
    faults: tuple[tuple[str, str, str], ...] = ()

    def targets(self, twin: Twin, since_ns: int) -> list[Entry]:
        """Return the frames since a time that give the fingers a target."""
        return [entry for entry in twin.log.host("setpoint", since_ns) if TARGETS[self.robot](entry.data)]


def _is_xarm_target(frame: bytes) -> bool:
    return frame[6] in (xarm.Register.TOOL_RS485, xarm.Register.TOOL_WRITE_16)


def _is_kinova_target(frame: bytes) -> bool:
    return any(received.call == kinova.Call.SEND_GRIPPER_COMMAND for received in kinova.Decoder().feed(frame))


def _is_franka_target(frame: bytes) -> bool:
    """Return True for a request to the hand. All setpoints of the arm are longer."""
    return len(frame) <= franka.HEADER.size + franka.GRASP.size


TARGETS = {"xarm7": _is_xarm_target, "kinova_gen3": _is_kinova_target, "panda": _is_franka_target}

XARM_FAULTS = (
    ("gripper error 34", "overload", "gripper error 0"),
    ("gripper lost", "does not answer", "gripper found"),
)
KINOVA_FAULTS = (("gripper lost", "no gripper", "gripper found"),)
FRANKA_FAULTS = (("gripper unhomed", "home_gripper first", "gripper homed"),)

HANDS = (
    Hand("xarm7", "xarm_gripper", "joint1", (60.0, 0.0, 100.0), {"gripper_speed": 5.0}, 40.0, XARM_FAULTS),
    Hand("kinova_gen3", "robotiq_2f85", "joint_1", (60.0, 0.0, 100.0), None, 40.0, KINOVA_FAULTS),
    Hand("panda", "franka_hand", "joint1", (60.0, 0.0, 100.0), {"gripper_speed": 5.0}, 40.0, FRANKA_FAULTS),
    Hand("xarm7", "xarm_vacuum", "joint1", (0.0, 100.0), None, 0.0),
)
with_fingers = pytest.mark.parametrize(
    "hand", [hand for hand in HANDS if hand.slow is not None], ids=lambda hand: hand.gripper, indirect=True
)
"""For hands with fingers that take a while, and not for valves that switch."""

OPENING = 1.5
"""Percent by which an opening may differ."""


@pytest.fixture(scope="module", params=HANDS, ids=lambda hand: hand.gripper)
def hand(request: pytest.FixtureRequest) -> Hand:
    chosen: Hand = request.param
    return chosen


@pytest.fixture(scope="module")
def twin_process(hand: Hand, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Twin]:
    directory = tmp_path_factory.mktemp("twin")
    with Twin(hand.robot, directory, options={"gripper": hand.gripper}) as process:
        yield process


@pytest.fixture
def twin(hand: Hand, twin_process: Twin) -> Iterator[Twin]:
    with shared_twin(twin_process, "object none", *(repair for _, _, repair in hand.faults)) as process:
        yield process


@pytest.fixture
def arm(hand: Hand, twin: Twin, run_dir: Path) -> Iterator[RealRobot]:
    with robot_on(twin.port, hand.robot, gripper=hand.gripper) as connected:
        reach(connected, 100.0)
        yield connected


def opening(arm: RealRobot) -> float:
    return float(arm.get_observation()["gripper"])


def contact(arm: RealRobot) -> list[float]:
    found: list[float] = status(arm)["sensors"].get("gripper_contact", [])
    return found


def reach(arm: RealRobot, percent: float) -> None:
    json_of(arm.send_action({"gripper": percent}))
    until(lambda: abs(opening(arm) - percent) < OPENING, f"it is {percent} % open")


def nudge_arm(hand: Hand, arm: RealRobot) -> None:
    """Move one joint of the arm a little. Some arms need a target for each joint."""
    position = arm.get_observation()
    joints = {joint: rad for joint, rad in position.items() if joint != "gripper"}
    still = joints if arm.driver.WHOLE_ACTIONS else {}
    json_of(arm.send_action({**still, hand.joint: position[hand.joint] + 0.01}))


def _reports(arm: RealRobot, text: str) -> bool:
    return text in status(arm)["faults"].get("gripper", "")


def grip(hand: Hand, arm: RealRobot, twin: Twin) -> None:
    """Close the hand on an object, and wait until it is reported."""
    twin.order(f"object {hand.meets:g}")
    json_of(arm.send_action({"gripper": 0.0}))
    until(lambda: contact(arm) == [1.0], "it holds the object")
    until(lambda: abs(opening(arm) - hand.meets) < OPENING, "it has stopped at the object")


def test_it_moves_and_a_motion_of_the_arm_sends_it_nothing(hand: Hand, arm: RealRobot, twin: Twin) -> None:
    for goal in hand.goals:
        reach(arm, goal)
    assert contact(arm) == [0.0]
    began_ns = time.monotonic_ns()
    nudge_arm(hand, arm)
    until(lambda: twin.log.host("setpoint", began_ns), "the arm has a setpoint")
    time.sleep(0.2)
    assert not hand.targets(twin, began_ns)


def test_saf_014_refused_values_write_nothing(hand: Hand, arm: RealRobot, twin: Twin) -> None:
    began_ns = time.monotonic_ns()
    assert "gripper 101.0 % is past 100.0" in why(arm.send_action({"gripper": 101.0}))
    assert "gripper_speed" in why(arm.send_action({hand.joint: 0.0, "gripper_speed": 10.0}))
    assert "gripper_speed" in why(arm.send_action({"gripper": 50.0, "gripper_speed": 101.0}))
    assert "no setting for gripper_force" in why(arm.send_action({"gripper": 50.0, "gripper_force": 10.0}))
    time.sleep(0.2)
    assert not hand.targets(twin, began_ns)


def test_saf_003_a_stop_keeps_the_grip_and_so_does_the_resume(hand: Hand, arm: RealRobot, twin: Twin) -> None:
    grip(hand, arm, twin)
    began_ns = time.monotonic_ns()
    stopped = json_of(arm.stop())["motors"]
    assert stopped["gripper"]["safe"] and list(stopped)[-1] == "gripper"
    resumed(arm)
    nudge_arm(hand, arm)
    time.sleep(0.3)
    assert not hand.targets(twin, began_ns), "the fingers get no target"
    assert contact(arm) == [1.0]
    assert abs(opening(arm) - hand.meets) < OPENING


@with_fingers
def test_saf_003_a_stop_ends_a_motion_of_the_fingers(hand: Hand, twin: Twin, run_dir: Path) -> None:
    with robot_on(twin.port, hand.robot, gripper=hand.gripper, **(hand.slow or {})) as arm:
        json_of(arm.send_action({"gripper": 100.0, "gripper_speed": 100.0}))
        until(lambda: opening(arm) > 99.0, "it is open")
        json_of(arm.send_action({"gripper": 0.0}))
        until(lambda: opening(arm) < 97.0, "it closes")
        began_ns = time.monotonic_ns()
        assert json_of(arm.stop())["motors"]["gripper"]["safe"]
        time.sleep(0.3)
        stood = opening(arm)
        time.sleep(0.3)
        assert abs(opening(arm) - stood) < 0.5 and stood > 5.0
        twin.log.no_setpoint_after_safe(began_ns)


@pytest.mark.parametrize("fault", [signal.SIGKILL, signal.SIGSTOP], ids=["killed", "frozen"])
def test_saf_003_the_grip_survives_the_wire_process(
    hand: Hand, arm: RealRobot, twin: Twin, fault: signal.Signals
) -> None:
    grip(hand, arm, twin)
    victim = pids(arm)["wire"]
    began_ns = time.monotonic_ns()
    os.kill(victim, fault)
    made_safe(twin.log, began_ns)
    until(lambda: state(arm) == "disarmed", "it is back, disarmed")
    assert not hand.targets(twin, began_ns)
    assert contact(arm) == [1.0]
    assert abs(opening(arm) - hand.meets) < OPENING
    resumed(arm)
    time.sleep(0.2)
    assert not hand.targets(twin, began_ns)


@with_fingers
def test_saf_003_a_killed_wire_process_stops_moving_fingers(hand: Hand, twin: Twin, run_dir: Path) -> None:
    with robot_on(twin.port, hand.robot, gripper=hand.gripper, **(hand.slow or {})) as arm:
        json_of(arm.send_action({"gripper": 100.0, "gripper_speed": 100.0}))
        until(lambda: opening(arm) > 99.0, "it is open")
        json_of(arm.send_action({"gripper": 0.0}))
        until(lambda: opening(arm) < 97.0, "it closes")
        began_ns = time.monotonic_ns()
        os.kill(pids(arm)["wire"], signal.SIGKILL)
        made_safe(twin.log, began_ns)
        until(lambda: state(arm) == "disarmed", "it is back, disarmed")
        stood = opening(arm)
        time.sleep(0.4)
        assert abs(opening(arm) - stood) < 0.5 and stood > 5.0


@pytest.mark.parametrize(
    "hand", [hand for hand in HANDS if hand.faults], ids=lambda hand: hand.gripper, indirect=True
)
def test_a_fault_is_reported_and_only_the_hand_is_refused(hand: Hand, arm: RealRobot, twin: Twin) -> None:
    for order, text, repair in hand.faults:
        twin.order(order)
        until(functools.partial(_reports, arm, text), f"the status has {text}")
        assert text in why(arm.send_action({"gripper": 50.0}))
        nudge_arm(hand, arm)
        twin.order(repair)
        until(lambda: "gripper" not in status(arm)["faults"], "it works again")


def test_a_simulation_moves_it_and_an_agent_may_open_and_close_it(hand: Hand, run_dir: Path) -> None:
    make: Any = Robot
    arm: RealRobot
    with make(hand.robot, gripper=hand.gripper) as arm:
        connected(arm)
        assert list(arm.get_observation())[-1] == "gripper"
        for goal in hand.goals:
            reach(arm, goal)
        assert {"open", "close"} <= {verb.name for verb in arm.driver.TOOL_VERBS}
        json_of(arm.stop())
        resumed(arm)
        assert abs(opening(arm) - hand.goals[-1]) < OPENING
