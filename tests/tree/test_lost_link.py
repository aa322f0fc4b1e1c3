"""A link is lost while the robot is energised. The safe frame is sent first, without waiting (SAF-020).
In virtual time.
"""

from __future__ import annotations

import pytest
import trio

from strands_actors.contract.driver import Reason
from strands_actors.contract.wire import Wire, WireDown
from strands_actors.kernel.messages import Refused
from strands_actors.supervisors.gate.messages import Accepted, Resume, Resumed, Stop, StopReport
from strands_actors.supervisors.wire.messages import RootGone
from strands_actors.testing import FakeHardware, InlineTree, open_inline_tree, run_virtual
from strands_actors.testing.fake import FakeStopChannel, FakeWire

from .writer import armed

MS = 1_000_000


def first_kinds(hardware: FakeHardware, since_ns: int) -> list[str]:
    return [entry.kind for entry in hardware.written if entry.t_ns >= since_ns]


async def lost(tree: InlineTree) -> int:
    """Arm and move the robot, then let it stop answering. Return the time of the loss."""
    writer = await armed(tree)
    assert isinstance(await writer.send(latched=True, a=5.0), Accepted)
    await trio.sleep(0.05)
    tree.hardware.answers = False
    lost_ns = tree.node.clock.now_ns()
    await tree.until("lost", within_s=0.1)
    return lost_ns


def test_saf_020_a_robot_that_stops_answering_is_made_safe_at_once() -> None:
    async def run() -> None:
        async with open_inline_tree() as tree:
            lost_ns = await lost(tree)
            await trio.sleep(0.05)
            safe = tree.hardware.of("safe", lost_ns)
            assert safe and safe[0].safe_state == "limp"
            assert safe[0].t_ns - lost_ns < 2.5e9 / tree.driver.timing.control_hz
            kinds = [kind for kind in first_kinds(tree.hardware, lost_ns) if kind != "setpoint"]
            assert kinds[0] == "safe", "the safe frame is sent before any request"
            assert tree.hardware.energised == [False, False]
            status = await tree.status()
            assert status.mode == "lost", "the safe frame is written but not confirmed"
            assert status.last_stop is not None and not status.last_stop.confirmed
            assert all(motor.written for motor in status.last_stop.motors)

    run_virtual(run)


def test_saf_020_each_attempt_to_open_a_lost_link_begins_with_the_safe_frame() -> None:
    async def run() -> None:
        async with open_inline_tree() as tree:
            lost_ns = await lost(tree)
            await trio.sleep(5.0)
            kinds = [kind for kind in first_kinds(tree.hardware, lost_ns) if kind != "setpoint"]
            assert kinds.count("read") > 3
            assert kinds == ["safe", "read"] * kinds.count("read")
            tree.hardware.answers = True
            await tree.until("disarmed", within_s=5.0)
            assert isinstance(await tree.gate.ask(Resume(), 1.0), Resumed)

    run_virtual(run)


@pytest.mark.parametrize("reason", [Reason.STOP, Reason.ESTOP, Reason.CALLER, Reason.CLEANUP])
def test_saf_020_a_stop_is_written_during_a_handshake(reason: Reason) -> None:
    async def run() -> None:
        async with open_inline_tree() as tree:
            await lost(tree)
            tree.hardware.open_s = 3.0
            await trio.sleep(2.0)
            tree.hardware.energised = [True, True]
            stopped_ns = tree.node.clock.now_ns()
            report = await tree.gate.ask(Stop(reason), 1.0)
            assert isinstance(report, StopReport) and not report.confirmed
            assert [motor.written for motor in report.motors] == [True, True]
            assert tree.hardware.of("safe", stopped_ns)[0].t_ns - stopped_ns <= 20 * MS
            assert tree.hardware.energised == [False, False]
            assert len(tree.wires_made) == 1

    run_virtual(run)


