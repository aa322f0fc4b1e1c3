"""SAF-021: a request to arm, or to perform a service, that was sent before a stop may take effect after
it. A stop is confirmed, and a process ends, only when this is no longer possible. In virtual time; the
last entries of the fake robot's log decide.
"""

from __future__ import annotations

import os
from collections.abc import Awaitable, Callable, Mapping
from pathlib import Path
from typing import Any, ClassVar

import msgspec
import pytest
import trio

from strands_actors.contract.driver import Reason, Service, Timing
from strands_actors.contract.wire import Observation, Permit, ProcessSpent, Wire
from strands_actors.kernel.clock import Clock, VirtualClock
from strands_actors.kernel.health.heartbeat import new_page, words_of
from strands_actors.kernel.messages import Message, Refused
from strands_actors.kernel.node import Node
from strands_actors.supervisors import addresses
from strands_actors.supervisors.deadlines import StopDeadlines
from strands_actors.supervisors.gate.messages import Perform, Resume, Resumed, Stop, StopReport
from strands_actors.supervisors.page import SafetyPage
from strands_actors.supervisors.root.stop_channel import UNSETTLED
from strands_actors.supervisors.standby.messages import WatchOver
from strands_actors.supervisors.standby.process import Standby
from strands_actors.supervisors.wire.late_requests import LateRequests
from strands_actors.supervisors.wire.messages import RootGone
from strands_actors.supervisors.wire.transport import Transport
from strands_actors.testing import FakeHardware, InlineTree, open_inline_tree, run_virtual
from strands_actors.testing.fake import AXES, HARDWARE, FakeDriver, FakeWire

from .writer import Writer, armed

LATE_S = 0.2
MOMENTS = [n * LATE_S / 6 for n in range(1, 7)]
"""Moments at which an arming is interrupted, in seconds."""
LIMP, ON = [False, False], [True, True]


class LateHardware(FakeHardware):
    """A robot that accepts a request at once and carries it out ``late_s`` later, even if the sender has
    ended. A safe frame does not cancel earlier requests.
    """

    late_s = LATE_S

    async def carry_out(self, clock: Clock) -> None:
        done = trio.Event()
        trio.lowlevel.spawn_system_task(self._later, clock, done)
        await done.wait()

    async def _later(self, clock: Clock, done: trio.Event) -> None:
        await trio.sleep(self.late_s)
        for index in range(len(AXES)):
            self.energised[index] = True
            self.record(clock, "enable", "robot")
        done.set()


class LateWire(FakeWire):
    """A wire that waits, when it arms and performs a service, until the robot has carried out the request."""

    hangs = False
    """Whether arming hangs in a call of an SDK that cannot be cancelled."""
    energises = True
    """Whether arming energises the robot. If not, a service does, as a Spot's ``stand``."""

    def _late(self) -> LateHardware:
        assert isinstance(self._hardware, LateHardware)
        return self._hardware

    async def arm(self, permit: Permit) -> Observation:
        permit.check()
        if self.hangs:
            trio.lowlevel.spawn_system_task(self._late().carry_out, self._clock)
            raise ProcessSpent("the SDK did not return")
        if self.energises:
            await self._late().carry_out(self._clock)
        return self._observe()

    async def perform(self, service: str, arguments: Mapping[str, Any], permit: Permit) -> dict[str, Any] | Refused:
        permit.check()
        with trio.move_on_after(LATE_S / 2 if arguments.get("gives_up") else LATE_S * 2):
            await self._late().carry_out(self._clock)
            return {}
        return Refused("timeout", "no answer", "try again")


class LateDriver(FakeDriver):
    timing = Timing(control_hz=50.0, keepalive_s=0.02, late_s=LATE_S)
    SERVICES: ClassVar[Mapping[str, Service]] = {
        "power": Service(
            "power the motors on", within_s=5.0, arguments={"gives_up": False}, powers=True, late_s=LATE_S
        )
    }

    def open_wire(self, clock: Clock) -> Wire:
        return LateWire(self.hardware, clock)


