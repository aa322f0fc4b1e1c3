"""A wire whose calls are slow: stops do not wait for them, and its background tasks end with it."""

from __future__ import annotations

import msgspec
import pytest
import trio

from strands_actors.contract.driver import Reason
from strands_actors.contract.wire import WireDown
from strands_actors.kernel.messages import Refused
from strands_actors.supervisors.gate.failsafe import Mode
from strands_actors.supervisors.gate.messages import Accepted, GetStatus, Resume, Resumed, Status, Stop, StopReport
from strands_actors.testing import run_virtual
from strands_actors.testing.fake import FakeDriver, FakeWire
from strands_actors.testing.inline import InlineTree, open_inline_tree

from .writer import armed, freeze, setpoints


async def mode_of(tree: InlineTree) -> str:
    status = await tree.gate.ask(GetStatus(), 1.0)
    assert isinstance(status, Status)
    return status.mode


@pytest.mark.parametrize("read_s", [0.03, 0.15, 0.5])
def test_saf_006_a_stop_does_not_wait_for_a_reading(read_s: float) -> None:
    async def run() -> None:
        async with open_inline_tree() as tree:
            await armed(tree)
            tree.hardware.read_s = read_s
            for late_s in (0.001, 0.004, 0.011):
                await trio.sleep(0.1 + late_s)
                began_ns = tree.node.clock.now_ns()
                report = await tree.gate.ask(Stop(Reason.STOP, "a test"), 2.0)
                assert isinstance(report, StopReport) and report.confirmed
                assert tree.hardware.of("safe", began_ns)[0].t_ns - began_ns <= 1_000_000

    run_virtual(run)


@pytest.mark.parametrize("write_s", [0.03, 0.3])
def test_saf_002_a_stop_does_not_wait_for_a_write_and_the_write_does_not_follow_it(write_s: float) -> None:
    async def run() -> None:
        async with open_inline_tree() as tree:
            writer = await armed(tree)
            tree.hardware.write_s = write_s
            writer.ref.tell(writer.setpoint(latched=True, a=1.0))
            await trio.sleep(0.005)
            began_ns = tree.node.clock.now_ns()
            report = await tree.gate.ask(Stop(Reason.STOP, "a test"), 2.0)
            assert isinstance(report, StopReport) and report.confirmed
            safe = tree.hardware.of("safe", began_ns)[0]
            assert safe.t_ns - began_ns <= 1_000_000
            await trio.sleep(1.0)
            assert tree.hardware.after("setpoint", safe) == []

    run_virtual(run)


def test_saf_002_no_setpoint_follows_a_failed_hold() -> None:
    """Neither a setpoint that was accepted while the hold was tried, nor one that comes before the gate
    knows of the failure. A second hold meanwhile makes no difference.
    """

    async def run() -> None:
        async with open_inline_tree() as tree:
            writer = await armed(tree)
            assert isinstance(await writer.send(a=0.2), Accepted)
            tree.hardware.holds, tree.hardware.confirm_s = False, 0.15
            await trio.sleep(0.2)  # the setpoint has expired, and a hold is tried
            assert await mode_of(tree) == Mode.HOLDING
            await writer.read_epoch()
            assert isinstance(await writer.send(ttl_s=1.0, a=0.3), Accepted)
            await trio.sleep(0.12)  # the second setpoint expires, too
            for _ in range(30):
                await writer.read_epoch()
                writer.ref.tell(writer.setpoint(ttl_s=1.0, a=0.3))
                await trio.sleep(0.01)
            limp = next(safe for safe in tree.hardware.of("safe") if safe.safe_state == "limp")
            assert tree.hardware.after("setpoint", limp) == []
            await trio.sleep(0.5)
            assert await mode_of(tree) == Mode.DISARMED
            answer = await writer.send(a=0.3)
            assert isinstance(answer, Refused) and "the robot could not hold: it slips" in answer.text
            tree.hardware.holds = True
            assert isinstance(await tree.gate.ask(Resume("test"), 1.0), Resumed)
            await writer.acquire()
            assert isinstance(await writer.send(a=0.1), Accepted)
            await trio.sleep(0.01)
            assert tree.hardware.after("setpoint", limp), "the robot moves after the next arming"

    run_virtual(run)


def test_saf_002_no_setpoint_follows_a_failed_hold_even_if_the_gate_is_frozen() -> None:
    async def run() -> None:
        async with open_inline_tree() as tree:
            writer = await armed(tree)
            assert isinstance(await writer.send(a=0.2), Accepted)
            tree.hardware.holds, tree.hardware.confirm_s = False, 0.15
            await trio.sleep(0.2)
            await writer.read_epoch()
            assert isinstance(await writer.send(ttl_s=1.0, a=0.3), Accepted)
            freeze(tree, "gate")  # the gate does not learn that the hold has failed
            await trio.sleep(0.5)
            limp = next(safe for safe in tree.hardware.of("safe") if safe.safe_state == "limp")
            assert tree.hardware.after("setpoint", limp) == []

    run_virtual(run)