def test_saf_020_the_first_frame_on_a_restored_link_is_the_safe_one_even_without_answers() -> None:
    async def run() -> None:
        async with open_inline_tree() as tree:
            await armed(tree)
            tree.hardware.plugged = False
            await trio.sleep(1.5)
            tree.hardware.answers = False
            tree.hardware.plugged = True
            plugged_ns = tree.node.clock.now_ns()
            await trio.sleep(2.5)
            assert first_kinds(tree.hardware, plugged_ns)[:2] == ["safe", "read"]
            assert tree.hardware.energised == [False, False]

    run_virtual(run)


def test_saf_020_a_wire_that_starts_on_a_lost_link_begins_with_the_safe_frame() -> None:
    async def run() -> None:
        async with open_inline_tree() as tree:
            await armed(tree)
            tree.hardware.plugged = False
            tree.wire._scope.cancel()
            await trio.sleep(2.6)  # the guardian tries for two seconds first
            assert len(tree.wires_made) > 1
            tree.hardware.plugged = True
            plugged_ns = tree.node.clock.now_ns()
            await tree.until("disarmed", within_s=5.0)
            assert first_kinds(tree.hardware, plugged_ns)[:2] == ["safe", "read"]

    run_virtual(run)


def test_saf_020_a_wire_without_a_root_makes_a_lost_robot_safe() -> None:
    async def run() -> None:
        async with open_inline_tree() as tree:
            await lost(tree)
            tree.hardware.open_s = 3.0
            await trio.sleep(2.0)
            tree.hardware.energised = [True, True]
            gone_ns = tree.node.clock.now_ns()
            tree.node.ref(tree.gate.address.replace("gate", "watchdog")).tell(RootGone())
            with trio.fail_after(1.0):
                await tree.wire.ended()
            safe = tree.hardware.of("safe", gone_ns)
            assert safe[0].path == "wire" and safe[0].t_ns - gone_ns <= 20 * MS
            assert tree.hardware.energised == [False, False]

    run_virtual(run)


def test_saf_020_a_stop_before_the_loss_is_detected_is_tried_on_a_new_connection() -> None:
    """The cable was out and is back before the next reading, so the open connection is dead."""

    async def run() -> None:
        async with open_inline_tree() as tree:
            await armed(tree)
            transport = tree.node.cells[tree.gate.address.replace("gate", "transport")].actor
            wire = transport._wire  # type: ignore[attr-defined]

            async def nothing(safe_state: str) -> object:
                return ()

            wire.make_safe = nothing
            stopped_ns = tree.node.clock.now_ns()
            wire.reach = lambda safe_state: type(wire).make_safe(wire, safe_state)
            report = await tree.gate.ask(Stop(Reason.STOP), 1.0)
            assert isinstance(report, StopReport) and report.confirmed
            assert tree.hardware.of("safe", stopped_ns)[0].t_ns - stopped_ns <= 20 * MS
            await tree.until("disarmed", within_s=5.0)

    run_virtual(run)


def test_a_confirmed_stop_is_followed_by_a_read_and_not_by_a_safe_frame() -> None:
    """This tree has energised nothing, and another program may hold the robot meanwhile."""

    async def run() -> None:
        async with open_inline_tree() as tree:
            await armed(tree)
            await tree.gate.ask(Stop(Reason.STOP), 1.0)
            tree.hardware.plugged = False
            await tree.until("down", within_s=0.2)
            tree.hardware.plugged = True
            plugged_ns = tree.node.clock.now_ns()
            await tree.until("disarmed", within_s=5.0)
            assert first_kinds(tree.hardware, plugged_ns) == ["read"]

    run_virtual(run)


