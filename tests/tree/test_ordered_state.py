"""The safe state that is applied after a stop has requested a more severe one than a later fault leads to
(SAF-007, SAF-020), and the positions from which a robot continues after a hold (SAF-011). In virtual
time.
"""

from __future__ import annotations

import json
import os
from pathlib import Path

import msgspec
import pytest
import trio

from strands_actors.contract.driver import Reason
from strands_actors.contract.wire import MotorReport
from strands_actors.kernel.clock import Clock, MonotonicClock
from strands_actors.supervisors.gate.messages import Accepted, LockKept, Resume, Resumed, Stop, StopReport
from strands_actors.supervisors.page import SafetyPage
from strands_actors.supervisors.root.messages import Fence
from strands_actors.supervisors.root.process import Unconfirmed
from strands_actors.supervisors.wire.messages import RootGone
from strands_actors.testing import FakeHardware, InlineTree, open_inline_tree, run_virtual
from strands_actors.testing.fake import FakeWire
from tests.answers import until

from .writer import armed, driver_of, freeze, setpoints

ESTOP = Stop(Reason.ESTOP, "test", lock=True)


def since(tree: InlineTree, t_ns: int) -> set[str]:
    return {entry.safe_state for entry in tree.hardware.of("safe", t_ns)}


async def request_stop(tree: InlineTree, stop: Stop = ESTOP) -> StopReport:
    report = await tree.gate.ask(stop, 3.0)
    assert isinstance(report, StopReport), report
    return report


@pytest.mark.parametrize("is_armed", [True, False])
def test_saf_007_an_e_stop_that_did_not_reach_the_robot_is_carried_out_when_the_link_is_back(
    is_armed: bool,
) -> None:
    """The loss of a link alone leads to a milder safe state."""

    async def run() -> None:
        hardware = FakeHardware()
        async with open_inline_tree(hardware, driver=driver_of(hardware, "estop")) as tree:
            if is_armed:
                await armed(tree)
            hardware.plugged = False
            await tree.until("lost" if is_armed else "down", within_s=0.2)
            report = await request_stop(tree)
            assert not report.confirmed and report.safe_state == "off"
            await trio.sleep(5.0)
            plugged_ns = tree.node.clock.now_ns()
            hardware.plugged = True
            await trio.sleep(3.0)
            assert since(tree, plugged_ns) == {"off"}
            status = await tree.until("disarmed")
            assert status.locked_by == "test"
            assert status.last_stop is not None and status.last_stop.confirmed
            assert status.last_stop.safe_state == "off"

    run_virtual(run)


def test_saf_007_a_stop_after_an_unconfirmed_e_stop_is_no_milder() -> None:
    async def run() -> None:
        hardware = FakeHardware()
        async with open_inline_tree(hardware, driver=driver_of(hardware, "milder")) as tree:
            await armed(tree)
            hardware.silent.add("b")
            assert (await request_stop(tree)).unconfirmed == ["b"]
            hardware.silent.clear()
            report = await request_stop(tree, Stop(Reason.STOP))
            assert report.confirmed and report.safe_state == "off"
            # A confirmed e-stop is over: after a resume a stop leads to its usual safe state again.
            assert isinstance(await tree.gate.ask(Resume("test", lift=True), 1.0), Resumed)
            assert (await request_stop(tree, Stop(Reason.STOP))).safe_state == "stop"

    run_virtual(run)


@pytest.mark.parametrize("unreported", [(), ("b",)], ids=["read", "never read"])
def test_saf_005_an_unconfirmed_stop_is_ordered_again_when_the_robot_answers(unreported: tuple[str, ...]) -> None:
    """Some robots never report the position of some motors."""

    async def run() -> None:
        hardware = FakeHardware(unreported=set(unreported))
        async with open_inline_tree(hardware) as tree:
            await armed(tree)
            hardware.silent.add("b")
            assert (await request_stop(tree)).unconfirmed == ["b"]
            hardware.silent.clear()
            await tree.until("disarmed", within_s=1.0)

    run_virtual(run)


