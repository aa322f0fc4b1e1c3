"""The wire and the stop channel on a twin, without a tree: what is written, and what is not."""

from __future__ import annotations

import functools
import os
import time
from collections.abc import Awaitable, Callable, Iterator
from pathlib import Path

import pytest
import trio

from strands_actors.contract.wire import PermitDenied, WireDown
from strands_actors.drivers.franka.client import connect
from strands_actors.drivers.franka.driver import Franka
from strands_actors.drivers.franka.stop_channel import FrankaStopChannel
from strands_actors.drivers.franka.wire import FrankaWire
from strands_actors.kernel.clock import MonotonicClock
from strands_actors.testing import Twin
from tests.answers import PATIENCE_S


class Yes:
    def check(self) -> None:
        pass


class No:
    def check(self) -> None:
        raise PermitDenied("a stop is waiting")


@pytest.fixture(scope="module")
def twin_process(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Twin]:
    with Twin("panda", tmp_path_factory.mktemp("twin")) as process:
        yield process


@pytest.fixture
def twin(twin_process: Twin) -> Iterator[Twin]:
    os.truncate(twin_process.log.path, 0)
    yield twin_process
    twin_process.go_on()
    twin_process.fault("ok")
    twin_process.order("mode IDLE")


def on_wire(twin: Twin, act: Callable[[FrankaWire], Awaitable[None]]) -> None:
    """On a wire that is open."""

    async def run() -> None:
        wire = FrankaWire(Franka("panda", twin.port, {}).config, MonotonicClock())
        try:
            with trio.fail_after(2 * PATIENCE_S):
                await wire.open()
                await act(wire)
        finally:
            session = wire._session_or_none
            wire.close()
            if session is not None:
                with trio.CancelScope(shield=True):
                    await session.child.wait()  # which a wire that is closed does beside

    trio.run(run)


async def until(look: Callable[[], object]) -> None:
    with trio.fail_after(PATIENCE_S):
        while not look():  # noqa: ASYNC110  # another process's doing
            await trio.sleep(0.005)


async def goal_of(wire: FrankaWire, far: float) -> tuple[float, ...]:
    here = (await wire.read()).position
    return (here[0] + (far if here[0] < 0.3 else -far), *here[1:])


async def moves(wire: FrankaWire, twin: Twin) -> None:
    await wire.arm(Yes())
    await wire.write(await goal_of(wire, 0.6), Yes())
    await until(lambda: len(twin.log.host("setpoint")) > 50)


def test_saf_001_what_is_not_permitted_is_not_written(twin: Twin) -> None:
    async def act(wire: FrankaWire) -> None:
        with pytest.raises(PermitDenied, match="a stop is waiting"):
            await wire.arm(No())
        await wire.arm(Yes())
        with pytest.raises(PermitDenied, match="a stop is waiting"):
            await wire.write(await goal_of(wire, 0.1), No())
        await trio.sleep(0.1)
        assert not twin.log.host("enable") and not twin.log.host("setpoint")

    on_wire(twin, act)


def test_saf_012_nothing_is_written_to_a_controller_that_is_silent(twin: Twin) -> None:
    async def act(wire: FrankaWire) -> None:
        await wire.arm(Yes())
        goal = await goal_of(wire, 0.1)
        twin.pause()
        await trio.sleep(0.1)
        with pytest.raises(PermitDenied, match="no state for 20 ms"):
            await wire.write(goal, Yes())
        await trio.sleep(0.2)
        with pytest.raises(WireDown, match="no state for"):
            await wire.read()
        with pytest.raises(WireDown, match="no state for"):
            await wire.arm(Yes())
        since_ns = time.monotonic_ns()
        twin.go_on()
        await trio.sleep(0.1)
        assert not twin.log.host("enable", since_ns)

    on_wire(twin, act)


def test_a_motion_that_the_controller_ended_is_not_begun_again_before_it_is_armed(twin: Twin) -> None:
    async def act(wire: FrankaWire) -> None:
        await moves(wire, twin)
        goal = await goal_of(wire, 0.2)
        twin.order("reflex joint_reflex")
        await trio.sleep(0.2)
        seen = await wire.read()
        assert seen.faults["motion"] == "reflex_aborted"
        assert seen.faults["reasons"] == "joint_reflex"
        since_ns = time.monotonic_ns()
        with pytest.raises(PermitDenied, match="reflex"):
            await wire.write(goal, Yes())
        assert await wire.perform("recover", {}, Yes()) == {"recovered": True}
        await trio.sleep(0.1)
        with pytest.raises(PermitDenied, match="reflex_aborted"):
            await wire.write(goal, Yes())
        await trio.sleep(0.1)
        twin.log.silent_after(since_ns, "setpoint")
        await wire.arm(Yes())
        assert not (await wire.read()).faults
        await wire.write(await goal_of(wire, 0.1), Yes())
        await until(lambda: twin.log.host("setpoint", since_ns))

    on_wire(twin, act)


def test_the_same_target_again_is_no_motion_again(twin: Twin) -> None:
    async def act(wire: FrankaWire) -> None:
        await wire.arm(Yes())
        goal = await goal_of(wire, 0.05)
        until_s = trio.current_time() + 1.5
        while trio.current_time() < until_s:
            await wire.write(goal, Yes())  # as the keepalive does
            await trio.sleep(0.05)
        assert (await wire.read()).position == pytest.approx(goal, abs=2e-3)
        assert len(twin.log.host("enable")) == 1
        before = len(twin.log.host("setpoint"))
        await wire.write(goal, Yes())
        await trio.sleep(0.1)
        assert len(twin.log.host("setpoint")) == before

    on_wire(twin, act)


