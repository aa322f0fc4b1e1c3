"""The root tries again to make safe what it could not confirm (SAF-005, SAF-018): before the next wire
starts, afterwards, and when the tree ends. In virtual time; the energised motors decide.
"""

from __future__ import annotations

import trio

from strands_actors.contract.driver import Reason
from strands_actors.contract.wire import MotorReport
from strands_actors.kernel.health.processor import ProcessorUse
from strands_actors.supervisors.gate.failsafe import ENDING_REASONS, Mode
from strands_actors.supervisors.gate.messages import Stop, StopReport
from strands_actors.supervisors.root.guardian import START_DEADLINE_S
from strands_actors.supervisors.root.messages import Fence, StateIs
from strands_actors.supervisors.root.process import Tree
from strands_actors.supervisors.root.stop_channel import LINGER_S, REPEAT_S
from strands_actors.testing import InlineTree, open_inline_tree, run_virtual

from .writer import armed, freeze, setpoints

LIMP = [False, False]


async def kill(tree: InlineTree) -> None:
    tree.wire._scope.cancel()
    await trio.sleep(0.05)


async def end(tree: InlineTree, confirmed: bool = False) -> None:
    """End the tree as the root does after its caller has ended."""
    tree.keeper.leave()
    await tree.keeper.end(Reason.CALLER, "the caller ended", confirmed)


def test_saf_005_a_motor_that_answers_late_is_released_before_the_next_wire() -> None:
    async def run() -> None:
        async with open_inline_tree() as tree:
            await armed(tree)
            tree.hardware.silent.add("b")
            await kill(tree)
            assert tree.hardware.energised == [False, True]
            report = tree.keeper.last_report
            assert report is not None and report.unconfirmed == ["b"]
            tree.hardware.silent.clear()
            await trio.sleep(REPEAT_S / 2)
            assert tree.hardware.energised == LIMP
            assert {entry.path for entry in tree.hardware.of("safe")} == {"stop_channel"}
            assert (await tree.until("disarmed")).cause

    run_virtual(run)


def test_saf_005_a_motor_that_stays_silent_does_not_prevent_the_next_wire() -> None:
    """The next wire can report which motor it is, and continues to try."""

    async def run() -> None:
        async with open_inline_tree() as tree:
            await armed(tree)
            tree.hardware.silent.add("b")
            await kill(tree)
            await trio.sleep(REPEAT_S + 1.0)
            assert len(tree.wires_made) == 2
            await tree.until("unconfirmed")
            tree.hardware.silent.clear()
            await tree.until("disarmed", within_s=1.0)
            assert tree.hardware.energised == LIMP

    run_virtual(run)


def test_saf_020_a_wire_that_dies_before_it_has_connected_again_is_followed_by_safe_frames() -> None:
    """The stop channel that the earlier wire had handed over is closed, so the root opens a new one."""

    async def run() -> None:
        async with open_inline_tree() as tree:
            await armed(tree)
            tree.hardware.plugged = False
            await kill(tree)
            await trio.sleep(REPEAT_S + 1.0)
            assert len(tree.wires_made) == 2
            back_ns = tree.node.clock.now_ns()
            tree.hardware.plugged = True
            await kill(tree)
            first = tree.hardware.of("safe", back_ns)[0]
            assert first.path == "stop_channel"
            assert tree.hardware.energised == LIMP

    run_virtual(run)


def test_saf_018_a_tree_that_ends_waits_for_a_motor_that_is_not_confirmed() -> None:
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


def test_a_tree_ends_at_once_if_its_silent_robot_was_safe_before() -> None:
    async def run() -> None:
        async with open_inline_tree() as tree:
            await armed(tree)
            await tree.gate.ask(Stop(Reason.STOP), 1.0)
            tree.hardware.plugged = False
            await end(tree)
            await trio.sleep(0.1)
            assert tree.keeper.idle.is_set()

    run_virtual(run)


def test_saf_018_a_false_confirmation_of_a_stop_is_not_trusted() -> None:
    """The root gets a report that every motor is safe, but it is false. The wire makes the robot safe
    again when it ends.
    """

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
            tree.wire.close_link = lambda: None  # type: ignore[method-assign]  # the wire hangs
            await end(tree, confirmed=True)
            assert tree.hardware.energised == LIMP
            assert tree.hardware.of("safe")[-1].path == "stop_channel"

    run_virtual(run)


def test_saf_018_a_wire_that_dies_while_it_should_end_is_made_safe_by_the_root() -> None:
    """Its stop was reported as confirmed, but its exit code does not confirm it."""

    async def run() -> None:
        async with open_inline_tree() as tree:
            await armed(tree)
            tree.wire.close_link = tree.wire._scope.cancel  # type: ignore[method-assign]
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
            await trio.sleep(REPEAT_S / 2)
            assert tree.hardware.energised == LIMP
            assert tree.node.cells[tree.guardian.address].incarnations == 1

    run_virtual(run)


def test_saf_003_the_root_writes_although_the_fenced_process_has_not_ended_yet() -> None:
    """The wire hangs in a system call: it was killed but has not ended."""

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
            assert len(tree.wires_made) == 1, "two wires must not use one port"
            await trio.sleep(5.0)
            assert len(tree.wires_made) == 2

    run_virtual(run)


def test_saf_003_a_wire_that_froze_after_handing_over_its_port_is_fenced_before_the_start_deadline() -> None:
    """The wire froze before its first heartbeat."""

    async def run() -> None:
        async with open_inline_tree() as tree:
            await armed(tree)
            tree.keeper._failure_detector.last_received_ns = 0
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


def test_saf_003_a_wire_that_is_stopped_while_it_starts_is_fenced_before_the_start_deadline() -> None:
    async def run() -> None:
        async with open_inline_tree() as tree:
            await armed(tree)
            tree.keeper._failure_detector.last_received_ns = 0
            tree.keeper._heartbeat.forget()
            place = tree.wire
            freeze(tree, "watchdog")
            place.processor_use = lambda: ProcessorUse(0, 0, False, True)  # type: ignore[method-assign,assignment,return-value]
            await trio.sleep(0.2)
            assert not place.alive
            assert tree.hardware.energised == LIMP

    run_virtual(run)


def test_a_state_that_arrives_after_the_end_of_its_wire_is_ignored() -> None:
    """The state was on its way when the wire was killed."""

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


def test_saf_003_a_failing_task_of_the_root_ends_the_tree_in_order() -> None:
    """The robot is made safe first, because the exception does not leave the root's task."""

    async def run() -> None:
        root = Tree.__new__(Tree)
        root._shutdown, root._waiting, root.failed = trio.Event(), [], ""
        await root._contain("the mesh", _fails)
        assert root._shutdown.is_set()
        reason, why = root._end
        assert reason in ENDING_REASONS and "the mesh failed" in why and "a fault was asked for" in root.failed

    trio.run(run)
