"""Test how the wire and its stop channel stop the twin's arm, in memory and virtual time."""

from __future__ import annotations

from collections import deque
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

import pytest
import trio

from strands_actors.contract.wire import MotorReport, WireDown
from strands_actors.drivers.common.twin import Fault
from strands_actors.drivers.kinova.client import KortexClient, Page
from strands_actors.drivers.kinova.protocol import ArmState, Call, Frame, SubError
from strands_actors.drivers.kinova.stop_channel import KinovaStopChannel
from strands_actors.drivers.kinova.stopping import FRAME_NUMBERS
from strands_actors.drivers.kinova.twin.base import Base
from strands_actors.drivers.kinova.twin.errors import CallFailed
from strands_actors.drivers.kinova.twin.feedback import FRAMES_HZ
from strands_actors.drivers.kinova.twin.sessions import BaseSession, Second
from tests.drivers.common.memory_port import MemoryPort, Permission, virtual

from .rig import Rig

STEP_RAD = 0.02
STOPS_WITHIN_S = 1.5
REACHES_WITHIN_S = 1.25
"""The time that remains for a wire without a link."""


def all_safe(reports: tuple[MotorReport, ...]) -> bool:
    return len(reports) == 7 and all(report.safe and report.acknowledged for report in reports)


async def moving(rig: Rig) -> Rig:
    await rig.armed()
    await rig.go(0, STEP_RAD)
    await trio.sleep(0.04)
    assert rig.velocity > 0.05
    rig.received.clear()
    return rig


def refuse(base: Base, why: SubError, *calls: Call) -> None:
    """Make the base refuse these calls."""
    obey = base._call

    def refusing(session: BaseSession, request: Frame) -> bytes:
        if request.call in calls:
            raise CallFailed(why)
        return obey(session, request)

    base._call = refusing  # type: ignore[method-assign]


# -- by the wire


def test_a_stop_leaves_before_anything_is_waited_for_and_is_seen_to_work() -> None:
    async def main() -> None:
        rig = await moving(Rig())
        began_s = trio.current_time()
        reports = await rig.stop()
        assert rig.received[0][0] == began_s and rig.received[0][1].call == Call.STOP
        assert all_safe(reports)
        assert [report.axis for report in reports] == list(rig.driver.axes)
        assert rig.velocity < 0.01
        assert trio.current_time() - began_s < 0.4

    virtual(main)


def test_after_a_hold_the_next_target_is_led_to_from_where_the_arm_is() -> None:
    async def main() -> None:
        rig = await moving(Rig())
        assert all_safe(await rig.stop("hold"))
        rig.received.clear()
        for _ in range(8):
            assert (await rig.period()).faults == {}, "no target is left that could expire"
        assert rig.stops() == []
        await rig.go(0, STEP_RAD)
        assert len(rig.speeds()) == 1
        await rig.period()

    virtual(main)


def test_saf_005_a_stop_that_is_lost_is_sent_again() -> None:
    async def main() -> None:
        rig = await moving(Rig())
        rig.deaf = {Call.STOP}

        async def hear_again() -> None:
            await trio.sleep(0.2)
            rig.deaf = set()

        async with trio.open_nursery() as nursery:
            nursery.start_soon(hear_again)
            assert all_safe(await rig.stop())
        assert 6 < len(rig.stops()) < 12
        assert Call.APPLY_EMERGENCY_STOP not in rig.calls()

    virtual(main)


@pytest.mark.parametrize("late_s", [0.03, 0.06, 0.15])
def test_a_stop_whose_answers_are_late_is_confirmed_all_the_same(late_s: float) -> None:
    async def main() -> None:
        rig = await moving(Rig())
        rig.delay_s = lambda call: late_s
        began_s = trio.current_time()
        assert all_safe(await rig.stop())
        assert trio.current_time() - began_s < STOPS_WITHIN_S
        await trio.sleep(0.2)
        rig.delay_s = lambda call: 0.001
        for _ in range(8):
            await rig.period()
        assert rig.awaited() <= set(rig.wire.session.requested_ns), "no answer to a stop is awaited any more"

    virtual(main)