def test_saf_007_an_e_stop_on_a_frozen_wire_is_carried_out_by_the_root() -> None:
    async def run() -> None:
        hardware = FakeHardware()
        async with open_inline_tree(hardware, driver=driver_of(hardware, "frozen")) as tree:
            await armed(tree)
            frozen_ns = tree.node.clock.now_ns()
            freeze(tree, "gate")
            freeze(tree, "transport")
            report = await tree.guardian.ask(Fence(Reason.ESTOP, "test", lock=True), 3.0)
            assert isinstance(report, StopReport) and report.confirmed
            assert (report.safe_state, report.path) == ("off", "stop_channel")
            assert since(tree, frozen_ns) == {"off"}

    run_virtual(run)


def test_saf_007_an_e_stop_during_the_roots_own_milder_attempt_is_carried_out_after_it() -> None:
    async def run() -> None:
        hardware = FakeHardware()
        async with open_inline_tree(hardware, driver=driver_of(hardware, "meanwhile")) as tree:
            await armed(tree)
            tree.wire._scope.cancel()
            with trio.fail_after(1.0):
                while not hardware.of("safe"):  # noqa: ASYNC110  # the hardware sends no event
                    await trio.sleep(0.0005)
            assert not tree.keeper.idle.is_set()
            report = await tree.guardian.ask(Fence(Reason.ESTOP, "test", lock=True), 3.0)
            assert isinstance(report, StopReport) and report.confirmed and report.safe_state == "off"
            assert [entry.safe_state for entry in hardware.of("safe")] == ["stop", "off"]

    run_virtual(run)


def test_saf_007_an_e_stop_after_the_last_wire_has_ended_is_carried_out_by_the_root() -> None:
    async def run() -> None:
        hardware = FakeHardware()
        async with open_inline_tree(hardware, driver=driver_of(hardware, "over")) as tree:
            await armed(tree)
            tree.keeper.leave()
            tree.wire._scope.cancel()
            await trio.sleep(1.0)
            assert tree.keeper.idle.is_set() and tree.keeper.confirmed
            report = await tree.guardian.ask(Fence(Reason.ESTOP, "test", lock=True), 3.0)
            assert isinstance(report, StopReport) and report.confirmed and report.safe_state == "off"
            assert hardware.of("safe")[-1].safe_state == "off" and tree.keeper.confirmed
            # A stop that is already carried out is not carried out again.
            count = len(hardware.of("safe"))
            report = await tree.guardian.ask(Fence(Reason.STOP, "test"), 3.0)
            assert isinstance(report, StopReport) and report.confirmed
            assert len(hardware.of("safe")) == count

    run_virtual(run)


def test_saf_007_a_wire_without_a_root_carries_out_the_e_stop_that_did_not_reach_the_robot() -> None:
    async def run() -> None:
        hardware = FakeHardware()
        async with open_inline_tree(hardware, driver=driver_of(hardware, "orphan")) as tree:
            await armed(tree)
            hardware.plugged = False
            await tree.until("lost", within_s=0.2)
            assert not (await request_stop(tree)).confirmed
            tree.keeper.leave()
            tree.node.ref(tree.gate.address.replace("gate", "watchdog")).tell(RootGone())
            await trio.sleep(1.0)
            plugged_ns = tree.node.clock.now_ns()
            hardware.plugged = True
            await trio.sleep(5.0)
            assert since(tree, plugged_ns) == {"off"}

    run_virtual(run)


def test_the_requested_safe_state_is_on_the_shared_page_until_it_is_confirmed() -> None:
    """The standby reads it from that page, because it cannot ask another process."""
    safety_page = SafetyPage()
    assert safety_page.order("stop") == "stop"
    assert safety_page.order("off") == "off"
    assert safety_page.order("stop") == "off"
    safety_page.confirm("stop")
    assert safety_page.order("hold") == "off"
    safety_page.confirm("off")
    assert safety_page.order("stop") == "stop"
    safety_page.begin_anew()
    assert safety_page.order("hold") == "hold"


def test_saf_011_after_a_hold_the_next_command_moves_only_the_axes_that_it_names() -> None:
    """The robot still moves while the hold is carried out, and its wire does not report the targets of
    the hold.
    """

    class Coasting(FakeHardware):
        def make_safe(self, clock: Clock, safe_state: str, path: str) -> tuple[MotorReport, ...]:
            reports = super().make_safe(clock, safe_state, path)
            self.position[0] += 0.5
            return tuple(msgspec.structs.replace(report, target=None) for report in reports)

    async def run() -> None:
        hardware = Coasting()
        async with open_inline_tree(hardware) as tree:
            writer = await armed(tree)
            assert isinstance(await writer.send(a=5.0), Accepted)
            await tree.until("holding")
            held_ns = tree.node.clock.now_ns()
            await writer.acquire()
            assert isinstance(await writer.send(b=1.0), Accepted)
            await trio.sleep(0.005)
            assert setpoints(tree, held_ns) == [(5.5, 1.0)]

    run_virtual(run)


