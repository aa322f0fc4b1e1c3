"""The messages of wire and root about a missed deadline say so if this computer is too busy. In virtual
time.
"""

from __future__ import annotations

import pytest
import trio

from strands_actors.caller.handle import envelopes
from strands_actors.contract.driver import Reason
from strands_actors.kernel.health.busy import Machine, assumed
from strands_actors.kernel.messages import Refused
from strands_actors.supervisors.gate.messages import Accepted, Resume
from strands_actors.testing import open_inline_tree, run_virtual
from strands_actors.testing.fake import FakeWire

from .writer import armed, freeze

BUSY = "(this computer is busy: load 20 on 2 cores)"
STARVED = Machine(20.0, 2)


def test_the_message_of_a_lost_link_names_the_busy_computer() -> None:
    async def run() -> None:
        async with open_inline_tree() as tree:
            writer = await armed(tree)
            assert isinstance(await writer.send(latched=True, a=1.0), Accepted)
            with assumed(STARVED):
                tree.hardware.answers = False
                status = await tree.until("lost", within_s=1.0)
                assert status.connect_error == f"an axis does not answer {BUSY}"
                assert BUSY in status.cause

    run_virtual(run)


def test_the_message_of_a_slow_arming_names_the_busy_computer(monkeypatch: pytest.MonkeyPatch) -> None:
    async def never(wire: FakeWire, permit: object) -> None:
        await trio.sleep_forever()

    async def run() -> None:
        async with open_inline_tree() as tree:
            with assumed(STARVED):
                answer = await tree.gate.ask(Resume(), 5.0)
            assert isinstance(answer, Refused) and f"arming took longer than 2 s {BUSY}" in answer.text

    monkeypatch.setattr(FakeWire, "arm", never)
    run_virtual(run)


def test_the_message_of_a_silent_wire_names_the_busy_computer() -> None:
    async def run() -> None:
        async with open_inline_tree() as tree:
            await armed(tree)
            with assumed(STARVED):
                freeze(tree, "watchdog")
                await trio.sleep(0.5)
            assert len(tree.wires_made) > 1
            assert tree.keeper.last_report is not None
            assert BUSY in tree.keeper._break_cause[1]

    run_virtual(run)


@pytest.mark.parametrize(
    ("refusal", "named"),
    [
        (Refused("expired", "the command is 3.0 ms past its deadline", verb="move"), True),
        (Refused("stale_epoch", "prepared in epoch 2, now it is 3", because=Reason.EXPIRED), True),
        (Refused("stale_epoch", "prepared in epoch 2, now it is 3", because=Reason.STOP), False),
        (Refused("no_answer", "the wire has not answered for 500 ms", "try again", verb="state"), True),
        (Refused("range", "a is 200", "stay within 100"), False),
    ],
)
def test_only_refusals_for_a_missed_deadline_name_the_busy_computer(refusal: Refused, named: bool) -> None:
    with assumed(STARVED):
        assert (BUSY in envelopes.refused(refusal)["content"][0]["text"]) is named
