"""A robot that stays energised in every safe state, like a gripper that keeps its grip. After a stop it
must not move.
"""

from __future__ import annotations

import pytest
import trio

from strands_actors.contract.driver import Reason
from strands_actors.kernel.messages import Refused
from strands_actors.supervisors.gate.messages import Accepted, Lease, Resume, Resumed, Stop, StopReport
from strands_actors.testing import InlineTree, open_inline_tree, run_virtual
from strands_actors.testing.fake import FakeDriver

from .writer import Writer, armed

# Repeated here on purpose: a test that used the product's own sets would accept any change of them.
LATE = {Reason.EXPIRED, Reason.LEASE, Reason.POLICY}
ENDS = {Reason.CALLER, Reason.CLEANUP, Reason.ROOT}


@pytest.fixture(autouse=True)
def holds_for_every_reason(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(FakeDriver, "fallbacks", dict.fromkeys(Reason, "hold"))


async def moving(tree: InlineTree) -> Writer:
    writer = await armed(tree)
    assert isinstance(await writer.send(latched=True, a=5.0), Accepted)
    await trio.sleep(0.05)
    return writer


@pytest.mark.parametrize("reason", sorted(set(Reason) - LATE - ENDS))
def test_saf_008_after_a_stop_the_robot_moves_only_after_a_resume(reason: Reason) -> None:
    async def run() -> None:
        async with open_inline_tree() as tree:
            writer = await moving(tree)
            stopped_ns = tree.node.clock.now_ns()
            report = await tree.gate.ask(Stop(reason), 1.0)
            assert isinstance(report, StopReport) and report.confirmed and report.safe_state == "hold"
            assert (await tree.status()).mode == "disarmed"
            assert tree.hardware.energised == [True, True]
            assert isinstance(await writer.acquire(), Lease)
            refused = await writer.send(latched=True, a=6.0)
            code = "faulted" if reason is Reason.FAULT else "disarmed"
            assert isinstance(refused, Refused) and refused.code == code
            await trio.sleep(0.5)
            assert tree.hardware.of("setpoint", stopped_ns + 1) == []
            assert isinstance(await tree.gate.ask(Resume(), 1.0), Resumed)
            await writer.acquire()
            assert isinstance(await writer.send(latched=True, a=6.0), Accepted)

    run_virtual(run)


@pytest.mark.parametrize("reason", sorted(ENDS))
def test_saf_018_after_the_end_of_its_tree_the_robot_is_not_moved(reason: Reason) -> None:
    """It keeps its grip. A late resume changes nothing."""

    async def run() -> None:
        async with open_inline_tree() as tree:
            writer = await moving(tree)
            stopped_ns = tree.node.clock.now_ns()
            report = await tree.gate.ask(Stop(reason), 1.0)
            assert isinstance(report, StopReport) and report.confirmed and report.safe_state == "hold"
            refused = await tree.gate.ask(Resume("an operator"), 1.0)
            assert isinstance(refused, Refused) and refused.code == "ending", refused
            assert isinstance(await writer.acquire(), Lease)
            refused = await writer.send(latched=True, a=6.0)
            assert isinstance(refused, Refused) and refused.code == "ending", refused
            assert tree.hardware.of("setpoint", stopped_ns + 1) == tree.hardware.of("enable", stopped_ns) == []
            again = await tree.gate.ask(Stop(Reason.ROOT), 1.0)
            assert isinstance(again, StopReport) and again.confirmed, "the stop is already carried out"
            assert len(tree.hardware.of("safe", stopped_ns)) == 1

    run_virtual(run)


def test_saf_007_an_e_stop_locks_the_robot() -> None:
    async def run() -> None:
        async with open_inline_tree() as tree:
            writer = await moving(tree)
            await tree.gate.ask(Stop(Reason.ESTOP, "op", lock=True), 1.0)
            refused = await writer.send(latched=True, a=6.0)
            assert isinstance(refused, Refused) and refused.code == "locked_out"
            assert (await tree.status()).locked_by == "op"

    run_virtual(run)


@pytest.mark.parametrize("reason", sorted(LATE))
def test_after_a_lost_writer_the_next_one_may_command(reason: Reason) -> None:
    async def run() -> None:
        async with open_inline_tree() as tree:
            writer = await moving(tree)
            await tree.gate.ask(Stop(reason), 1.0)
            assert (await tree.status()).mode == "holding"
            await writer.acquire()
            assert isinstance(await writer.send(latched=True, a=6.0), Accepted)

    run_virtual(run)


def test_saf_008_after_a_crash_of_the_wire_the_robot_is_held_and_disarmed() -> None:
    async def run() -> None:
        async with open_inline_tree() as tree:
            await moving(tree)
            crashed_ns = tree.node.clock.now_ns()
            tree.wire._scope.cancel()
            await tree.until("disarmed")
            safe = tree.hardware.of("safe", crashed_ns)
            assert (safe[0].path, safe[0].safe_state) == ("stop_channel", "hold")
            assert tree.hardware.of("setpoint", safe[0].t_ns) == []

    run_virtual(run)
