"""The built-in policies begin at the robot's position, and no gate of any robot refuses their actions."""

from __future__ import annotations

import math
from typing import Any

import pytest
from msgspec.structs import replace

from strands_actors.contract.driver import GateState
from strands_actors.contract.positions import Positions
from strands_actors.kernel.clock import NS
from strands_actors.kernel.messages import Refused
from strands_actors.policies.mock import Mock
from strands_actors.policies.registry import Sine
from strands_actors.supervisors.policy import as_infer, prepare

from .robots import NOW_NS, drivers, observed

DRIVERS = {name: driver for name, driver in drivers().items() if not driver.ROLLOUTS}
RUNS_S = 3.0


def first_refusal(robot: str, policy: Any, at_share: float) -> Refused | None:
    """Run a policy for ``RUNS_S`` on a robot that follows at once, and return the first refusal.

    Args:
        robot: The robot's name.
        policy: The policy.
        at_share: Where each joint is at first, as a share of its range.
    """
    driver = DRIVERS[robot]
    hz = driver.timing.control_hz
    seen = observed(driver)
    if at_share != 0.5:
        ends = [(axis.low + at_share * (axis.high - axis.low)) for axis in driver.table]
        position = tuple(end if math.isfinite(end) else 0.0 for end in ends)
        seen = replace(seen, position=position)
    prepare(policy, driver.axes, hz, driver.table)
    infer, target, actions = as_infer(policy), driver.first_target(seen), list[Any]()
    for step in range(round(RUNS_S * hz)):
        if not actions:
            actions = list(infer(Positions(zip(driver.axes, seen.position, strict=True)), ""))
        now_ns = NOW_NS + round(step / hz * NS)
        seen = replace(seen, t_ns=now_ns, stamp_ns=(now_ns,) * len(seen.stamp_ns))
        state = GateState(now_ns, seen, target, now_ns - round(NS / hz), True, 1 / hz)
        parsed = driver.parse(actions.pop(0), state)
        if isinstance(parsed, Refused):
            return parsed
        for gate in driver.gates:
            if (refusal := gate(parsed, state)) is not None:
                return refusal
        target = parsed.values
        seen = replace(seen, position=target[: len(driver.axes)])
    return None


@pytest.mark.parametrize("robot", DRIVERS)
def test_a_built_in_policy_is_not_gated(robot: str) -> None:
    assert first_refusal(robot, Mock(DRIVERS[robot].axes), 0.5) is None


@pytest.mark.parametrize("at_share", [0.0, 1.0], ids=["at its low ends", "at its high ends"])
@pytest.mark.parametrize("made_by", [Mock, Sine])
@pytest.mark.parametrize("robot", {type(driver): robot for robot, driver in DRIVERS.items()}.values())
def test_a_built_in_policy_is_not_gated_at_an_end(robot: str, made_by: type[Any], at_share: float) -> None:
    assert first_refusal(robot, made_by(DRIVERS[robot].axes), at_share) is None


@pytest.mark.parametrize("made_by", [Mock, Sine])
def test_a_built_in_policy_begins_at_the_robots_position_and_moves_it(made_by: type[Any]) -> None:
    driver = DRIVERS["ur5e"]
    seen = Positions(zip(driver.axes, observed(driver).position, strict=True))
    policy = made_by(driver.axes)
    prepare(policy, driver.axes, 125.0, driver.table)
    actions = [action for _ in range(50) for action in as_infer(policy)(seen, "")]
    assert actions[0] == dict(seen)
    for axis in driver.axes:
        assert max(abs(action[axis] - seen[axis]) for action in actions) > 0.02


def test_a_given_amplitude_is_kept() -> None:
    driver = DRIVERS["ur5e"]
    seen = Positions(zip(driver.axes, observed(driver).position, strict=True))
    policy = Mock(driver.axes, amplitude=2.0)
    prepare(policy, driver.axes, 125.0, driver.table)
    actions = [action for _ in range(100) for action in as_infer(policy)(seen, "")]
    assert max(action[driver.axes[0]] for action in actions) == pytest.approx(2.0, abs=0.05)
