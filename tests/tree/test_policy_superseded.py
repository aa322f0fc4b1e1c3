"""A setpoint that a newer one of the same rollout has replaced does not count as refused."""

from __future__ import annotations

from collections.abc import Mapping

import pytest
import trio
import trio.testing

from strands_actors.kernel.mailbox import SUPERSEDED
from strands_actors.kernel.messages import Refused
from strands_actors.supervisors import addresses
from strands_actors.supervisors.gate.gate import Gate
from strands_actors.supervisors.gate.messages import Accepted, Setpoint
from strands_actors.supervisors.policy import Policy
from strands_actors.supervisors.root.messages import Rollout, TaskStatus
from strands_actors.testing import open_inline_tree

from .writer import armed


class Still:
    def get_actions_sync(self, observation: Mapping[str, float], instruction: str) -> list[dict[str, float]]:
        return [{"a": 0.0}] * 10


def test_a_superseded_setpoint_does_not_end_the_rollout(monkeypatch: pytest.MonkeyPatch) -> None:
    judge = Gate._setpoint
    setpoints: list[Setpoint] = []

    def every_third(gate: Gate, message: Setpoint) -> Accepted | Refused:
        setpoints.append(message)
        answer = judge(gate, message)
        return SUPERSEDED if len(setpoints) % 3 == 0 and len(setpoints) < 40 else answer

    monkeypatch.setattr(Gate, "_setpoint", every_third)

    async def run() -> None:
        async with open_inline_tree() as tree:
            caller = await armed(tree)
            ended: list[TaskStatus] = []
            over = trio.Event()

            def report(status: TaskStatus) -> None:
                if not status.running:
                    ended.append(status)
                    over.set()

            robot = tree.gate.address.split("/")[1]
            rollout = Rollout(robot, ("a", "b"), "", 0.01, 0.1, 10.0, n_steps=60, over=caller.lease.id)
            cell = tree.node.cell(
                addresses.of(robot).path("policy"), lambda: Policy(rollout, lambda: Still(), report)
            )
            async with trio.open_nursery() as nursery:
                nursery.start_soon(cell.run)
                with trio.fail_after(5.0):
                    await over.wait()
                nursery.cancel_scope.cancel()
            assert ended[0].exit_reason == "n_steps", ended[0]

    # An inference runs in a thread, and virtual time waits until the loop has been idle for this long.
    trio.run(run, clock=trio.testing.MockClock(autojump_threshold=0.005))