def test_the_background_task_of_a_wire_starts_and_ends_with_it(monkeypatch: pytest.MonkeyPatch) -> None:
    events: list[str] = []

    async def serve(self: FakeWire, task_status: trio.TaskStatus[None]) -> None:
        events.append("begun")
        await trio.sleep(0.2)
        events.append("ready")
        task_status.started()
        try:
            await trio.sleep_forever()
        finally:
            events.append("ended")

    monkeypatch.setattr(FakeWire, "serve", serve)

    async def run() -> None:
        async with open_inline_tree() as tree:
            await armed(tree)
            assert events == ["begun", "ready"]
            tree.hardware.plugged = False
            await trio.sleep(0.1)
            assert events[:3] == ["begun", "ready", "ended"]
            tree.hardware.plugged = True
            await trio.sleep(1.0)
            assert events.count("begun") == events.count("ended") + 1 and tree.hardware.opens == 2

    run_virtual(run)


def test_saf_012_a_background_task_that_loses_the_link_leads_to_a_safe_state(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    async def serve(self: FakeWire, task_status: trio.TaskStatus[None]) -> None:
        task_status.started()
        await trio.sleep(0.5)
        raise WireDown("the peer hung up")

    monkeypatch.setattr(FakeWire, "serve", serve)

    async def run() -> None:
        async with open_inline_tree() as tree:
            writer = await armed(tree)
            writer.ref.tell(writer.setpoint(latched=True, a=1.0))
            await trio.sleep(0.9)
            safe = tree.hardware.of("safe")[0]  # the first frame after the link is open again
            assert tree.hardware.after("setpoint", safe) == [] and setpoints(tree)
            assert await mode_of(tree) in (Mode.LOST, Mode.DISARMED, Mode.STOPPING)

    run_virtual(run)


def test_saf_004_the_firmware_watchdog_is_fed_only_while_gate_and_transport_answer(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    fed: list[float] = []

    async def feed(self: FakeWire) -> None:
        fed.append(trio.current_time())

    monkeypatch.setattr(FakeWire, "feed", feed)

    async def run() -> None:
        async with open_inline_tree() as tree:
            await armed(tree)
            await trio.sleep(0.5)
            assert len(fed) >= 20
            tree.hardware.read_hangs = True  # the transport does not answer any more
            await trio.sleep(0.1)
            count = len(fed)
            await trio.sleep(0.05)
            assert len(fed) == count

    run_virtual(run)


def test_saf_003_a_write_that_takes_longer_than_declared_is_a_frozen_wire(monkeypatch: pytest.MonkeyPatch) -> None:
    """A driver may declare that its calls take longer than a heartbeat. Its wire is fenced only after
    this time.
    """
    monkeypatch.setattr(FakeDriver, "timing", msgspec.structs.replace(FakeDriver.timing, call_s=0.4))

    async def run() -> None:
        async with open_inline_tree() as tree:
            writer = await armed(tree)
            tree.hardware.write_s = 0.3
            writer.ref.tell(writer.setpoint(ttl_s=0.5, latched=True, a=1.0))
            await trio.sleep(0.8)
            assert len(tree.wires_made) == 1 and setpoints(tree)
            began_ns = tree.node.clock.now_ns()
            tree.hardware.write_s = 60.0
            writer.ref.tell(writer.setpoint(latched=True, a=2.0))
            await trio.sleep(0.9)
            assert len(tree.wires_made) > 1
            safe = tree.hardware.of("safe", began_ns)[0]
            assert safe.path == "stop_channel" and tree.hardware.after("setpoint", safe) == []

    run_virtual(run)


def test_saf_001_a_setpoint_that_was_too_late_is_not_resent_either() -> None:
    """It is latched, so that only its deadline forbids it."""

    async def run() -> None:
        async with open_inline_tree() as tree:
            writer = await armed(tree)
            tree.hardware.write_s = 0.06
            writer.ref.tell(writer.setpoint(ttl_s=0.05, latched=True, a=1.0))
            await trio.sleep(1.0)
            assert setpoints(tree) == []
            assert await writer.send(ttl_s=0.5, latched=True, a=2.0) is not None
            await trio.sleep(0.2)
            assert setpoints(tree), "a setpoint in time is written"

    run_virtual(run)
