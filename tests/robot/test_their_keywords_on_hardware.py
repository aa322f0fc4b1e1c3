"""Keywords of strands-robots' verbs that scripts use with its robots. They have the same meaning here."""

from __future__ import annotations

import time

from strands_actors import RealRobot, Teleoperator
from tests.answers import json_of, why

from .helpers import Ahead


def test_another_robots_policy_is_refused_on_hardware(arm: RealRobot) -> None:
    policy = Ahead()
    assert why(arm.run_policy(policy, robot_name="ur5e")).startswith("run_policy: robot_name is 'ur5e'")
    assert not policy.steps
    assert json_of(arm.run_policy(policy, n_steps=2, robot_name="so101", wait=True))["steps"] == 2


def test_teleoperate_waits_only_with_block(arm: RealRobot) -> None:
    keyboard = Teleoperator("keyboard")
    began_s = time.monotonic()
    assert json_of(arm.teleoperate(keyboard, block=False, duration=60.0))["running"]
    assert json_of(arm.teleoperate())["running"], "the attached leader continues"
    assert time.monotonic() - began_s < 30.0
    arm.stop_task()
    json_of(arm.attach_teleop(keyboard, duration=0.3))
    assert not json_of(arm.teleoperate(block=True))["running"]


def test_teleoperate_without_a_leader_is_refused(arm: RealRobot) -> None:
    assert "no leader is attached" in why(arm.teleoperate(block=True))
    assert "block is 'no'" in why(arm.teleoperate(Teleoperator("keyboard"), block="no"))  # type: ignore[arg-type]
