"""Stops that arrive while a tree is between two of its states (SAF-007, SAF-009, SAF-017, SAF-018). In
virtual time.
"""

from __future__ import annotations

import pytest
import trio

from strands_actors.contract.driver import Reason
from strands_actors.kernel.messages import Refused
from strands_actors.supervisors.gate.failsafe import Mode
from strands_actors.supervisors.gate.messages import Resume, Resumed, Stop, StopReport
from strands_actors.supervisors.root.messages import Fence, StateIs
from strands_actors.testing import InlineTree, open_inline_tree, run_virtual

from .writer import armed, freeze

LIMP = [False, False]


async def kill(tree: InlineTree) -> None:
    tree.wire._scope.cancel()
    await trio.sleep(0.05)


def test_saf_007_a_resume_from_before_a_stop_does_not_lift_it() -> None:
    """The resume waited for the link, and an operator pressed the e-stop meanwhile."""

    async def run() -> None:
        async with open_inline_tree() as tree:
            await armed(tree)
            requested_ns = tree.node.clock.now_ns()
            await trio.sleep(0.01)
            assert isinstance(await tree.gate.ask(Stop(Reason.ESTOP, "operator", lock=True), 1.0), StopReport)
            answer = await tree.gate.ask(Resume("script", lift=True, requested_ns=requested_ns), 1.0)
            assert isinstance(answer, Refused) and answer.code == "stopped"
            status = await tree.status()
            assert status.locked_by == "operator" and status.mode == Mode.DISARMED
            assert tree.hardware.energised == LIMP
            now_ns = tree.node.clock.now_ns()
            assert isinstance(await tree.gate.ask(Resume("script", requested_ns=now_ns), 1.0), Resumed)

    run_virtual(run)


def test_saf_017_a_visitor_can_stop_the_robot_but_cannot_end_the_tree() -> None:
    """For each reason in its message. The router adds the channel to the message."""

    async def run() -> None:
        async with open_inline_tree() as tree:
            await armed(tree)
            for reason in Reason:
                for lock in (False, True):
                    await tree.gate.ask(Stop(reason, "visitor", lock, "a visitor"), 1.0)
                    status = await tree.status()
                    assert status.mode == Mode.DISARMED, (reason, status.mode)
                    assert status.last_stop is not None
                    expected = reason if reason in (Reason.STOP, Reason.ESTOP) else None
                    assert status.last_stop.reason is expected or (
                        expected is None and status.last_stop.reason is (Reason.ESTOP if lock else Reason.STOP)
                    )
                    assert isinstance(await tree.gate.ask(Resume("test"), 1.0), Resumed)

    run_virtual(run)


def test_saf_018_a_lock_outlives_a_late_message_of_the_fenced_wire() -> None:
    async def run() -> None:
        async with open_inline_tree() as tree:
            await armed(tree)
            freeze(tree, "gate")
            fence = tree.wire.fence

            async def slowly() -> bool:
                # A message that the wire had sent before reaches the guardian now.
                tree.guardian.tell(StateIs(Mode.HOLDING, tree.keeper.state.epoch, "", "the setpoint expired"))
                await trio.sleep(0.05)
                return await fence()

            tree.wire.fence = slowly  # type: ignore[method-assign]
            report = await tree.guardian.ask(Fence(Reason.ESTOP, "operator", lock=True), 3.0)
            assert isinstance(report, StopReport) and report.confirmed
            assert tree.keeper.state.locked_by == "operator"
            assert (await tree.until("disarmed")).locked_by == "operator"

    run_virtual(run)


def test_a_stop_after_the_safe_frames_of_a_dead_wire_is_answered_at_once() -> None:
    """The root waits for a standby that is slow to release its channel."""

    class Slow:
        async def guard(self, descriptors: tuple[int, ...]) -> None:
            return None

        async def release_channel(self) -> None:
            await trio.sleep(0.5)

    async def run() -> None:
        async with open_inline_tree() as tree:
            await armed(tree)
            tree.keeper.channels.standby = Slow()  # type: ignore[assignment]
            await kill(tree)
            assert not tree.keeper.idle.is_set() and tree.hardware.energised == LIMP
            with trio.fail_after(0.05):
                report = await tree.guardian.ask(Fence(Reason.STOP, "test"), 3.0)
            assert isinstance(report, StopReport) and report.confirmed and report.path == "stop_channel"

    run_virtual(run)


