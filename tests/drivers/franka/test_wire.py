"""Test the wire and the stop channel on a twin, without a tree: which frames are written."""

from __future__ import annotations

import contextlib
import functools
import os
import time
from collections.abc import Awaitable, Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import trio

from strands_actors.contract.driver import Reason
from strands_actors.contract.wire import PermitDenied, WireDown
from strands_actors.drivers.franka.client import connect
from strands_actors.drivers.franka.driver import Franka
from strands_actors.drivers.franka.protocol import RobotMode
from strands_actors.drivers.franka.stop_channel import FrankaStopChannel, StopWatch
from strands_actors.drivers.franka.wire import OLD_S, FrankaWire
from strands_actors.kernel.clock import NS, MonotonicClock
from strands_actors.supervisors.wire.messages import Cycle, MakeSafe, Write
from strands_actors.supervisors.wire.transport import Transport
from strands_actors.testing import Twin
from tests.answers import PATIENCE_S

EPOCH = 5


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
    """Run ``act`` on an open wire."""

    async def run() -> None:
        wire = FrankaWire(Franka("panda", twin.port, {}).config, MonotonicClock())
        try:
            with trio.fail_after(2 * PATIENCE_S):
                await wire.open()
                await act(wire)
        finally:
            session = wire.session_or_none
            wire.close()
            if session is not None:
                with trio.CancelScope(shield=True):
                    await session.child.wait()  # a wire that is closed waits for it, too

    trio.run(run)


async def until(look: Callable[[], object]) -> None:
    with trio.fail_after(PATIENCE_S):
        while not look():  # noqa: ASYNC110  # another process's doing
            await trio.sleep(0.005)


async def goal_of(wire: FrankaWire, far: float) -> tuple[float, ...]:
    here = (await wire.read()).position
    return (here[0] + (far if here[0] < 0.3 else -far), *here[1:])


async def switch(wire: FrankaWire, twin: Twin, mode: RobotMode) -> None:
    """Set the controller's mode, and wait until the wire has read it."""
    twin.order(f"mode {mode.name}")
    with trio.fail_after(PATIENCE_S):
        while (await wire.read()).sensors["robot_mode"] != (float(mode),):  # noqa: ASYNC110  # as in ``until``
            await trio.sleep(0.005)


async def moves(wire: FrankaWire, twin: Twin) -> None:
    await wire.arm(Yes())
    await wire.write(await goal_of(wire, 0.6), Yes())
    await until(lambda: len(twin.log.host("setpoint")) > 50)


def test_saf_001_nothing_is_written_without_a_permit(twin: Twin) -> None:
    async def act(wire: FrankaWire) -> None:
        with pytest.raises(PermitDenied, match="a stop is waiting"):
            await wire.arm(No())
        await wire.arm(Yes())
        with pytest.raises(PermitDenied, match="a stop is waiting"):
            await wire.write(await goal_of(wire, 0.1), No())
        await trio.sleep(0.1)
        assert not twin.log.host("enable") and not twin.log.host("setpoint")

    on_wire(twin, act)


def test_saf_012_nothing_is_written_to_a_silent_controller(twin: Twin) -> None:
    async def act(wire: FrankaWire) -> None:
        await wire.arm(Yes())
        goal = await goal_of(wire, 0.1)
        twin.pause()
        await trio.sleep(0.1)
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


def test_a_target_that_comes_before_the_motion_before_has_ended_is_begun_by_the_re_send(twin: Twin) -> None:
    """It is not refused, because a refused target is not sent again."""

    async def act(wire: FrankaWire) -> None:
        await wire.arm(Yes())
        goal = await goal_of(wire, 0.05)
        await switch(wire, twin, RobotMode.MOVE)
        for _ in range(3):
            await wire.write(goal, Yes())
        with pytest.raises(PermitDenied, match="a stop is waiting"):
            await wire.write(goal, No())
        await switch(wire, twin, RobotMode.IDLE)
        assert not twin.log.host("enable"), "the target was not written, and no motion continues by itself"
        with pytest.raises(PermitDenied, match="a stop is waiting"):
            await wire.write(goal, No())
        assert not twin.log.host("enable")
        until_s = trio.current_time() + 1.5
        while trio.current_time() < until_s:
            await wire.write(goal, Yes())
            await trio.sleep(0.05)
        assert (await wire.read()).position == pytest.approx(goal, abs=2e-3)
        assert len(twin.log.host("enable")) == 1

    on_wire(twin, act)


def test_a_target_that_comes_while_no_state_does_is_begun_by_the_re_send(twin: Twin) -> None:
    async def act(wire: FrankaWire) -> None:
        await wire.arm(Yes())
        goal = await goal_of(wire, 0.05)
        twin.pause()
        await trio.sleep(2 * OLD_S)
        await wire.write(goal, Yes())
        with pytest.raises(PermitDenied, match="a stop is waiting"):
            await wire.write(goal, No())
        twin.go_on()
        await trio.sleep(0.1)
        assert not twin.log.host("enable")
        await wire.write(goal, Yes())
        await until(lambda: twin.log.host("setpoint"))

    on_wire(twin, act)


def transport_on(wire: FrankaWire) -> Transport:
    """Return a tree's transport by itself. It has the wire, and its messages have no receiver."""
    transport = Transport(Franka("panda", "192.0.2.1", {}), "gate", "watchdog", "guardian", EPOCH)
    nobody = SimpleNamespace(tell=lambda message: None)
    transport.context = SimpleNamespace(  # type: ignore[assignment]
        clock=MonotonicClock(), urgent_waiting=False, until_urgent=contextlib.nullcontext
    )
    transport._gate = transport._watchdog = transport._guardian = nobody  # type: ignore[assignment]
    transport._serving = SimpleNamespace(check=lambda: None)  # type: ignore[assignment]
    transport._wire = wire
    return transport


