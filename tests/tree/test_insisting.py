"""What the root could not confirm safe is tried again (SAF-005, SAF-018): before the next wire,
after it, and when the tree ends. In virtual time, judged by what is energised."""

from __future__ import annotations

import trio

from strands_actors.contract.driver import Reason
from strands_actors.contract.wire import MotorReport
from strands_actors.kernel.health.processor import Standing
from strands_actors.supervisors.gate.failsafe import ENDING_REASONS, Mode
from strands_actors.supervisors.gate.messages import Stop, StopReport
from strands_actors.supervisors.root.guardian import START_DEADLINE_S
from strands_actors.supervisors.root.messages import Fence, StateIs
from strands_actors.supervisors.root.process import Tree
from strands_actors.supervisors.root.stop_channel import INSIST_S, LINGER_S
from strands_actors.testing import InlineTree, open_inline_tree, run_virtual

from .writer import armed, freeze, setpoints

LIMP = [False, False]


async def kill(tree: InlineTree) -> None:
    tree.wire._scope.cancel()
    await trio.sleep(0.05)


async def end(tree: InlineTree, confirmed: bool = False) -> None:
    """As the root does it when its caller is gone."""
    tree.keeper.leave()
    await tree.keeper.end(Reason.CALLER, "the caller ended", confirmed)


def test_saf_005_a_motor_that_is_heard_late_is_released_before_the_next_wire() -> None:
    async def run() -> None:
        async with open_inline_tree() as tree:
            await armed(tree)
            tree.hardware.silent.add("b")
            await kill(tree)
            assert tree.hardware.energised == [False, True]
            report = tree.keeper.last_report
            assert report is not None and report.unconfirmed == ["b"]
            tree.hardware.silent.clear()
            await trio.sleep(INSIST_S / 2)
            assert tree.hardware.energised == LIMP
            assert {entry.path for entry in tree.hardware.of("safe")} == {"stop_channel"}
            assert (await tree.until("disarmed")).cause

    run_virtual(run)


def test_saf_005_a_motor_that_stays_silent_does_not_keep_the_next_wire_away() -> None:
    """That one can say which motor it is, and goes on with it."""

    async def run() -> None:
        async with open_inline_tree() as tree:
            await armed(tree)
            tree.hardware.silent.add("b")
            await kill(tree)
            await trio.sleep(INSIST_S + 1.0)
            assert len(tree.wires_made) == 2
            await tree.until("unconfirmed")
            tree.hardware.silent.clear()
            await tree.until("disarmed", within_s=1.0)
            assert tree.hardware.energised == LIMP

    run_virtual(run)


def test_saf_020_a_wire_that_dies_before_it_found_the_robot_again_is_no_end_of_it() -> None:
    """The path that the wire before had handed over is closed: it is made anew."""

    async def run() -> None:
        async with open_inline_tree() as tree:
            await armed(tree)
            tree.hardware.plugged = False
            await kill(tree)
            await trio.sleep(INSIST_S + 1.0)
            assert len(tree.wires_made) == 2
            back_ns = tree.node.clock.now_ns()
            tree.hardware.plugged = True
            await kill(tree)
            first = tree.hardware.of("safe", back_ns)[0]
            assert first.path == "stop_channel"
            assert tree.hardware.energised == LIMP

    run_virtual(run)


def test_saf_018_a_tree_that_ends_stays_for_a_motor_that_is_not_confirmed() -> None:
    async def run() -> None:
        async with open_inline_tree() as tree:
            await armed(tree)
            tree.hardware.silent.add("b")
            with trio.fail_after(1.0):
                await end(tree)
            report = tree.keeper.last_report
            assert report is not None and report.unconfirmed == ["b"] and report.reason is Reason.CALLER
            await trio.sleep(LINGER_S / 2)
            assert not tree.keeper.idle.is_set()
            tree.hardware.silent.clear()
            await trio.sleep(2.5)
            assert tree.keeper.idle.is_set() and tree.keeper.confirmed
            assert tree.hardware.energised == LIMP
            assert len(tree.wires_made) == 1, "no other wire"

    run_virtual(run)


def test_saf_018_a_tree_ends_although_the_robot_never_confirms() -> None:
    async def run() -> None:
        async with open_inline_tree() as tree:
            await armed(tree)
            tree.hardware.plugged = False
            await end(tree)
            await trio.sleep(LINGER_S + 5.0)
            assert tree.keeper.idle.is_set() and not tree.keeper.confirmed

    run_virtual(run)


def test_a_robot_that_was_safe_when_it_fell_silent_keeps_nobody() -> None:
    async def run() -> None:
        async with open_inline_tree() as tree:
            await armed(tree)
            await tree.gate.ask(Stop(Reason.STOP), 1.0)
            tree.hardware.plugged = False
            await end(tree)
            await trio.sleep(0.1)
            assert tree.keeper.idle.is_set()

    run_virtual(run)


def test_saf_018_a_confirmed_stop_that_was_none_is_not_believed() -> None:
    """The root was told that every motor is safe, and that was a lie: the wire ends, and makes safe
    what is not."""

    async def run() -> None:
        async with open_inline_tree() as tree:
            await armed(tree)
            await end(tree, confirmed=True)
            assert tree.hardware.energised == LIMP
            assert tree.keeper.confirmed

    run_virtual(run)