def test_saf_005_an_unanswered_stop_is_not_safe_and_is_repeated() -> None:
    """A base that comes back must not find a remaining emergency stop either."""

    async def main() -> None:
        rig = await moving(Rig())
        rig.silent = True
        began_s = trio.current_time()
        reports = await rig.stop()
        assert trio.current_time() - began_s < STOPS_WITHIN_S
        assert all(report.written and not report.safe and report.detail for report in reports)
        assert Call.APPLY_EMERGENCY_STOP not in rig.calls()
        rig.silent, count = False, len(rig.stops())
        await rig.period()
        await rig.period()
        assert len(rig.stops()) > count

    virtual(main)


def test_a_base_that_refuses_the_stop_is_stopped_by_its_emergency_stop() -> None:
    async def main() -> None:
        rig = await moving(Rig())
        base = rig.twin.base
        refuse(base, SubError.METHOD_FAILED, Call.STOP)
        reports = await rig.stop()
        assert rig.calls().count(Call.APPLY_EMERGENCY_STOP) == 1
        assert all_safe(reports) and base.state is ArmState.IN_FAULT

    virtual(main)


def test_saf_005_an_arm_that_does_not_obey_is_reported_by_joint() -> None:
    async def main() -> None:
        rig = await moving(Rig())
        rig.twin.base.halt = lambda: None  # type: ignore[method-assign]
        began_s = trio.current_time()
        reports = await rig.stop()
        assert trio.current_time() - began_s < STOPS_WITHIN_S
        assert [report.axis for report in reports if not report.safe] == ["joint_1"]
        assert reports[0].detail == "moves" and reports[0].acknowledged
        assert [report.axis for report in reports if report.target is None] == ["joint_1"], (
            "this joint has no hold position"
        )
        assert Call.APPLY_EMERGENCY_STOP not in rig.calls(), (
            "the stop was not refused, so no emergency stop is needed"
        )

    virtual(main)


def test_saf_005_feedback_that_stands_still_proves_no_standstill() -> None:
    """The feedback shows an arm at rest, but the arm turns."""

    async def main() -> None:
        rig = await Rig().armed()
        rig.twin.set_fault(Fault.STUCK)
        rig.twin.base.halt = lambda: None  # type: ignore[method-assign]
        await rig.go(0, STEP_RAD)
        began_s = trio.current_time()
        reports = await rig.stop()
        assert rig.velocity > 0.3
        assert trio.current_time() - began_s < STOPS_WITHIN_S
        assert all(report.written and report.acknowledged and not report.safe for report in reports)
        assert {(report.detail, report.target) for report in reports} == {("its feedback stands still", None)}
        rig.twin.set_fault(Fault.OK)
        reports = await rig.stop()
        assert [report.axis for report in reports if not report.safe] == ["joint_1"], (
            "the measured velocity counts again"
        )

    virtual(main)


def test_a_stop_is_confirmed_while_the_numbers_of_the_base_start_again() -> None:
    async def main() -> None:
        rig = await moving(Rig())
        base = rig.twin.base
        base._woken_s = base.now_s() - FRAME_NUMBERS / FRAMES_HZ + 0.03
        before = base.feedback().frame
        assert all_safe(await rig.stop())
        assert base.feedback().frame < before

    virtual(main)


