"""SAF-023 at the gate: a stop is confirmed only by motors that were read back, or if this tree has
energised nothing. In virtual time.
"""

from __future__ import annotations

import pytest
import trio

from strands_actors.contract.driver import Reason
from strands_actors.supervisors.gate.messages import (
    Accepted,
    GetSafety,
    Release,
    Released,
    Resume,
    Resumed,
    Stop,
    StopReport,
)
from strands_actors.testing import open_inline_tree, run_virtual
from strands_actors.testing.inline import InlineTree
from tests.fake_kinds import FakeBase, Peer

from .test_kinds import tree_of
from .writer import Writer, armed

LATE = (Reason.POLICY, Reason.LEASE, Reason.EXPIRED)


async def rolls_unheard(tree: InlineTree, peer: Peer, writer: Writer, held_before: bool = False) -> None:
    """Drive a base, and then lose its link."""
    if held_before:
        assert isinstance(await writer.send(ttl_s=0.3, vx=0.25), Accepted)
        held = await tree.gate.ask(Stop(Reason.POLICY, "a task"), 1.0)
        assert isinstance(held, StopReport) and held.confirmed
        await writer.acquire()
    assert isinstance(await writer.send(ttl_s=0.3, vx=0.25), Accepted)
    peer.reachable = False
    await tree.until("lost", within_s=2.0)


def assert_not_confirmed(report: object, axes: tuple[str, ...]) -> None:
    assert isinstance(report, StopReport), report
    assert not report.confirmed
    assert tuple(report.unconfirmed) == axes


@pytest.mark.parametrize("held_before", [False, True])
@pytest.mark.parametrize("reason", LATE)
def test_saf_023_a_hold_of_a_rolling_base_whose_link_is_lost_is_not_confirmed(
    reason: Reason, held_before: bool
) -> None:
    async def run() -> None:
        async with tree_of(FakeBase) as (tree, peer, writer):
            await rolls_unheard(tree, peer, writer, held_before)
            assert_not_confirmed(await tree.gate.ask(Stop(reason, "a task"), 5.0), tree.driver.axes)

    run_virtual(run)


@pytest.mark.parametrize("reason", LATE)
def test_saf_023_a_hold_on_a_lost_link_is_still_written_and_not_confirmed(reason: Reason) -> None:
    async def run() -> None:
        async with open_inline_tree() as tree:
            writer = await armed(tree)
            assert isinstance(await writer.send(latched=True, a=5.0), Accepted)
            tree.hardware.answers = False
            await tree.until("lost", within_s=1.0)
            await trio.sleep(0.05)
            tree.hardware.energised = [True, True]
            requested_ns = tree.node.clock.now_ns()
            assert_not_confirmed(await tree.gate.ask(Stop(reason, "a task"), 5.0), tree.driver.axes)
            safe = tree.hardware.of("safe", requested_ns)
            assert safe and safe[0].safe_state == tree.driver.fallbacks[Reason.LINK], (
                "the safe state is at least that of a lost link"
            )
            assert (await tree.status()).cause.startswith("the link was lost")

    run_virtual(run)


@pytest.mark.parametrize("held_before", [False, True])
def test_saf_023_a_release_of_a_rolling_base_whose_link_is_lost_is_not_confirmed(held_before: bool) -> None:
    async def run() -> None:
        async with tree_of(FakeBase) as (tree, peer, writer):
            await rolls_unheard(tree, peer, writer, held_before)
            assert writer.lease is not None
            for _ in range(2):  # the second call has no lease to release
                answer = await tree.gate.ask(Release(writer.lease.id), 5.0)
                assert isinstance(answer, Released)
                assert_not_confirmed(answer.report, tree.driver.axes)

    run_virtual(run)


def test_saf_023_a_release_is_answered_after_the_command_was_replaced_by_a_hold() -> None:
    async def run() -> None:
        async with open_inline_tree() as tree:
            writer = await armed(tree)
            assert isinstance(await writer.send(latched=True, a=5.0), Accepted)
            assert writer.lease is not None
            answer = await tree.gate.ask(Release(writer.lease.id), 1.0)
            assert isinstance(answer, Released) and answer.holds and answer.report.confirmed
            assert {motor.axis for motor in answer.report.motors} == set(tree.driver.axes)
            assert (await tree.status()).mode == "holding"

    run_virtual(run)


def test_saf_023_the_safety_report_is_correct_in_each_mode() -> None:
    async def run() -> None:
        async with tree_of(FakeBase) as (tree, peer, writer):

            async def safety() -> StopReport:
                answer = await tree.gate.ask(GetSafety(), 1.0)
                assert isinstance(answer, StopReport)
                return answer

            assert (await safety()).confirmed, "the robot is armed and no command is live"
            assert isinstance(await writer.send(ttl_s=0.3, vx=0.25), Accepted)
            await tree.gate.ask(Stop(Reason.POLICY), 1.0)
            assert (await safety()).confirmed and (await safety()).motors, "the robot holds"
            before = len(peer.of("safe"))
            await writer.acquire()
            assert isinstance(await writer.send(ttl_s=0.3, vx=0.25), Accepted)
            peer.reachable = False
            await tree.until("lost", within_s=2.0)
            assert not (await safety()).confirmed, "the report of the earlier hold is not valid any more"
            assert len(peer.of("safe")) <= before + 2, "a request for the report writes nothing"
            peer.reachable = True
            await tree.until("disarmed", within_s=5.0)
            assert (await safety()).confirmed
            assert isinstance(await tree.gate.ask(Resume(), 5.0), Resumed)

    run_virtual(run)