def test_saf_018_a_tree_whose_next_wire_cannot_be_started_is_made_safe_and_ends() -> None:
    """No file descriptors are left, and then the caller ends."""

    async def run() -> None:
        async with open_inline_tree() as tree:
            await armed(tree)
            tree.hardware.plugged = False

            def nothing_left(*_: object) -> None:
                tree.keeper.leave()  # the caller has ended meanwhile
                raise OSError(24, "Too many open files")

            tree.keeper._start_wire = nothing_left  # type: ignore[assignment]
            await kill(tree)
            await trio.sleep(2.5)
            assert tree.keeper.idle.is_set() and not tree.keeper.confirmed
            tree.hardware.plugged = True
            with trio.fail_after(5.0):
                await tree.keeper.end(Reason.CALLER, "the caller ended", False)
                await tree.keeper.idle.wait()
            assert tree.keeper.confirmed and tree.hardware.energised == LIMP

    run_virtual(run)


def test_saf_003_a_fence_that_fails_does_not_keep_the_root_from_making_safe() -> None:
    async def run() -> None:
        async with open_inline_tree() as tree:
            await armed(tree)
            fence, failed = tree.wire.fence, 0

            async def fails() -> bool:
                nonlocal failed
                failed += 1
                if failed < 3:
                    raise OSError(24, "Too many open files")
                return await fence()

            tree.wire.fence = fails  # type: ignore[method-assign]
            await kill(tree)
            await trio.sleep(0.5)
            assert tree.hardware.energised == LIMP and failed == 3
            await tree.until("disarmed")

    run_virtual(run)


def test_stops_while_a_wire_starts_cost_no_restart() -> None:
    async def run() -> None:
        async with open_inline_tree() as tree:
            await armed(tree)
            await kill(tree)
            await tree.until("disarmed")
            count = len(tree.wires_made)
            tree.keeper._failure_detector.last_received_ns = 0  # as before the first heartbeat
            freeze(tree, "watchdog")
            tree.keeper._heartbeat.forget()
            for _ in range(8):
                tree.keeper._failure_detector.last_received_ns = 0
                report = await tree.guardian.ask(Fence(Reason.STOP, "test"), 3.0)
                assert isinstance(report, StopReport) and report.confirmed
            assert len(tree.wires_made) == count

    run_virtual(run)


@pytest.mark.parametrize("locks", [True, False])
@pytest.mark.parametrize("after_s", [0.001, 0.005, 0.009])
def test_saf_007_a_resume_from_before_a_stop_during_the_start_of_a_wire_does_not_lift_it(
    after_s: float, locks: bool
) -> None:
    """The root itself answers such a stop, because the new wire has energised nothing. The resume waited
    for the link.
    """

    async def run() -> None:
        async with open_inline_tree() as tree:
            await armed(tree)
            if locks:  # the next wire begins locked
                tree.guardian.tell(Fence(Reason.ESTOP, "A", lock=True))
            else:
                tree.wire._scope.cancel()
            while len(tree.wires_made) < 2:  # noqa: ASYNC110  # until the second wire starts
                await trio.sleep(0.0002)
            requested_ns = tree.node.clock.now_ns()
            await trio.sleep(after_s)
            reason = Reason.ESTOP if locks else Reason.STOP
            report = await tree.guardian.ask(Fence(reason, "B", lock=locks), 3.0)
            assert isinstance(report, StopReport) and report.confirmed and len(tree.wires_made) == 2
            status = await tree.until("disarmed")
            answer = await tree.gate.ask(Resume("operator", lift=True, requested_ns=requested_ns), 1.0)
            assert isinstance(answer, Refused) and answer.code == "stopped"
            assert tree.hardware.energised == LIMP
            assert bool(status.locked_by) == locks
            now_ns = tree.node.clock.now_ns()
            assert isinstance(await tree.gate.ask(Resume("operator", lift=True, requested_ns=now_ns), 1.0), Resumed)

    run_virtual(run)