@pytest.mark.parametrize(
    ("expires_s", "resend_epoch", "begins"),
    [(0.0, EPOCH, True), (5.0, EPOCH, True), (0.1, EPOCH, False), (0.0, EPOCH + 1, False)],
)
def test_saf_010_a_re_sent_target_begins_only_within_its_deadline_and_epoch(
    twin: Twin, expires_s: float, resend_epoch: int, begins: bool
) -> None:
    async def act(wire: FrankaWire) -> None:
        await wire.arm(Yes())
        transport = transport_on(wire)
        goal = await goal_of(wire, 0.05)
        await switch(wire, twin, RobotMode.MOVE)
        now_ns = time.monotonic_ns()
        expires_ns = now_ns + round(expires_s * NS) if expires_s else 0
        await transport._obey(Write(EPOCH, now_ns + NS, goal, expires_ns))
        await trio.sleep(0.15)
        await switch(wire, twin, RobotMode.IDLE)
        for number in range(10):
            await transport._obey(Cycle(number, resend_epoch))
            await trio.sleep(0.03)
        assert len(twin.log.host("enable")) == begins
        assert bool(twin.log.host("setpoint")) == begins

    on_wire(twin, act)


def test_saf_002_a_waiting_motion_does_not_begin_after_a_stop(twin: Twin) -> None:
    async def act(wire: FrankaWire) -> None:
        await wire.arm(Yes())
        transport = transport_on(wire)
        goal = await goal_of(wire, 0.05)
        await switch(wire, twin, RobotMode.MOVE)
        await transport._obey(Write(EPOCH, time.monotonic_ns() + NS, goal))
        await transport._obey(MakeSafe(EPOCH + 1, "stop", Reason.STOP))
        await switch(wire, twin, RobotMode.IDLE)
        await wire.arm(Yes())
        for number in range(10):
            await transport._obey(Cycle(number, EPOCH + 1))
            await trio.sleep(0.03)
        await transport._obey(Write(EPOCH, time.monotonic_ns() + NS, goal))
        twin.log.silent_after(0, "enable", "setpoint")

    on_wire(twin, act)


def test_saf_010_a_target_is_not_begun_behind_a_motion_that_is_not_ours(twin: Twin) -> None:
    """This holds however long it takes: no caller expects the arm to move then."""

    async def act(wire: FrankaWire) -> None:
        await wire.arm(Yes())
        goal = await goal_of(wire, 0.05)
        await switch(wire, twin, RobotMode.MOVE)
        with pytest.raises(PermitDenied, match="another one runs"), trio.fail_after(PATIENCE_S):
            while True:
                await wire.write(goal, Yes())
                await trio.sleep(0.05)
        assert "another one runs" in (await wire.read()).faults["motion"]
        await switch(wire, twin, RobotMode.IDLE)
        with pytest.raises(PermitDenied, match="another one runs"):
            await wire.write(goal, Yes())
        assert not twin.log.host("enable")
        await wire.make_safe("stop")
        await wire.arm(Yes())
        await wire.write(goal, Yes())
        await until(lambda: twin.log.host("setpoint"))

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


def test_saf_009_another_clients_motion_prevents_arming(twin: Twin) -> None:
    async def act(wire: FrankaWire) -> None:
        other = await connect(twin.port.partition(":")[0], 5, "panda")
        try:
            number = other.start_motion()
            assert (await other.answer(number, "move")).payload == b"\x01"
            await trio.sleep(0.1)
            await wire.read()
            with pytest.raises(WireDown, match="another program moves the arm"):
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


def test_saf_020_a_stop_uses_the_rest_of_a_lost_link_and_a_new_one(twin: Twin) -> None:
    async def act(wire: FrankaWire) -> None:
        await moves(wire, twin)
        session = wire.session_or_none
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
        session = wire.session_or_none
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


def test_saf_003_the_stop_channel_stops_another_clients_motion(twin: Twin) -> None:
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
    assert "the controller did not answer connect" in detail


def test_saf_005_a_clock_that_stands_still_confirms_nothing(twin: Twin) -> None:
    twin.fault("stuck")
    time.sleep(0.1)
    safe, detail = stopped(twin)
    assert safe == [False] * 7
    assert detail == "the time stamp of the controller does not advance"


def test_saf_022_a_state_that_arrives_late_does_not_replace_a_newer_one() -> None:
    """The network may deliver two datagrams in the wrong order."""

    def state(message_id: int, mode: RobotMode) -> Any:
        return SimpleNamespace(message_id=message_id, robot_mode=mode, dq=(0.0,) * 7, reasons=())

    states = [state(12, RobotMode.MOVE), state(11, RobotMode.IDLE), state(13, RobotMode.IDLE)]
    client: Any = SimpleNamespace(replies=list, newest_state=lambda: states.pop(0))
    config = Franka("panda", "127.0.0.1", {}).config
    watch = StopWatch(config, client, state(10, RobotMode.MOVE), stop=1)
    assert [all(report.safe for report in watch.look()) for _ in range(3)] == [False, False, True]


def test_saf_005_no_controller_is_found(twin: Twin, tmp_path: Path) -> None:
    channel = FrankaStopChannel(Franka("panda", "127.0.0.1:1338", {}).config, (), MonotonicClock())
    assert not any(report.safe for report in trio.run(channel.make_safe, "stop"))
    channel = FrankaStopChannel(Franka("panda", "127.9.9.9", {}).config, (), MonotonicClock())
    assert "cannot connect" in trio.run(channel.make_safe, "stop")[0].detail
