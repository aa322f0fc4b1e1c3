"""Which end of a rollout comes first: its steps, or its duration."""

from __future__ import annotations

import math
from collections.abc import Mapping

import pytest
import trio
import trio.testing

from strands_actors.supervisors import addresses
from strands_actors.supervisors.policy import Policy
from strands_actors.supervisors.root.messages import Rollout, TaskStatus
from strands_actors.testing import open_inline_tree

from .writer import armed


class Still:
    def get_actions_sync(self, observation: Mapping[str, float], instruction: str) -> list[dict[str, float]]:
        return [{"a": 0.0}] * 10


@pytest.mark.parametrize(
    ("limited", "n_steps", "reason"),
    [(True, 10_000_000, "duration"), (True, 20, "n_steps"), (True, 0, "duration"), (False, 80, "n_steps")],
)
def test_a_rollout_that_is_told_over_the_mesh_is_over_in_time(limited: bool, n_steps: int, reason: str) -> None:
    """Of one that its own program counts the steps of, these win."""

    async def run() -> None:
        async with open_inline_tree() as tree:
            caller = await armed(tree)
            over, ended = trio.Event(), list[TaskStatus]()

            def report(status: TaskStatus) -> None:
                if not status.running:
                    ended.append(status)
                    over.set()

            robot = tree.gate.address.split("/")[1]
            longest_s = 0.5 if limited else math.inf
            rollout = Rollout(robot, ("a", "b"), "", 0.01, 0.1, longest_s, n_steps=n_steps, over=caller.lease.id)
            cell = tree.node.cell(addresses.of(robot).path("policy"), lambda: Policy(rollout, Still, report))
            async with trio.open_nursery() as nursery:
                nursery.start_soon(cell.run)
                with trio.fail_after(3.0):
                    await over.wait()
                nursery.cancel_scope.cancel()
            assert ended[0].exit_reason == reason, ended[0]

    # an inference is in a thread: virtual time stands still until the loop has been idle for so
    # long
    trio.run(run, clock=trio.testing.MockClock(autojump_threshold=0.005))
