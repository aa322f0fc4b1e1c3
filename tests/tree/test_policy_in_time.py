"""The end of a rollout with a number of steps and a duration: the first of the two counts."""

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
def test_a_rollout_ends_at_its_duration_or_its_number_of_steps(limited: bool, n_steps: int, reason: str) -> None:
    """A rollout without a limited duration ends after its steps."""

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

    # An inference runs in a thread, and virtual time waits until the loop has been idle for this long.
    trio.run(run, clock=trio.testing.MockClock(autojump_threshold=0.005))
