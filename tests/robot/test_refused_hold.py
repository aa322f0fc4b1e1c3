"""SAF-010: a stop that the gate refuses counts as a stop without an answer."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest
import trio

from strands_actors.caller.session.rollouts import Rollouts
from strands_actors.kernel.messages import Message, Refused
from strands_actors.kernel.node import AskTimeout
from strands_actors.supervisors.root.messages import TaskStatus


class Asked:
    """A reference whose ``ask`` returns a given answer, or raises it."""

    def __init__(self, answer: Message | Exception) -> None:
        self._answer = answer

    async def ask(self, message: Message, within_s: float) -> Message:
        if isinstance(self._answer, Exception):
            raise self._answer
        return self._answer

    def tell(self, message: Message) -> None:
        pass


@pytest.mark.parametrize("answer", [Refused("overloaded", "the gate is full"), AskTimeout("no answer")])
def test_saf_010_a_policy_that_neither_ends_nor_can_be_held_costs_the_wire(answer: Message | Exception) -> None:
    fenced: list[Any] = []

    async def make_safe(*order: Any) -> None:
        fenced.append(order)

    processes: Any = SimpleNamespace(
        patience=SimpleNamespace(ask_s=0.5, stop_s=2.0),
        gate=Asked(answer),
        tasks=Asked(AskTimeout("no answer")),
        holder="a script",
        require=lambda: None,
        make_safe=make_safe,
        robot="so101",
        node=SimpleNamespace(ref=lambda *_: None),
    )
    rollouts = Rollouts(processes, None, None)  # type: ignore[arg-type]
    rollouts._task = TaskStatus(running=True)
    rollouts._has_process = True
    assert trio.run(rollouts.stop_task).status.exit_reason == "stopped"
    assert len(fenced) == 1