def test_saf_018_a_wire_that_does_not_end_by_itself_is_made_safe_by_the_root() -> None:
    async def run() -> None:
        async with open_inline_tree() as tree:
            await armed(tree)
            tree.wire.let_go = lambda: None  # type: ignore[method-assign]  # it hangs
            await end(tree, confirmed=True)
            assert tree.hardware.energised == LIMP
            assert tree.hardware.of("safe")[-1].path == "stop_channel"

    run_virtual(run)


def test_saf_018_a_wire_that_dies_as_it_is_to_end_is_made_safe_by_the_root() -> None:
    """Its stop was reported as confirmed; its exit code does not say so."""

    async def run() -> None:
        async with open_inline_tree() as tree:
            await armed(tree)
            tree.wire.let_go = tree.wire._scope.cancel  # type: ignore[method-assign]
            await end(tree, confirmed=True)
            assert tree.hardware.energised == LIMP
            assert [entry.path for entry in tree.hardware.of("safe")] == ["stop_channel"]

    run_virtual(run)


def test_saf_005_a_stop_channel_that_fails_is_tried_again() -> None:
    async def run() -> None:
        async with open_inline_tree() as tree:
            await armed(tree)
            second = tree.keeper.channels.own
            assert second is not None
            make_safe = second.make_safe

            async def fails(safe_state: str) -> tuple[MotorReport, ...]:
                second.make_safe = make_safe  # type: ignore[method-assign]
                raise RuntimeError("a fault was asked for")

            second.make_safe = fails  # type: ignore[method-assign]
            await kill(tree)
            report = tree.keeper.last_report
            assert report is not None and "a fault was asked for" in report.motors[0].detail
            await trio.sleep(INSIST_S / 2)
            assert tree.hardware.energised == LIMP
            assert tree.node.cells[tree.guardian.address].incarnations == 1

    run_virtual(run)


def test_saf_003_a_fence_that_sees_no_end_is_no_reason_not_to_write() -> None:
    """The wire hangs in a system call: it was killed and is not gone."""

    async def run() -> None:
        async with open_inline_tree() as tree:
            await armed(tree)
            place, began_s = tree.wire, trio.current_time()
            fence = place.fence

            async def slow() -> bool:
                if trio.current_time() < began_s + 5.0:
                    await trio.sleep(1.0)
                    return False
                return await fence()

            place.fence = slow  # type: ignore[method-assign]
            report = await tree.guardian.ask(Fence(Reason.STOP, "test"), 3.0)
            assert isinstance(report, StopReport) and report.confirmed and report.path == "stop_channel"
            assert tree.hardware.energised == LIMP
            await trio.sleep(1.0)
            assert len(tree.wires_made) == 1, "no two processes at one port"
            await trio.sleep(5.0)
            assert len(tree.wires_made) == 2

    run_virtual(run)


def test_saf_003_a_wire_that_has_handed_over_its_port_waits_for_no_deadline() -> None:
    """It froze before its first heartbeat."""

    async def run() -> None:
        async with open_inline_tree() as tree:
            await armed(tree)
            tree.keeper._failure_detector.heard_ns = 0
            tree.keeper._heartbeat.forget()
            place = tree.wire
            transport = tree.node.cells[tree.gate.address.replace("gate", "transport")].actor
            freeze(tree, "watchdog")
            await transport._hand_over(transport._wire)  # type: ignore[attr-defined]
            await trio.sleep(0.5)
            assert START_DEADLINE_S > 0.5
            assert not place.alive
            assert tree.hardware.energised == LIMP
            assert setpoints(tree) == []

    run_virtual(run)


def test_saf_003_a_wire_that_is_stopped_before_it_has_begun_waits_for_no_deadline() -> None:
    async def run() -> None:
        async with open_inline_tree() as tree:
            await armed(tree)
            tree.keeper._failure_detector.heard_ns = 0
            tree.keeper._heartbeat.forget()
            place = tree.wire
            freeze(tree, "watchdog")
            place.standing = lambda: Standing(0, 0, False, True)  # type: ignore[method-assign,assignment,return-value]
            await trio.sleep(0.2)
            assert not place.alive
            assert tree.hardware.energised == LIMP

    run_virtual(run)


def test_what_a_wire_said_is_not_believed_after_its_end() -> None:
    """A state that was on its way when it was killed."""

    async def run() -> None:
        async with open_inline_tree() as tree:
            await armed(tree)
            tree.hardware.silent.add("b")
            await kill(tree)
            epoch = tree.keeper.state.epoch
            tree.guardian.tell(StateIs(Mode.DISARMED, epoch + 7, "", ""))
            await trio.sleep(0.1)
            assert tree.keeper.state.epoch < epoch + 7
            assert not tree.keeper.confirmed

    run_virtual(run)


async def _fails() -> None:
    raise RuntimeError("a fault was asked for")


def test_saf_003_a_part_of_the_root_that_fails_ends_the_tree_in_order() -> None:
    """The robot is made safe first: nothing leaves the root by an exception."""

    async def run() -> None:
        root = Tree.__new__(Tree)
        root._shutdown, root._waiting, root.failed = trio.Event(), [], ""
        await root._contain("the mesh", _fails)
        assert root._shutdown.is_set()
        reason, why = root._end
        assert reason in ENDING_REASONS and "the mesh failed" in why and "a fault was asked for" in root.failed

    trio.run(run)