def test_saf_007_an_e_stop_while_a_wire_begins_is_carried_out_by_the_root() -> None:
    """The new wire has energised nothing and has no stop channel yet. The safe state that the previous
    wire left is milder than the e-stop's.
    """

    async def run() -> None:
        hardware = FakeHardware()
        async with open_inline_tree(hardware, driver=driver_of(hardware, "begins")) as tree:
            await armed(tree)
            hardware.open_s = 1.0
            tree.wire._scope.cancel()
            await trio.sleep(0.2)
            assert len(tree.wires_made) == 2 and tree.keeper.channels.own is None
            report = await tree.guardian.ask(Fence(Reason.ESTOP, "test", lock=True), 3.0)
            assert isinstance(report, StopReport) and report.confirmed and report.motors
            assert hardware.of("safe")[-1].safe_state == "off"
            assert report.safe_state == "off" and (await tree.until("disarmed")).locked_by == "test"

    run_virtual(run)


def test_saf_007_an_e_stop_between_two_wires_does_not_wait_for_the_next_wire() -> None:
    async def run() -> None:
        hardware = FakeHardware()
        async with open_inline_tree(hardware, driver=driver_of(hardware, "between")) as tree:
            await armed(tree)
            start = tree.keeper._start_wire
            pressed = []

            def press(*args: object) -> object:
                if not pressed:
                    pressed.append(tree.guardian.ask(Fence(Reason.ESTOP, "test", lock=True), 3.0))
                    raise OSError(11, "try again")
                return start(*args)  # type: ignore[arg-type]

            tree.keeper._start_wire = press  # type: ignore[assignment]
            tree.wire._scope.cancel()
            while not pressed:  # noqa: ASYNC110
                await trio.sleep(0.001)
            report = await pressed[0]
            assert isinstance(report, StopReport) and report.confirmed
            assert (report.safe_state, report.path) == ("off", "stop_channel") and report.motors
            assert hardware.of("safe")[-1].safe_state == "off"

    run_virtual(run)


def test_saf_007_an_e_stop_does_not_wait_for_a_landing_of_the_root() -> None:
    async def run() -> None:
        hardware = FakeHardware()
        driver = driver_of(hardware, "lands")
        async with open_inline_tree(hardware, driver=driver) as tree:
            await armed(tree)
            channel = tree.keeper.channels.own
            assert channel is not None
            make_safe = channel.make_safe

            async def lands(safe_state: str) -> tuple[MotorReport, ...]:
                reports = await make_safe(safe_state)
                if safe_state != "off":
                    await trio.sleep(5.0)
                return reports

            channel.make_safe = lands  # type: ignore[method-assign]
            driver.timing = msgspec.structs.replace(driver.timing, safe_s=6.0)
            tree.wire._scope.cancel()
            await trio.sleep(0.5)
            pressed_s = trio.current_time()
            report = await tree.guardian.ask(Fence(Reason.ESTOP, "test", lock=True), 3.0)
            assert isinstance(report, StopReport) and report.confirmed and report.safe_state == "off"
            assert trio.current_time() - pressed_s < 0.1

    run_virtual(run)


def test_saf_007_an_e_stop_cuts_a_landing_on_a_lost_link(monkeypatch: pytest.MonkeyPatch) -> None:
    async def reach(self: FakeWire, safe_state: str) -> tuple[MotorReport, ...]:
        reports = await self.make_safe(safe_state)
        if safe_state == "land":
            await trio.sleep(5.0)
        return reports

    async def run() -> None:
        hardware = FakeHardware()
        driver = driver_of(hardware, "drone")
        driver.fallbacks = {**driver.fallbacks, Reason.STOP: "land"}
        driver.timing = msgspec.structs.replace(driver.timing, safe_s=6.0)
        async with open_inline_tree(hardware, driver=driver) as tree:
            await armed(tree)
            monkeypatch.setattr(FakeWire, "reach", reach)
            hardware.answers = False
            await tree.until("lost", within_s=0.2)
            async with trio.open_nursery() as nursery:
                nursery.start_soon(request_stop, tree, Stop(Reason.STOP))
                await trio.sleep(0.5)
                pressed_ns = tree.node.clock.now_ns()
                await request_stop(tree)
                first = next(safe for safe in hardware.of("safe", pressed_ns))
                assert first.safe_state == "off" and first.t_ns - pressed_ns < 50_000_000

    run_virtual(run)


