"""A policy that returns one action at a time, at 500 Hz: the observations that it gets, and the setpoints
that it sends.
"""

from __future__ import annotations

import functools
from collections.abc import Mapping
from typing import Any

import pytest
import trio
import trio.testing

from strands_actors.supervisors import addresses
from strands_actors.supervisors.gate.gate import Gate
from strands_actors.supervisors.gate.messages import GetObservation
from strands_actors.supervisors.policy import Policy
from strands_actors.supervisors.root.messages import Rollout, TaskStatus
from strands_actors.testing import FakeHardware, open_inline_tree

from .writer import armed

PERIOD_S = 0.002
STEPS = 100


class Follower:
    """Move by a small step from the observed position each time."""

    def __init__(self) -> None:
        self.seen: list[float] = []

    def get_actions_sync(self, observation: Mapping[str, float], instruction: str) -> list[dict[str, float]]:
        self.seen.append(observation["a"])
        return [{"a": observation["a"] + 0.01}]


def test_each_inference_gets_the_observation_that_came_with_the_last_acknowledgement(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The wire reads at its control rate, so each acknowledgement brings a new observation. The policy
    hardly ever has to ask for one separately.
    """
    requests: list[type] = []
    receive = Gate.receive

    @functools.wraps(receive)
    def count(gate: Gate, message: Any) -> Any:
        requests.append(type(message))
        return receive(gate, message)

    policy = Follower()

    async def run() -> None:
        async with open_inline_tree(FakeHardware(read_s=0.0, confirm_s=0.0)) as tree:
            caller = await armed(tree)
            over, ended = trio.Event(), list[TaskStatus]()

            def report(status: TaskStatus) -> None:
                if not status.running:
                    ended.append(status)
                    over.set()

            robot = tree.gate.address.split("/")[1]
            rollout = Rollout(robot, ("a", "b"), "", PERIOD_S, 0.1, 10.0, n_steps=STEPS, over=caller.lease.id)
            cell = tree.node.cell(
                addresses.of(robot).path("policy"), lambda: Policy(rollout, lambda: policy, report)
            )
            async with trio.open_nursery() as nursery:
                nursery.start_soon(cell.run)
                with trio.fail_after(5.0):
                    await over.wait()
                nursery.cancel_scope.cancel()
            assert ended[0].exit_reason == "n_steps", ended[0]
            assert ended[0].steps == STEPS

    monkeypatch.setattr(Gate, "receive", count)
    trio.run(run, clock=trio.testing.MockClock(autojump_threshold=0.002))
    assert requests.count(GetObservation) < STEPS / 4
    assert policy.seen == sorted(policy.seen)
    assert policy.seen[-1] > policy.seen[0]
