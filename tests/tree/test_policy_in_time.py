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
from strands_actors.testing import InlineTree, open_inline_tree

from .writer import armed


class Still:
    def get_actions_sync(self, observation: Mapping[str, float], instruction: str) -> list[dict[str, float]]:
        return [{"a": 0.0}] * 10


async def end_of(rollout: Rollout, policy: type[Still], tree: InlineTree) -> TaskStatus:
    """Run a rollout to its end and return its last status."""
    over, ended = trio.Event(), list[TaskStatus]()

    def report(status: TaskStatus) -> None:
        if not status.running:
            ended.append(status)
            over.set()

    cell = tree.node.cell(addresses.of(rollout.robot).path("policy"), lambda: Policy(rollout, policy, report))
    async with trio.open_nursery() as nursery:
        nursery.start_soon(cell.run)
        with trio.fail_after(5.0):
            await over.wait()
        nursery.cancel_scope.cancel()
    return ended[0]


@pytest.mark.parametrize(
    ("limited", "n_steps", "reason"),
    [(True, 10_000_000, "duration"), (True, 20, "n_steps"), (True, 0, "duration"), (False, 80, "n_steps")],
)
def test_a_rollout_ends_at_its_duration_or_its_number_of_steps(limited: bool, n_steps: int, reason: str) -> None:
    """A rollout without a limited duration ends after its steps."""

    async def run() -> None:
        async with open_inline_tree() as tree:
            caller = await armed(tree)
            robot = tree.gate.address.split("/")[1]
            longest_s = 0.5 if limited else math.inf
            rollout = Rollout(robot, ("a", "b"), "", 0.01, 0.1, longest_s, n_steps=n_steps, over=caller.lease.id)
            ended = await end_of(rollout, Still, tree)
            assert ended.exit_reason == reason, ended

    # An inference runs in a thread, and virtual time waits until the loop has been idle for this long.
    trio.run(run, clock=trio.testing.MockClock(autojump_threshold=0.005))


class Nothing(Still):
    """A policy that never returns an action, as one that waits for its pictures."""

    def get_actions_sync(self, observation: Mapping[str, float], instruction: str) -> list[dict[str, float]]:
        return []


@pytest.mark.parametrize(("policy", "reason"), [(Still, "duration"), (Nothing, "policy")])
def test_the_duration_counts_from_the_first_action_for_which_there_is_a_limit(
    policy: type[Still], reason: str
) -> None:
    async def run() -> None:
        async with open_inline_tree() as tree:
            caller = await armed(tree)
            robot = tree.gate.address.split("/")[1]
            rollout = Rollout(robot, ("a", "b"), "", 0.01, 0.1, 0.2, over=caller.lease.id, load_s=1.0)
            ended = await end_of(rollout, policy, tree)
            assert ended.exit_reason == reason, ended
            if policy is Nothing:
                assert (ended.steps, ended.exit_detail) == (0, "it returned no action within 1 s")

    trio.run(run, clock=trio.testing.MockClock(autojump_threshold=0.005))