@pytest.mark.parametrize("step", [STEP_RAD, -STEP_RAD])
def test_saf_011_a_hold_reports_its_position(step: float) -> None:
    """The report has the hold position, and not the position when the hold was sent. It also works across the
    seam at 0 degrees."""

    async def main() -> None:
        rig = await Rig().armed()
        for _ in range(4):
            await rig.go(0, step)
            await rig.period()
        before = (await rig.wire.read()).position
        reports = await rig.stop("hold")
        assert all_safe(reports)
        held = [report.target for report in reports]
        rig.twin.base.advance()
        start = (0.0, *before[1:])
        assert held == pytest.approx([rig.twin.base.plant.position_rad[0], *start[1:]], abs=1e-3)
        assert abs(rig.twin.base.plant.position_rad[0] - before[0]) > 0.01, "the joint moved on while it braked"
        await trio.sleep(0.2)
        seen = (await rig.wire.read()).position
        assert held == pytest.approx(seen, abs=1e-3)
        rig.received.clear()
        rig.target = tuple(rad for rad in held if rad is not None)
        for _ in range(20):
            await rig.period()
        assert (await rig.wire.read()).position == pytest.approx(seen, abs=2e-3)

    virtual(main)


def test_a_base_in_fault_at_rest_is_safe_although_it_refuses_stops() -> None:
    async def main() -> None:
        rig = await Rig().armed()
        base = rig.twin.base
        base.set_state(ArmState.IN_FAULT)
        refuse(base, SubError.ROBOT_IN_FAULT, Call.STOP, Call.APPLY_EMERGENCY_STOP)
        reports = await rig.stop()
        assert all(report.safe for report in reports)

    virtual(main)


def test_a_missing_connection_is_reported() -> None:
    async def main() -> None:
        rig = Rig()
        reports = await rig.stop()
        assert {report.detail for report in reports} == {"not connected"}
        await rig.armed()
        rig.ports[0].unplugged = True
        reports = await rig.stop()
        assert not any(report.written for report in reports) and "the port is gone" in reports[0].detail

    virtual(main)


# -- by the wire without a link


def test_saf_020_a_stop_is_written_on_the_lost_connection_before_any_request() -> None:
    async def main() -> None:
        rig = await moving(Rig())
        rig.silent = True
        began_s = trio.current_time()
        reports = await rig.wire.reach("stop")
        assert rig.stops()[0] == began_s
        assert trio.current_time() - began_s < REACHES_WITHIN_S
        assert all(report.written and not report.safe for report in reports)
        assert Call.CREATE_SESSION in rig.calls(), "the wire also tried a new session"
        rig.silent = False
        assert all_safe(await rig.wire.reach("stop")), "a second stop on the same connection is confirmed, too"

    virtual(main)


def test_saf_020_a_dead_connection_is_replaced_for_a_stop() -> None:
    async def main() -> None:
        rig = await moving(Rig())
        rig.ports[0].unplugged = True
        assert all_safe(await rig.wire.reach("stop"))
        assert rig.calls()[:2] == [Call.CREATE_SESSION, Call.STOP]
        assert rig.ports[1].closed and rig.velocity < 0.01
        assert all_safe(await rig.wire.reach("stop")), "every further stop is confirmed, too"

    virtual(main)


def test_a_stop_before_there_ever_was_a_link() -> None:
    async def main() -> None:
        rig = Rig()
        assert all_safe(await rig.wire.reach("stop"))
        assert rig.wire.handover() == ()

    virtual(main)


# -- by the stop channel


@asynccontextmanager
async def served(channel: KinovaStopChannel) -> AsyncIterator[KinovaStopChannel]:
    async with trio.open_nursery() as nursery:
        await nursery.start(channel.serve)
        yield channel
        nursery.cancel_scope.cancel()
    channel.close()


def wires(rig: Rig, channel: KinovaStopChannel) -> None:
    """Give the channel the wire's connection, as the descriptors would."""
    session = rig.wire.session
    page = Page(session.client.page._memory)
    channel._wires = KortexClient(rig.ports[0], "the wire's", rig.clock, page)