def test_saf_009_somebody_elses_motion_keeps_us_from_arming(twin: Twin) -> None:
    async def act(wire: FrankaWire) -> None:
        other, _ = await connect(twin.port.partition(":")[0], 5, "panda")
        try:
            number = other.start_motion()
            assert (await other.answer(number, "move")).payload == b"\x01"
            await trio.sleep(0.1)
            await wire.read()
            with pytest.raises(WireDown, match="somebody else moves the arm"):
                await wire.arm(Yes())
        finally:
            other.close()

    on_wire(twin, act)


def test_saf_002_a_stop_leaves_before_anything_is_waited_for(twin: Twin) -> None:
    async def act(wire: FrankaWire) -> None:
        await moves(wire, twin)
        began_ns = time.monotonic_ns()
        reports = await wire.make_safe("stop")
        assert [(report.axis, report.safe) for report in reports] == [(f"joint{at}", True) for at in range(1, 8)]
        assert all(report.written and report.acknowledged for report in reports)
        await trio.sleep(0.2)
        twin.log.no_setpoint_after_safe(began_ns)

    on_wire(twin, act)


def test_saf_005_a_stop_without_a_link_is_a_report_of_failures() -> None:
    wire = FrankaWire(Franka("panda", "127.0.0.1", {}).config, MonotonicClock())
    reports = trio.run(wire.make_safe, "stop")
    assert len(reports) == 7
    assert not any(report.written or report.safe for report in reports)


def test_a_reflex_is_confirmed_as_standing_and_named(twin: Twin) -> None:
    async def act(wire: FrankaWire) -> None:
        await wire.arm(Yes())
        twin.order("reflex joint_reflex")
        await trio.sleep(0.1)
        reports = await wire.make_safe("stop")
        assert all(report.safe for report in reports)
        assert reports[0].detail == "reflex, joint_reflex"

    on_wire(twin, act)


def test_saf_020_a_link_that_was_lost_is_stopped_by_what_is_left_of_it_and_anew(twin: Twin) -> None:
    async def act(wire: FrankaWire) -> None:
        await moves(wire, twin)
        session = wire._session_or_none
        assert session is not None
        since_ns = time.monotonic_ns()
        reports = await wire.reach("stop")
        assert all(report.written and report.safe for report in reports)
        assert len(twin.log.host("safe", since_ns)) == 2
        twin.log.no_setpoint_after_safe(since_ns)
        await session.child.wait()
        with pytest.raises(WireDown, match="not connected"):
            await wire.read()

    on_wire(twin, act)


def test_saf_020_a_controller_that_froze_finds_the_stop_when_it_goes_on(twin: Twin) -> None:
    async def act(wire: FrankaWire) -> None:
        await moves(wire, twin)
        session = wire._session_or_none
        assert session is not None
        twin.pause()
        reports = await wire.reach("stop")
        assert all(report.written and not report.safe for report in reports)
        since_ns = time.monotonic_ns()
        twin.go_on()
        await until(lambda: twin.log.host("safe", since_ns))
        await trio.sleep(0.2)
        twin.log.no_setpoint_after_safe(since_ns)
        await session.child.wait()

    on_wire(twin, act)


# -- the stop channel


def stopped(twin: Twin) -> tuple[list[bool], str]:
    channel = FrankaStopChannel(Franka("panda", twin.port, {}).config, (), MonotonicClock())
    reports = trio.run(functools.partial(channel.make_safe, "stop"))
    channel.close()
    return [report.safe for report in reports], reports[0].detail


def test_saf_003_the_stop_channel_stops_who_else_moves_the_arm(twin: Twin) -> None:
    async def act(wire: FrankaWire) -> None:
        await moves(wire, twin)
        since_ns = time.monotonic_ns()
        safe, _ = await trio.to_thread.run_sync(stopped, twin)
        assert safe == [True] * 7
        twin.log.no_setpoint_after_safe(since_ns)
        with pytest.raises(PermitDenied):
            await wire.write(await goal_of(wire, 0.1), No())

    on_wire(twin, act)


def test_saf_005_a_frozen_controller_confirms_nothing(twin: Twin) -> None:
    twin.pause()
    safe, detail = stopped(twin)
    assert safe == [False] * 7
    assert "no answer to connect" in detail


def test_saf_005_a_clock_that_stands_still_confirms_nothing(twin: Twin) -> None:
    twin.fault("stuck")
    time.sleep(0.1)
    safe, detail = stopped(twin)
    assert safe == [False] * 7
    assert detail == "the controller's time stamp stands still"


def test_saf_005_nobody_there(twin: Twin, tmp_path: Path) -> None:
    channel = FrankaStopChannel(Franka("panda", "127.0.0.1:1338", {}).config, (), MonotonicClock())
    assert not any(report.safe for report in trio.run(channel.make_safe, "stop"))
    channel = FrankaStopChannel(Franka("panda", "127.9.9.9", {}).config, (), MonotonicClock())
    assert "cannot connect" in trio.run(channel.make_safe, "stop")[0].detail
