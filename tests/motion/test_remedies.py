"""A single command that is too far or too fast is refused with ``move_to`` as a remedy, where the robot has it."""

from __future__ import annotations

import pytest

from strands_actors.caller.session.motions import refuse_targets
from strands_actors.contract.driver import Candidate, Driver, GateState
from strands_actors.kernel.messages import Refused
from strands_actors.kernel.refusals import Code

from .robots import NOW_NS, drivers, observed
from .test_plans import targets_of

DRIVERS = drivers()
TOO_FAR = (Code.TOO_FAST, Code.RUNS_AHEAD, Code.JUMP)
BY_DURATION = ("reachy_mini", "robotiq_2f85", "robotiq_2f85_v4")
"""Robots whose commands take a time. Their remedy is a longer one."""


def refused(driver: Driver, targets: dict[str, float], stream: bool) -> Refused | None:
    """Return the refusal of targets by the driver and its gates."""
    seen = observed(driver)
    target = driver.first_target(seen)
    period_s = 1 / driver.timing.control_hz if stream else 0.0
    state = GateState(NOW_NS, seen, target, NOW_NS, stream, period_s)
    candidate = driver.parse(targets, state)
    if not isinstance(candidate, Candidate):
        return candidate
    return next((refusal for gate in driver.gates if (refusal := gate(candidate, state)) is not None), None)


def refusals_of(name: str, stream: bool) -> list[Refused]:
    """Return the refusals of a far target of each joint, for their distance or speed."""
    driver = DRIVERS[name]
    found = (refused(driver, {key: target}, stream) for key, target in targets_of(driver).items())
    return [refusal for refusal in found if refusal is not None and refusal.code in TOO_FAR]


@pytest.mark.parametrize("name", [name for name in DRIVERS if name not in BY_DURATION])
def test_a_far_target_is_refused_with_move_to_where_the_robot_has_it(name: str) -> None:
    driver = DRIVERS[name]
    has_move_to = refuse_targets(driver, targets_of(driver)) is None
    for refusal in refusals_of(name, stream=False):
        assert ("use move_to({" in refusal.remedy) is has_move_to, refusal.text


@pytest.mark.parametrize("name", DRIVERS)
def test_a_step_of_a_stream_is_refused_with_the_longest_step(name: str) -> None:
    """The policy or the script that sends the stream plans the motion itself."""
    assert [refusal.text for refusal in refusals_of(name, stream=True) if "move_to" in refusal.remedy] == []


def test_there_are_such_robots() -> None:
    named = {name for name in DRIVERS if refusals_of(name, stream=False)}
    assert {"ur5e", "kinova_gen3", "kuka_iiwa", "xarm7", "rby1", "booster_t1", "unitree_g1"} <= named
    assert refuse_targets(DRIVERS["unitree_g1"], {}) is not None