@pytest.mark.parametrize("second", Second)
def test_saf_003_every_base_is_stopped_without_the_wire(second: Second) -> None:
    async def main() -> None:
        rig = Rig(second=second)
        await rig.wire.open()
        channel = rig.stop_channel()
        wires(rig, channel)
        async with served(channel):
            await rig.wire.arm(Permission())
            await rig.go(0, STEP_RAD)
            await trio.sleep(0.1)  # the wire is dead, the arm goes on
            assert rig.velocity > 0.3
            last = max(frame.message for _, frame in rig.received if frame.session == 1)
            rig.received.clear()
            began_s = trio.current_time()
            reports = await channel.make_safe("stop")
            assert next(frame.message for _, frame in rig.received if frame.session == 1) == last + 1
            assert rig.stops() == [began_s] * (1 if second is Second.REFUSED else 2)
            assert all_safe(reports), reports
            assert rig.velocity < 0.01
            assert rig.twin.base.state is ArmState.SERVOING_READY, "no emergency stop was needed"
            await trio.sleep(0.01)
            assert rig.twin.base.sessions.open == {}, "the base has a free session for the next wire"

    virtual(main)


class SlowStream:
    """A connection on which everything arrives late and in order."""

    def __init__(self, port: MemoryPort, late_s: float) -> None:
        self._port = port
        self._late_s = late_s
        self._waiting: deque[tuple[float, bytes]] = deque()
        self.read, self.close, self.take = port.read, port.close, port.take

    def write(self, data: bytes) -> None:
        self._waiting.append((trio.current_time() + self._late_s, data))

    async def deliver(self) -> None:
        while True:
            await trio.sleep(0.001)
            while self._waiting and self._waiting[0][0] <= trio.current_time():
                data = self._waiting.popleft()[1]
                if self._port.closed:
                    list(self._port.peer(data))  # it has left, and still arrives
                else:
                    self._port.write(data)

    def reset_if_stalled(self) -> bool:
        """Return False, as for a connection whose bytes the system of the base has acknowledged."""
        return False

    def reset(self) -> None:
        self._waiting.clear()


def test_saf_021_speeds_that_wait_on_the_wires_connection_are_not_overtaken_by_a_confirmed_stop() -> None:
    async def main() -> None:
        rig = Rig()
        await rig.wire.open()
        channel = rig.stop_channel()
        async with served(channel), trio.open_nursery() as nursery:
            await rig.wire.arm(Permission())
            slow = SlowStream(rig.ports[0], 0.2)
            session = rig.wire.session
            nursery.start_soon(slow.deliver)
            client = KortexClient(slow, "the wire's", rig.clock, Page(session.client.page._memory))  # type: ignore[arg-type]
            channel._wires = session.client = client
            await rig.go(0, STEP_RAD)  # then the wire process ends
            began_s = trio.current_time()
            reports = await channel.make_safe("stop")
            assert all_safe(reports), reports
            (_, frame), moved_s = rig.speeds()[-1], rig.speeds()[-1][0]
            assert frame.call == Call.SEND_JOINT_SPEEDS and moved_s >= began_s + 0.2, "the speeds arrived late"
            assert rig.stops()[-1] > moved_s and rig.velocity < 0.01
            await trio.sleep(1.0)
            assert rig.velocity < 0.01
            nursery.cancel_scope.cancel()

    virtual(main)


@pytest.mark.parametrize("by", ["the root", "the wire"])
def test_saf_021_speeds_that_wait_longer_than_a_stop_are_dropped_before_it_is_confirmed(by: str) -> None:
    """The base confirms the stop in another session, and reads the wire's connection only later."""

    async def main() -> None:
        rig = await Rig().armed()
        slow = SlowStream(rig.ports[0], 3.0)
        session = rig.wire.session
        client = KortexClient(slow, "the wire's", rig.clock, Page(session.client.page._memory))  # type: ignore[arg-type]
        session.client = client
        async with served(rig.stop_channel()) as channel, trio.open_nursery() as nursery:
            nursery.start_soon(slow.deliver)
            await rig.wire.write((STEP_RAD, *session.position[1:]), Permission())
            if by == "the root":
                channel._wires = client
                reports = await channel.make_safe("stop")
            else:
                reports = await rig.wire.reach("stop")
            assert all_safe(reports), reports
            stops = len(rig.stops())
            await trio.sleep(4.0)
            assert rig.speeds() == [] and rig.velocity < 1e-9
            assert stops == 2, "the arm is stopped again after the reset"
            nursery.cancel_scope.cancel()

    virtual(main)