def robot(port: str) -> tuple[LateHardware, LateDriver]:
    hardware = LateHardware()
    HARDWARE[port] = hardware
    driver = LateDriver("fake", port, {})
    del HARDWARE[port]
    return hardware, driver


@pytest.fixture
def runs_when_stopped(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let a stopped robot run the service, as it may run a service that only takes power away."""
    released = msgspec.structs.replace(LateDriver.SERVICES["power"], releases=True)
    monkeypatch.setattr(LateDriver, "SERVICES", {"power": released})


def transport_of(tree: InlineTree) -> Transport:
    actor = tree.node.cells[tree.gate.address.replace("gate", "transport")].actor
    assert isinstance(actor, Transport)
    return actor


def kill(tree: InlineTree) -> None:
    """Kill the wire process: it writes nothing more to the shared page."""
    transport_of(tree)._late_requests._note = lambda: None  # type: ignore[method-assign]
    tree.wire._scope.cancel()


def stays_safe(hardware: FakeHardware) -> None:
    """Check that the request has taken effect, and that the last frame of all is a safe frame."""
    assert hardware.of("enable"), "the robot was energised late"
    story = [entry.kind for entry in hardware.written if entry.kind in ("safe", "enable")]
    assert story[-1] == "safe" and hardware.energised == LIMP, story


Begin = Callable[[InlineTree], Awaitable[Any]]


async def arm(tree: InlineTree) -> Message | None:
    return await tree.gate.ask(Resume("test"), 10.0)


async def power(tree: InlineTree, **arguments: Any) -> Message | None:
    """Ask for the service that powers the motors of an armed robot. Its arming takes no time."""
    return await powered_by(await armed(tree), **arguments)


async def power_as_is(tree: InlineTree) -> Message | None:
    """Ask for the service that switches the motors' power, without arming the robot first."""
    writer = Writer(tree)
    await writer.acquire()
    return await powered_by(writer)


async def powered_by(writer: Writer, **arguments: Any) -> Message | None:
    return await writer.ref.ask(Perform(writer.lease.id, writer.lease.epoch, "power", arguments), 5.0)


@pytest.fixture(params=["resume", "power"])
def begin(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Begin:
    """Ask for an arming, or for a service that powers the motors."""
    monkeypatch.setattr(LateWire, "energises", request.param == "resume")

    async def ask(tree: InlineTree) -> Any:
        return await (arm(tree) if request.param == "resume" else power(tree))

    return ask


@pytest.mark.parametrize("reason", [Reason.STOP, Reason.ESTOP, Reason.CLEANUP, Reason.CALLER])
def test_saf_021_a_stop_during_an_arming_is_confirmed_when_nothing_can_take_effect_any_more(
    begin: Begin, reason: Reason
) -> None:
    async def run() -> None:
        for moment_s in MOMENTS:
            hardware, driver = robot("stop")
            async with open_inline_tree(hardware, driver=driver) as tree, trio.open_nursery() as nursery:
                nursery.start_soon(begin, tree)
                await trio.sleep(moment_s)
                stopped_ns = tree.node.clock.now_ns()
                report = await tree.gate.ask(Stop(reason, "test"), StopDeadlines.of(1.5, LATE_S).gate_s)
                assert isinstance(report, StopReport) and report.confirmed, report
                confirmed_ns = tree.node.clock.now_ns()
                first = hardware.of("safe", stopped_ns)[0]
                assert first.t_ns - stopped_ns < 50_000_000, "the first safe frame does not wait"
                assert hardware.energised == LIMP
                await trio.sleep(1.5 * LATE_S)
                assert not hardware.of("enable", confirmed_ns), f"energised after the report, {moment_s} s"
                stays_safe(hardware)

    run_virtual(run)


def test_saf_021_an_e_stop_does_not_wait_for_an_earlier_stop(begin: Begin) -> None:
    async def run() -> None:
        hardware, driver = robot("estop")
        driver.fallbacks = {**driver.fallbacks, Reason.ESTOP: "off"}
        async with open_inline_tree(hardware, driver=driver) as tree, trio.open_nursery() as nursery:
            nursery.start_soon(begin, tree)
            await trio.sleep(LATE_S / 4)
            nursery.start_soon(tree.gate.ask, Stop(Reason.STOP, "test"), 5.0)
            await trio.sleep(LATE_S / 4)
            pressed_ns = tree.node.clock.now_ns()
            report = await tree.gate.ask(Stop(Reason.ESTOP, "test"), 5.0)
            assert isinstance(report, StopReport) and report.confirmed and report.safe_state == "off"
            first = hardware.of("safe", pressed_ns)[0]
            assert first.safe_state == "off" and first.t_ns - pressed_ns < 50_000_000
            await trio.sleep(1.5 * LATE_S)
            stays_safe(hardware)
            assert hardware.of("safe")[-1].safe_state == "off"

    run_virtual(run)


def test_saf_021_a_wire_is_killed_during_an_arming_and_the_root_waits_for_the_wires_requests(begin: Begin) -> None:
    async def run() -> None:
        for moment_s in MOMENTS:
            hardware, driver = robot("wire")
            async with open_inline_tree(hardware, driver=driver) as tree:
                async with trio.open_nursery() as nursery:
                    nursery.start_soon(begin, tree)
                    await trio.sleep(moment_s)
                    killed_ns = tree.node.clock.now_ns()
                    kill(tree)
                    await trio.sleep(0.01)
                    assert hardware.of("safe", killed_ns), "the first safe frame does not wait"
                    assert not tree.keeper.confirmed
                    await tree.until("disarmed")
                    began_ns = tree.node.clock.now_ns()
                    assert len(tree.wires_made) == 2 and tree.keeper.confirmed
                    nursery.cancel_scope.cancel()
                await trio.sleep(1.5 * LATE_S)
                assert not hardware.of("enable", began_ns), f"energised after the root had confirmed, {moment_s} s"
                stays_safe(hardware)
                report = tree.keeper.last_report
                assert report is not None and report.confirmed and report.path == "stop_channel"

    run_virtual(run)


def test_saf_021_a_wire_that_lost_its_root_ends_when_nothing_can_take_effect_any_more(begin: Begin) -> None:
    async def run() -> None:
        for moment_s in MOMENTS:
            hardware, driver = robot("orphan")
            async with open_inline_tree(hardware, driver=driver) as tree, trio.open_nursery() as nursery:
                nursery.start_soon(begin, tree)
                await trio.sleep(moment_s)
                orphaned_ns = tree.node.clock.now_ns()
                tree.keeper.leave()
                tree.node.ref(tree.gate.address.replace("gate", "watchdog")).tell(RootGone())
                with trio.fail_after(2 * LATE_S):
                    await tree.wire.ended()
                left_ns = tree.node.clock.now_ns()
                assert tree.wire.ended_safe and hardware.energised == LIMP
                assert hardware.of("safe", orphaned_ns)[0].t_ns - orphaned_ns < 50_000_000
                await trio.sleep(1.5 * LATE_S)
                assert not hardware.of("enable", left_ns), f"energised after the wire had ended, {moment_s} s"
                stays_safe(hardware)

    run_virtual(run)


def test_saf_021_root_and_wire_are_killed_and_the_standby_waits_for_their_requests(tmp_path: Path) -> None:
    """The wire ended at ``moment_s`` of its arming. The standby acts at once."""

    class Left(BaseException):
        pass

    async def run() -> None:
        for moment_s in MOMENTS:
            port = "standby"
            hardware = HARDWARE[port] = LateHardware()
            driver, clock, page = LateDriver("fake", port, {}), VirtualClock(), new_page()
            safety_page = SafetyPage(words_of(page))
            safety_page.may_be_energised = True
            LateRequests(safety_page, clock).asking(LATE_S).__enter__().begin()
            trio.lowlevel.spawn_system_task(hardware.carry_out, clock)
            await trio.sleep(moment_s)
            node, left = Node(port, clock), list[int]()

            class Quiet(Standby):
                async def _tell(self, report: object) -> None:
                    """Do nothing: a disk takes real time."""

            async with trio.open_nursery() as nursery:
                await nursery.start(node.run)
                watched = WatchOver(0, 0, (os.dup(page),))
                standby = Quiet(driver, port, port, tmp_path / "report", watched, left.append)
                await nursery.start(node.cell(addresses.of(port).path("standby"), lambda s=standby: s).run)
                with trio.fail_after(2 * LATE_S):
                    while not left:  # noqa: ASYNC110  # the standby ends its process
                        await trio.sleep(0.005)
                left_ns = clock.now_ns()
                assert left == [0] and not safety_page.may_be_energised and hardware.energised == LIMP
                await trio.sleep(1.5 * LATE_S)
                nursery.cancel_scope.cancel()
            os.close(page)
            del HARDWARE[port]
            assert not hardware.of("enable", left_ns), f"energised after the standby had ended, {moment_s} s"
            stays_safe(hardware)

    run_virtual(run)


@pytest.mark.parametrize("root_too", [False, True])
def test_saf_021_a_wire_whose_sdk_hangs_while_arming_confirms_nothing(
    monkeypatch: pytest.MonkeyPatch, root_too: bool
) -> None:
    """Only the end of the process prevents the SDK from carrying out the request."""
    monkeypatch.setattr(LateWire, "hangs", True)

    async def run() -> None:
        hardware, driver = robot("hangs")
        async with open_inline_tree(hardware, driver=driver) as tree, trio.open_nursery() as nursery:
            if root_too:
                tree.keeper._break = lambda reason, why: None  # type: ignore[method-assign]
            nursery.start_soon(tree.gate.ask, Resume("test"), 10.0)
            await trio.sleep(0.001)
            if root_too:
                report = await tree.gate.ask(Stop(Reason.STOP, "test"), 5.0)
                assert isinstance(report, StopReport) and not report.confirmed
                assert {motor.detail for motor in report.motors} == {UNSETTLED}
                tree.wire.close_link()
                await tree.wire.ended()
                assert not tree.wire.ended_safe, "the standby must check for open requests"
            else:
                monkeypatch.setattr(LateWire, "hangs", False)
                await tree.until("disarmed")
                assert len(tree.wires_made) == 2 and tree.keeper.confirmed
                disarmed_ns = tree.node.clock.now_ns()
                await trio.sleep(1.5 * LATE_S)
                assert not hardware.of("enable", disarmed_ns)
                stays_safe(hardware)
            nursery.cancel_scope.cancel()

    run_virtual(run)


def test_saf_021_a_service_that_timed_out_may_still_take_effect(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(LateWire, "energises", False)

    async def run() -> None:
        hardware, driver = robot("gives-up")
        async with open_inline_tree(hardware, driver=driver) as tree:
            answer = await power(tree, gives_up=True)
            assert isinstance(answer, Refused), answer
            report = await tree.gate.ask(Stop(Reason.STOP, "test"), 5.0)
            assert isinstance(report, StopReport) and report.confirmed
            await trio.sleep(1.5 * LATE_S)
            stays_safe(hardware)

    run_virtual(run)


@pytest.mark.usefixtures("runs_when_stopped")
def test_saf_021_a_link_lost_during_a_service_is_confirmed_when_nothing_can_take_effect_any_more() -> None:
    """Every motor confirms the first safe frame on the new link, and the robot is energised after it."""

    async def run() -> None:
        hardware, driver = robot("lost")
        async with open_inline_tree(hardware, driver=driver) as tree, trio.open_nursery() as nursery:
            nursery.start_soon(power_as_is, tree)
            await trio.sleep(LATE_S / 4)
            hardware.plugged = False
            await tree.until("down")
            hardware.plugged = True
            linked = await tree.until("stopping")
            assert linked.last_stop is not None and not linked.last_stop.confirmed
            await tree.until("disarmed")
            disarmed_ns = tree.node.clock.now_ns()
            await trio.sleep(1.5 * LATE_S)
            assert not hardware.of("enable", disarmed_ns)
            stays_safe(hardware)

    run_virtual(run)


@pytest.mark.usefixtures("runs_when_stopped")
def test_saf_021_a_robot_that_a_service_has_powered_must_be_made_safe() -> None:
    """If root and wire end then, the standby acts, although the robot was never armed."""

    async def run() -> None:
        hardware, driver = robot("powered")
        async with open_inline_tree(hardware, driver=driver) as tree:
            safety_page = transport_of(tree)._safety_page
            assert not safety_page.may_be_energised
            await power_as_is(tree)
            assert hardware.energised == ON and safety_page.may_be_energised
            report = await tree.gate.ask(Stop(Reason.STOP, "test"), 5.0)
            assert isinstance(report, StopReport) and report.confirmed
            assert hardware.energised == LIMP and not safety_page.may_be_energised

    run_virtual(run)


def test_saf_021_a_stop_does_not_wait_for_requests_that_were_answered() -> None:
    """An armed robot is stopped as quickly as without these requests."""

    async def run() -> None:
        hardware, driver = robot("armed")
        async with open_inline_tree(hardware, driver=driver) as tree:
            for services in (False, True):
                assert isinstance(await arm(tree), Resumed)
                assert not services or not isinstance(await power_as_is(tree), Refused)
                assert hardware.energised == ON
                stopped_ns = tree.node.clock.now_ns()
                report = await tree.gate.ask(Stop(Reason.STOP, "test"), 5.0)
                assert isinstance(report, StopReport) and report.confirmed
                assert tree.node.clock.now_ns() - stopped_ns < 50_000_000
                assert len(hardware.of("safe", stopped_ns)) == 1
            assert isinstance(await tree.gate.ask(Resume("test"), 5.0), Resumed)

    run_virtual(run)


def test_saf_021_the_shared_page_contains_every_open_request() -> None:
    async def run() -> None:
        safety_page, clock = SafetyPage(), VirtualClock()
        requests = LateRequests(safety_page, clock)

        def unsettled_s() -> float:
            return safety_page.unsettled_s(clock.now_ns())

        with requests.asking(3.0) as arming:
            assert unsettled_s() == 0 and not safety_page.is_asking, "no request was sent yet"
            arming.begin()
            with requests.asking(5.0) as service:
                service.begin()
                assert safety_page.is_asking and unsettled_s() == 5.0
                service.answered = True
            assert safety_page.is_asking and unsettled_s() == 3.0
        assert not safety_page.is_asking and unsettled_s() == 3.0, "the request was not answered"
        await trio.sleep(2.0)
        assert unsettled_s() == pytest.approx(1.0)
        with requests.asking(0.0) as setpoint:
            setpoint.begin()
        with requests.asking(0.5) as again:
            again.begin()
            assert unsettled_s() == pytest.approx(1.0), "the earlier one counts, too"
            again.answered = True
        with pytest.raises(ProcessSpent), requests.asking(2.0) as hanging:
            hanging.begin()
            raise ProcessSpent("the SDK did not return")
        await trio.sleep(10.0)
        assert safety_page.is_asking and unsettled_s() == 2.0
        safety_page.cut_off(clock.now_ns())
        assert not safety_page.is_asking and unsettled_s() == 2.0
        await trio.sleep(2.0)
        assert unsettled_s() == 0

    run_virtual(run)


def test_saf_021_deadlines_of_a_stop_include_the_time_in_which_requests_may_take_effect() -> None:
    usual, late = StopDeadlines.of(1.5), StopDeadlines.of(1.5, 3.0)
    for name in ("gate_s", "root_s", "end_s"):
        assert getattr(late, name) >= getattr(usual, name) + 3.0
    assert (late.attempt_s, late.own_stop_s) == (usual.attempt_s, usual.own_stop_s), (
        "they get the late time only if the page shows an open request"
    )