@pytest.mark.parametrize(
    ("reason", "written"), [(Reason.STOP, True), (Reason.ESTOP, True), (Reason.CLEANUP, False)]
)
def test_saf_020_a_robot_that_was_never_connected_gets_a_stop_but_not_that_of_a_cleanup(
    reason: Reason, written: bool
) -> None:
    """A stop can release motors that an earlier program left energised. A script that only ends must not
    release them.
    """

    async def run() -> None:
        async with open_inline_tree() as tree:
            await tree.gate.ask(Stop(Reason.STOP), 1.0)
            tree.hardware.answers = False
            await tree.until("down", within_s=0.2)
            await trio.sleep(1.0)
            tree.hardware.energised = [True, True]
            stopped_ns = tree.node.clock.now_ns()
            report = await tree.gate.ask(Stop(reason), 1.0)
            assert isinstance(report, StopReport) and not report.confirmed
            assert bool(tree.hardware.of("safe", stopped_ns)) == written
            assert tree.hardware.energised == [not written] * 2

    run_virtual(run)


def test_saf_006_a_stop_does_not_wait_for_a_hold_to_be_confirmed() -> None:
    async def run() -> None:
        async with open_inline_tree() as tree:
            await armed(tree)
            tree.hardware.confirm_s = 1.0
            async with trio.open_nursery() as nursery:
                nursery.start_soon(tree.gate.ask, Stop(Reason.POLICY), 3.0)
                await trio.sleep(0.1)
                stopped_ns = tree.node.clock.now_ns()
                report = await tree.gate.ask(Stop(Reason.STOP), 3.0)
            assert isinstance(report, StopReport) and report.confirmed and report.safe_state == "limp"
            limp = [entry for entry in tree.hardware.of("safe", stopped_ns) if entry.safe_state == "limp"]
            assert limp[0].t_ns - stopped_ns <= 20 * MS
            assert tree.hardware.energised == [False, False]
            assert (await tree.status()).mode == "disarmed"

    run_virtual(run)


def test_saf_019_the_next_command_does_not_move_an_axis_without_a_reading() -> None:
    """An axis that does not answer keeps its last target, even if another axis is commanded after the hold."""

    async def run() -> None:
        async with open_inline_tree() as tree:
            writer = await armed(tree)
            assert isinstance(await writer.send(latched=True, a=5.0, b=5.0), Accepted)
            await trio.sleep(0.05)
            tree.hardware.silent.add("b")
            tree.hardware.position[1] = -30.0  # the last reading, which is not the current position
            await trio.sleep(0.05)
            await tree.gate.ask(Stop(Reason.LEASE), 1.0)
            assert (await tree.status()).target == (5.0, 5.0)
            await writer.acquire()
            answer = await writer.send(a=6.0)
            assert not isinstance(answer, Refused)
            await trio.sleep(0.01)
            assert tree.hardware.of("setpoint")[-1].values == (6.0, 5.0)

    run_virtual(run)


def test_saf_020_a_wire_without_reach_is_stopped_over_its_stop_channel(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(FakeWire, "reach", Wire.reach)

    async def run() -> None:
        async with open_inline_tree() as tree:
            lost_ns = await lost(tree)
            await trio.sleep(0.05)
            assert {(entry.path, entry.safe_state) for entry in tree.hardware.of("safe", lost_ns)} == {
                ("stop_channel", "limp")
            }
            assert tree.hardware.energised == [False, False]
            tree.hardware.energised = [True, True]
            report = await tree.gate.ask(Stop(Reason.STOP), 1.0)
            assert isinstance(report, StopReport) and all(motor.written for motor in report.motors)
            assert tree.hardware.energised == [False, False]

    run_virtual(run)


def test_saf_020_a_stop_channel_that_does_not_find_the_robot_breaks_nothing(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    async def nobody(self: object, task_status: object = None) -> None:
        raise WireDown("the robot is not found")

    monkeypatch.setattr(FakeWire, "reach", Wire.reach)

    async def run() -> None:
        async with open_inline_tree() as tree:
            await lost(tree)
            monkeypatch.setattr(FakeStopChannel, "serve", nobody, raising=False)
            report = await tree.gate.ask(Stop(Reason.STOP), 1.0)
            assert isinstance(report, StopReport) and not report.confirmed
            assert len(tree.wires_made) == 1

    run_virtual(run)
