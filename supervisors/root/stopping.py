"""Order a stop for a person or another program. The gate stops the robot; if the gate does not reply, the guardian
does."""

from __future__ import annotations

import trio

from strands_actors.kernel.health import busy
from strands_actors.kernel.messages import Message, Refused
from strands_actors.kernel.node import AskTimeout, Ref, Sent, Unreachable
from strands_actors.supervisors.deadlines import StopDeadlines
from strands_actors.supervisors.gate.messages import GetStatus, Stop, StopReport
from strands_actors.supervisors.root.messages import Fence

from . import refusals

SILENT_S = 0.1
"""A gate that does not reply within this time is fenced."""


async def make_safe(
    gate: Ref, guardian: Ref, stop: Stop, deadlines: StopDeadlines, sent: Sent | None = None
) -> StopReport | Refused:
    """Stop the robot and return the result.

    Args:
        gate: The gate.
        guardian: The guardian.
        stop: The order.
        deadlines: The timeouts for gate and guardian.
        sent: The request to the gate, if the order was already sent there.
    """
    answer: Message | None = None
    within_s = deadlines.gate_s
    async with trio.open_nursery() as nursery:
        nursery.start_soon(_cancel_when_silent, gate, nursery.cancel_scope)
        try:
            answer = await (gate.ask(stop, within_s) if sent is None else sent.answer(within_s))
        except (AskTimeout, Unreachable):
            answer = None
        nursery.cancel_scope.cancel()
    if isinstance(answer, StopReport):
        return answer
    try:
        answer = await guardian.ask(Fence(stop.reason, stop.by, stop.lock), deadlines.root_s)
    except (AskTimeout, Unreachable) as failure:
        return busy.with_load(refusals.silent_processes(str(failure)))
    if isinstance(answer, StopReport | Refused):
        return answer
    return refusals.stop_not_reported()


async def _cancel_when_silent(gate: Ref, scope: trio.CancelScope) -> None:
    """Cancel the wait for the gate's reply to the stop if the gate does not answer a simple question either. A
    working gate answers that at once, even while the robot is being stopped."""
    try:
        await gate.ask(GetStatus(), SILENT_S)
    except (AskTimeout, Unreachable):
        scope.cancel()
