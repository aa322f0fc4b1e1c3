"""A teleoperation beside a gate that answers late: the press is not lost. In virtual time."""

from __future__ import annotations

from typing import Any

import pytest
import trio

from strands_actors.kernel.messages import Message
from strands_actors.kernel.node import AskTimeout, Ref
from strands_actors.supervisors.gate.messages import Acquire, GetObservation
from strands_actors.supervisors.root.messages import Operate
from strands_actors.teleoperation.actor import Teleoperation
from strands_actors.testing import run_virtual
from tests.tree.writer import setpoints

from .inline import GateOfPolicy, teleoperation

PRESSED_S = 0.6


class LosesAnswers(GateOfPolicy):
    """Of one kind of message the first ``count`` answers come too late."""

    def __init__(self, gate: Ref, kind: type[Message], count: int) -> None:
        super().__init__(gate)
        self._kind = kind
        self.left = count

    async def ask(self, message: Any, deadline_s: float) -> Message | None:
        answer = await super().ask(message, deadline_s)
        if type(message) is self._kind and self.left:
            self.left -= 1
            await trio.sleep(deadline_s)
            raise AskTimeout("lost")
        return answer


@pytest.mark.parametrize("kind", [Acquire, GetObservation])
def test_saf_009_a_press_whose_answers_come_late_engages_all_the_same(kind: type[Message]) -> None:
    async def run() -> None:
        async with teleoperation(Teleoperation, {"type": "operator"}, "jog") as led:
            gate: Any = LosesAnswers(led.actor._gate, kind, 2)
            led.actor._gate = gate
            tree, clock = led.tree, led.clock
            since_ns = clock.now_ns()
            for turn in range(round(PRESSED_S / 0.02)):
                led.ref.tell(Operate(clock.now_ns(), turn > 5, {tree.driver.axes[0]: 1.0}))
                await trio.sleep(0.02)
            assert gate.left == 0 and led.told[-1].teleop["state"] == "engaged", led.told[-1]
            assert setpoints(tree, since_ns)
            led.ref.tell(Operate(clock.now_ns(), False))
            await trio.sleep(0.3)
            let_go_ns = clock.now_ns()
            await trio.sleep(0.3)
            assert setpoints(tree, let_go_ns) == [] and led.told[-1].teleop["state"] == "idle"

    run_virtual(run)
