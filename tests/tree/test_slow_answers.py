"""A rollout whose gate answers slowly, as on another host. Its setpoints must keep their rate."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
import trio
import trio.testing

from strands_actors.contract.wire import Observation
from strands_actors.kernel.actor import Actor, Deferred
from strands_actors.kernel.clock import VirtualClock
from strands_actors.kernel.mailbox import SUPERSEDED
from strands_actors.kernel.messages import Message, Refused
from strands_actors.kernel.node import Node
from strands_actors.supervisors import addresses
from strands_actors.supervisors.gate.messages import Accepted, Acquire, GetObservation, Lease, Release, Setpoint
from strands_actors.supervisors.policy import Policy
from strands_actors.supervisors.root.messages import Rollout, TaskStatus

PERIOD_S = 1 / 30


class Gate(Actor):
    """Answer setpoints after ``after_s``. ``answer`` gives the answer for the number of the setpoint."""

    def __init__(self, after_s: float, answer: Callable[[int], Message | None]) -> None:
        self._after_s = after_s
        self._answer = answer
        self.at_s: list[float] = []
        self.asks = 0

    def receive(
        self, message: Acquire | GetObservation | Setpoint | Release
    ) -> Lease | Observation | Accepted | Refused | Deferred | None:
        match message:
            case Acquire():
                return Lease(7, 1)
            case GetObservation():
                return Observation(0, (0.0,), (0,))
            case Setpoint():
                self.at_s.append(trio.current_time())
                if self.context.expects_answer:
                    self.asks += 1
                    deferred = self.context.defer()
                    self.context.start_soon(self._later, deferred, self._answer(len(self.at_s)))
                    return deferred
        return None

    async def _later(self, deferred: Deferred, answer: Message | None) -> None:
        await trio.sleep(self._after_s)
        deferred.send(answer)


def roll_out(gate: Gate, ask_s: float = 2.0) -> TaskStatus:
    ended: list[TaskStatus] = []

    async def run() -> None:
        node, over = Node("test", VirtualClock()), trio.Event()

        def report(status: TaskStatus) -> None:
            if not status.running:
                ended.append(status)
                over.set()

        def chunk(observation: Any) -> list[dict[str, float]]:
            return [{"a": 1.0}] * 30

        rollout = Rollout("slow", ("a",), "", PERIOD_S, 0.5, 3.0)
        path = addresses.of("slow").path
        async with trio.open_nursery() as nursery:
            await nursery.start(node.run)
            nursery.start_soon(node.cell(path("gate"), lambda: gate).run)
            await trio.testing.wait_all_tasks_blocked()
            policy = node.cell(path("policy"), lambda: Policy(rollout, lambda: chunk, report, None, ask_s))
            nursery.start_soon(policy.run)
            await over.wait()
            nursery.cancel_scope.cancel()

    trio.run(run, clock=trio.testing.MockClock(autojump_threshold=0.005))
    return ended[0]


@pytest.mark.parametrize("after_s", [0.0, 0.01, 0.2, 0.6])
def test_the_stream_keeps_its_rate_with_slow_answers(after_s: float) -> None:
    gate = Gate(after_s, lambda _: Accepted(1, ()))
    status = roll_out(gate)
    assert status.exit_reason == "duration", status
    gaps = [after - before for before, after in zip(gate.at_s, gate.at_s[1:], strict=False)]
    assert len(gate.at_s) > 0.9 * 3.0 / PERIOD_S
    assert max(gaps) < 2 * PERIOD_S
    assert 1 <= gate.asks <= len(gate.at_s)
    assert gate.asks == len(gate.at_s) or gate.asks < 3.5 / after_s, "one ask at a time"


def test_a_late_refusal_ends_the_rollout() -> None:
    gate = Gate(0.2, lambda number: Refused("limit", "too far") if number > 10 else Accepted(1, ()))
    status = roll_out(gate)
    assert (status.exit_reason, status.refusal) == ("gate", "limit")
    assert 11 <= len(gate.at_s) < 25


def test_a_superseded_setpoint_is_not_a_refusal() -> None:
    """After a pause of the network several setpoints arrive at once."""
    gate = Gate(0.2, lambda number: SUPERSEDED if number % 2 else Accepted(1, ()))
    assert roll_out(gate).exit_reason == "duration"


def test_an_answer_that_never_comes_ends_the_rollout() -> None:
    gate = Gate(60.0, lambda _: None)
    status = roll_out(gate, ask_s=1.0)
    assert status.exit_reason == "publish", status
    assert status.elapsed_s < 1.5
