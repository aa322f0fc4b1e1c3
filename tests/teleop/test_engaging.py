"""A teleoperation beside a gate that answers late: the press is not lost. In virtual time."""

from __future__ import annotations

from typing import Any

import msgspec
import pytest
import trio

from strands_actors.contract.axis import Axis
from strands_actors.kernel.messages import Message
from strands_actors.kernel.node import AskTimeout, Ref
from strands_actors.supervisors import addresses
from strands_actors.supervisors.gate.messages import Acquire, GetObservation
from strands_actors.supervisors.root.messages import Operate, Rollout, TaskStatus
from strands_actors.teleoperation.actor import Teleoperation
from strands_actors.testing import open_inline_tree, run_virtual
from tests.tree.writer import armed, setpoints

CHANNEL = "policy process 7"
PRESSED_S = 0.6


class LosesAnswers:
    """The gate as a policy process reaches it. Of one kind of message the first ``count`` answers
    come too late."""

    def __init__(self, gate: Ref, kind: type[Message], count: int) -> None:
        self._gate = gate
        self._kind = kind
        self.left = count

    async def ask(self, message: Any, deadline_s: float) -> Message | None:
        if "channel" in message.__struct_fields__:
            message = msgspec.structs.replace(message, channel=CHANNEL)
        answer = await self._gate.ask(message, deadline_s)
        if type(message) is self._kind and self.left:
            self.left -= 1
            await trio.sleep(deadline_s)
            raise AskTimeout("lost")
        return answer


@pytest.mark.parametrize("kind", [Acquire, GetObservation])
def test_saf_009_a_press_whose_answers_come_late_engages_all_the_same(kind: type[Message]) -> None:
    async def run() -> None:
        async with open_inline_tree() as tree:
            writer = await armed(tree)
            robot = tree.gate.address.split("/")[1]
            rollout = Rollout(robot, tree.driver.axes, "", 0.01, 0.1, 60.0, over=writer.lease.id)
            told: list[TaskStatus] = []
            table = [Axis(key=key, unit="deg", low=-90.0, high=90.0, speed=100.0) for key in tree.driver.axes]
            axes = msgspec.to_builtins(table)
            actor = Teleoperation(rollout, told.append, {"type": "operator"}, axes, "jog", "key")
            cell = tree.node.cell(addresses.of(robot).path("policy"), lambda: actor)
            async with trio.open_nursery() as nursery:
                nursery.start_soon(cell.run)
                await trio.sleep(0.1)
                gate: Any = LosesAnswers(actor._gate, kind, 2)
                actor._gate = gate
                ref = tree.node.ref(cell.address, Teleoperation)
                clock = tree.node.clock
                since_ns = clock.now_ns()
                for turn in range(round(PRESSED_S / 0.02)):
                    ref.tell(Operate(clock.now_ns(), turn > 5, {tree.driver.axes[0]: 1.0}))
                    await trio.sleep(0.02)
                assert gate.left == 0 and told[-1].teleop["state"] == "engaged", told[-1]
                assert setpoints(tree, since_ns)
                ref.tell(Operate(clock.now_ns(), False))
                await trio.sleep(0.3)
                let_go_ns = clock.now_ns()
                await trio.sleep(0.3)
                assert setpoints(tree, let_go_ns) == [] and told[-1].teleop["state"] == "idle"
                nursery.cancel_scope.cancel()

    run_virtual(run)
