"""An exception of a policy ends its rollout only. The robot and other robots of the script continue."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping

import pytest

from strands_actors.caller.handle.robot import RealRobot
from strands_actors.testing import Twin
from tests.answers import json_of, until

Start = Callable[..., tuple[RealRobot, Twin]]


@pytest.mark.parametrize("raised", [SystemExit(3), asyncio.CancelledError(), KeyboardInterrupt()], ids=repr)
def test_saf_006_an_exception_that_would_end_the_process_ends_only_the_rollout(
    strands_robot: Start, raised: BaseException
) -> None:
    arm, _ = strands_robot("so101", tool_name="one")
    other, _ = strands_robot("so101", tool_name="other")

    def policy(seen: Mapping[str, float]) -> dict[str, float]:
        raise raised

    json_of(arm.run_policy(policy, duration=5.0))
    ended = until(lambda: None if (task := json_of(arm.get_task_status()))["running"] else task, "the rollout ends")
    assert ended["exit_reason"] == "policy" and type(raised).__name__ in ended["exit_detail"], ended
    for robot in (arm, other):
        assert json_of(robot.stop())["stopped"]
        assert robot.resume()["status"] == "success"