def test_saf_005_each_stop_is_answered_with_the_first_report_that_covers_it() -> None:
    """Not with the report of a milder stop that came while the lock of an e-stop was being written."""

    async def run() -> None:
        hardware = FakeHardware()
        async with open_inline_tree(hardware, driver=driver_of(hardware, "first")) as tree:
            await armed(tree)
            tree.keeper._keep_lock = lambda: None  # type: ignore[method-assign]  # the disk hangs
            reports: list[StopReport] = []

            async def press() -> None:
                reports.append(await request_stop(tree))

            async with trio.open_nursery() as nursery:
                nursery.start_soon(press)
                await trio.sleep(0.1)
                assert (await request_stop(tree, Stop(Reason.STOP))).safe_state == "stop" and not reports
                tree.gate.tell(LockKept(tree.keeper.state.epoch, "now"))
            assert reports[0].safe_state == "off"

    run_virtual(run)


def test_saf_007_an_e_stop_that_did_not_reach_the_robot_outlives_the_wire_that_received_it() -> None:
    """The wire never opened the port, and then it ends. The root has reached no motor either."""

    async def run() -> None:
        hardware = FakeHardware()
        async with open_inline_tree(hardware, driver=driver_of(hardware, "never")) as tree:
            hardware.plugged = False
            await tree.until("down", within_s=0.2)
            assert not (await request_stop(tree)).confirmed
            tree.wire._scope.cancel()
            await trio.sleep(0.5)
            assert tree.keeper.last_report is not None and not tree.keeper.last_report.confirmed
            plugged_ns = tree.node.clock.now_ns()
            hardware.plugged = True
            await trio.sleep(5.0)
            assert since(tree, plugged_ns) == {"off"}

    run_virtual(run)


def test_saf_005_no_attempt_waits_for_the_file_that_lists_unconfirmed_motors(tmp_path: Path) -> None:
    note = tmp_path / "so101.json"
    os.mkfifo(note)  # opening it blocks, like a file on a disk that hangs

    async def run() -> None:
        async with open_inline_tree(clock=MonotonicClock()) as tree:
            await armed(tree)
            tree.keeper._on_report = Unconfirmed(str(note)).tell
            tree.hardware.silent.add("b")
            tree.wire._scope.cancel()
            with trio.fail_after(20):
                while len(tree.hardware.of("safe")) < 3:  # noqa: ASYNC110  # the hardware sends no event
                    await trio.sleep(0.01)

    trio.run(run)
    note.write_text('{"robot": "so101"}')  # the disk answers
    until(note.is_file, "the file is there")
    assert json.loads(note.read_text()) == {"robot": "so101", "unconfirmed": ["b"]}


@pytest.mark.parametrize("locks", [True, False])
def test_saf_007_an_e_stop_while_a_wire_starts_is_forgotten_after_its_resume(locks: bool) -> None:
    """A person presses the e-stop twice. It is carried out and lifted by a resume, and must not decide
    the safe state of a much later fault.
    """

    async def run() -> None:
        hardware = FakeHardware()
        async with open_inline_tree(hardware, driver=driver_of(hardware, "twice")) as tree:
            await armed(tree)
            tree.guardian.tell(Fence(Reason.ESTOP, "A", lock=True))
            while len(tree.wires_made) < 2:  # noqa: ASYNC110  # until the second wire starts
                await trio.sleep(0.0005)
            second = await tree.guardian.ask(Fence(Reason.ESTOP, "B", lock=locks), 3.0)
            assert isinstance(second, StopReport) and second.confirmed and second.safe_state == "off"
            assert len(tree.wires_made) == 2
            await tree.until("disarmed")
            assert isinstance(await tree.gate.ask(Resume("operator", lift=True), 1.0), Resumed)
            died_ns = tree.node.clock.now_ns()
            tree.wire._scope.cancel()
            await trio.sleep(1.0)
            assert since(tree, died_ns) == {"stop"}

    run_virtual(run)
