"""A stream that does not wait for every answer: what is refused in between ends it all the same."""

from __future__ import annotations

import trio

from strands_actors.runtime.messages import Refused
from strands_actors.supervisors.messages import Accepted
from strands_actors.testing import open_inline_tree, run_virtual

from .writer import armed


def test_saf_014_after_a_refusal_nobody_waited_for_no_setpoint_passes() -> None:
    async def run() -> None:
        async with open_inline_tree() as tree:
            writer = await armed(tree)
            for value in (1.0, 2.0, 1e9, 3.0):  # the third is out of range
                writer.ref.tell(writer.setpoint(a=value))
                await trio.sleep(0.002)
            assert [entry.values[0] for entry in tree.hardware.of("setpoint")] == [1.0, 2.0]
            answer = await writer.send(a=4.0)
            assert isinstance(answer, Refused) and answer.code == "range" and "1000000000" in answer.reason
            assert (await tree.status()).refusals == 3
            await writer.acquire()  # who asks for the lease anew begins anew
            assert isinstance(await writer.send(a=4.0), Accepted)

    run_virtual(run)


def test_who_waits_for_the_answer_may_go_on() -> None:
    async def run() -> None:
        async with open_inline_tree() as tree:
            writer = await armed(tree)
            answer = await writer.send(a=1e9)
            assert isinstance(answer, Refused) and answer.code == "range"
            assert isinstance(await writer.send(a=1.0), Accepted)

    run_virtual(run)
