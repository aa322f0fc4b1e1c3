"""A simulation is teleoperated as a robot is: by an arm that is moved by hand, or by rates, up to the end of an
axis."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy
import pytest
import trio

from strands_actors import Robot, Teleoperator
from strands_actors.caller.handle.robot import SimRobot
from strands_actors.kernel.clock import MonotonicClock
from strands_actors.supervisors.root.messages import Operate
from strands_actors.teleoperation.verbs import operate
from tests.answers import json_of, task, until, why

from .conftest import NEUTRAL

pytestmark = pytest.mark.real_time

TURN_S = 0.03
PRESS_S = 3.0


@pytest.fixture
def sim(run_dir: Path) -> Iterator[SimRobot]:
    """A simulation that holds in the middle of its ranges."""
    made = Robot("so101")
    try:
        assert until(lambda: made.connect_eagerly() is None, "it connects")
        json_of(made.send_action(NEUTRAL))
        until(lambda: all(abs(made.get_observation()[key]) < 4 for key in NEUTRAL), "rest")
        yield made
    finally:
        made.cleanup()


def led(sim: SimRobot, there: Callable[[], bool], **rates: float) -> bool:
    """Return True if one press leads the joint there. On a busy machine a press may be missed or end in a hold."""
    for held, seconds in ((False, 0.2), (True, PRESS_S)):
        until_s = time.monotonic() + seconds
        while time.monotonic() < until_s:
            json_of(sim.operate(held, **rates))
            if held and there():
                return True
            time.sleep(TURN_S)
    return False


@pytest.mark.long
def test_an_arm_leads_a_simulation(sim: SimRobot) -> None:
    with Teleoperator("so101_leader", transport="twin") as leader:
        leader.move_by_hand({**NEUTRAL, "shoulder_pan": 10.0, "gripper": 50.0})
        json_of(sim.attach_teleop(leader, deadman="key"))
        until(lambda: task(sim).get("teleop", {}).get("leader_age_ms"), "it is read")
        until(lambda: led(sim, lambda: abs(sim.get_observation()["shoulder_pan"] - 10) < 1.5), "it follows", 60.0)
        assert task(sim)["steps"] > 0
        assert json_of(sim.stop_task())["exit_reason"] == "stopped"


def test_rates_lead_a_simulation(sim: SimRobot) -> None:
    json_of(sim.attach_teleop(Teleoperator("keyboard")))
    before = sim.get_observation()["wrist_roll"]
    until(
        lambda: led(sim, lambda: sim.get_observation()["wrist_roll"] > before + 3, wrist_roll=1.0), "it goes", 60.0
    )


def test_rates_lead_the_tool_of_a_simulation_straight_up(sim: SimRobot) -> None:
    json_of(sim.attach_teleop(Teleoperator("keyboard")))

    def tool() -> list[float]:
        place: list[float] = json_of(sim.get_pose())["xyz"]
        return place

    x, y, z = tool()
    until(lambda: led(sim, lambda: tool()[2] > z + 0.02, ee_z=1.0), "it goes", 60.0)
    assert tool()[:2] == pytest.approx([x, y], abs=0.01)
    assert "'ee_q' is no axis of so101" in why(sim.operate(held=True, ee_q=1.0))


def test_a_leader_with_a_gripper_needs_an_option_for_a_key_as_dead_man(sim: SimRobot) -> None:
    with Teleoperator("so101_leader", transport="twin") as leader:
        assert "no teleoperation runs" in why(sim.operate(held=True))
        json_of(sim.attach_teleop(leader))
        assert 'attach_teleop(leader, deadman="key")' in why(sim.operate(held=True))
        json_of(sim.stop_task())
        json_of(sim.attach_teleop(leader, deadman="key"))
        json_of(sim.operate(held=False))


def test_wrong_arguments_are_refused(sim: SimRobot) -> None:
    leader = Teleoperator("keyboard")
    assert "hz is nan" in why(sim.attach_teleop(leader, hz=float("nan")))
    assert "deadman is 'foot'" in why(sim.attach_teleop(leader, deadman="foot"))


def test_the_status_has_every_key_of_a_teleoperation_from_its_start_to_its_end(sim: SimRobot) -> None:
    begun = json_of(sim.attach_teleop(Teleoperator("keyboard")))
    first = task(sim)
    assert first["running"] and begun["teleop"].keys() == first["teleop"].keys()
    assert begun["teleop"] == {
        "state": "idle",
        "why": "the dead-man is not held",
        "leader": "connecting",
        "leader_age_ms": None,
        "held": False,
        "values": {},
        "refused": 0,
        "differs": {},
        "at_end": [],
    }
    led = until(lambda: now if (now := task(sim))["teleop"]["leader"] == "connected" else None, "it is led")
    assert led["teleop"].keys() == first["teleop"].keys()
    json_of(sim.stop())
    ended = task(sim)
    assert ended["exit_reason"] and ended["teleop"].keys() == first["teleop"].keys()


SLIPS: list[tuple[dict[str, Any], str]] = [
    ({"held": "False", "shoulder_pan": 0.5}, "held is 'False'. Give True or False"),
    ({"held": 1}, "held is 1. Give True or False"),
    ({"held": None}, "held is None"),
    (
        {"held": True, "sholder_pan": 0.5},
        "'sholder_pan' is no axis of so101 ('shoulder_pan'?). Give one of shoulder",
    ),
    ({"held": True, "shoulder_pan": float("nan")}, "shoulder_pan is nan. Give a rate in -1..1"),
    ({"held": True, "shoulder_pan": 50.0}, "shoulder_pan is 50.0. Give a rate in -1..1"),
    ({"held": True, "shoulder_pan": "fast"}, "shoulder_pan is 'fast'. Give a rate in -1..1"),
    ({"held": True, "shoulder_pan": True}, "shoulder_pan is True. Give a rate in -1..1"),
    ({"held": True, "shoulder_pan": [1]}, "shoulder_pan is [1]. Give a rate in -1..1"),
    ({"held": False, "sholder_pan": 0.5}, "'sholder_pan' is no axis"),
]


def test_saf_014_a_mistake_of_the_operator_moves_nothing(sim: SimRobot) -> None:
    json_of(sim.attach_teleop(Teleoperator("keyboard")))
    before = sim.get_observation()["shoulder_pan"]
    for slip, message in SLIPS:
        json_of(sim.operate(held=False))  # release, then a new press
        for _ in range(5):
            assert message in why(sim.operate(**slip)), slip
            time.sleep(TURN_S)
    now = task(sim)
    assert (now["steps"], now["teleop"]["held"]) == (0, False)
    assert abs(sim.get_observation()["shoulder_pan"] - before) < 0.5
    stick: Any = numpy.float32(-32768 / 32767)  # the end of the stick's range
    json_of(sim.operate(held=True, shoulder_pan=stick))


def test_saf_014_a_mistake_does_not_prevent_a_release() -> None:
    received: list[Operate] = []
    tree: Any = SimpleNamespace(clock=MonotonicClock(), rollouts=SimpleNamespace(operate=received.append))
    run = operate(Robot("so101").driver, False, {"wrist": 0.5})
    assert callable(run) and "'wrist' is no axis" in why(trio.run(run, tree))
    (only,) = received
    assert (only.held, only.rates) == (False, {})