def test_the_stop_channels_session_is_kept_alive_beyond_the_bases_timeout() -> None:
    async def main() -> None:
        rig = await Rig().armed()
        async with served(rig.stop_channel()) as channel:
            await trio.sleep(10.0)
            assert rig.calls().count(Call.KEEP_ALIVE) > 15
            rig.received.clear()
            assert all_safe(await channel.make_safe("stop"))
            assert Call.CREATE_SESSION not in rig.calls()

    virtual(main)


def test_a_question_that_is_still_open_does_not_keep_the_stop_waiting() -> None:
    async def main() -> None:
        rig = await Rig().armed()
        async with served(rig.stop_channel()) as channel:
            rig.silent = True
            await trio.sleep(0.6)  # it waits for the answer to a keepalive
            rig.silent = False
            rig.received.clear()
            assert all_safe(await channel.make_safe("stop"))
            await trio.sleep(2.0)
            assert {Call.CREATE_SESSION, Call.KEEP_ALIVE}.isdisjoint(rig.calls())

    virtual(main)


def test_a_lost_session_of_the_stop_channel_is_replaced() -> None:
    async def main() -> None:
        rig = await Rig().armed()
        async with served(rig.stop_channel()) as channel:
            rig.ports[1].unplugged = True
            await trio.sleep(2.0)
            assert len(rig.ports) == 3
            assert all_safe(await channel.make_safe("stop"))

    virtual(main)


def test_without_any_way_the_link_does_not_count_as_up() -> None:
    async def main() -> None:
        rig = await Rig(second=Second.REFUSED).armed()
        with pytest.raises(ExceptionGroup) as failure:
            async with served(rig.stop_channel()):
                pass
        assert failure.group_contains(WireDown, match="METHOD_FAILED")

    virtual(main)


def test_a_channel_that_is_needed_before_it_is_ready_logs_in_and_stops() -> None:
    async def main() -> None:
        rig = await moving(Rig())
        channel = rig.stop_channel()
        assert all_safe(await channel.make_safe("stop"))
        async with trio.open_nursery() as nursery:
            await nursery.start(channel.serve)  # it is cancelled already: returns after ``started``
        channel.close()

    virtual(main)


def test_a_stop_may_be_requested_repeatedly() -> None:
    """The root writes before it fences the wire, is cancelled, and writes again, until every joint has
    confirmed."""

    async def main() -> None:
        rig = await moving(Rig())
        channel = rig.stop_channel()
        wires(rig, channel)
        async with served(channel):
            rig.received.clear()
            with trio.move_on_after(0.01):
                await channel.make_safe("stop")
            assert len(rig.stops()) == 2
            for _ in range(3):
                assert all_safe(await channel.make_safe("stop"))
            rig.ports[-1].unplugged = True
            assert all_safe(await channel.make_safe("stop"))

    virtual(main)


def test_a_session_that_was_forgotten_is_replaced() -> None:
    async def main() -> None:
        rig = await moving(Rig())
        async with served(rig.stop_channel()) as channel:
            rig.twin.base.sessions.open.clear()
            assert all_safe(await channel.make_safe("stop"))
            assert Call.APPLY_EMERGENCY_STOP not in rig.calls()

    virtual(main)


def test_a_dead_network_is_reported_within_the_time_of_a_stop() -> None:
    async def main() -> None:
        rig = await moving(Rig())
        async with served(rig.stop_channel()) as channel:
            rig.ports[1].unplugged = True

            async def nobody(host: str, port: int) -> None:
                raise WireDown("192.0.2.10:10000: cannot connect")

            channel._open_stream = nobody  # type: ignore[assignment]
            began_s = trio.current_time()
            reports = await channel.make_safe("stop")
            assert trio.current_time() - began_s < STOPS_WITHIN_S
            assert not any(report.safe for report in reports)
            assert "cannot connect" in reports[0].detail

    virtual(main)
