"""Test the stops of the wire, after a lost link, and of the stop channel. The tests run in virtual time over
rosbridge in memory."""

from __future__ import annotations

import pytest
import trio

from strands_actors.contract.wire import WireDown
from strands_actors.drivers.common.kit.reporting_base import TIMES
from strands_actors.drivers.common.twin import Fault
from strands_actors.drivers.yahboom import messages as m
from strands_actors.drivers.yahboom.stop import STOP_S
from tests.drivers.common.memory_port import Permission, virtual
from tests.drivers.yahboom.rig import World

from .rig import all_safe, msgs, running, served, target

# -- stops


def test_saf_005_a_stop_is_zero_three_times_and_confirmed_by_newer_odometry() -> None:
    async def test() -> None:
        world = World()
        async with running(world) as wire:
            await wire.write(target(world, linear_x=1.0), Permission())
            await trio.sleep(0.25)
            began_s, told = trio.current_time(), len(world.taken)
            reports = await wire.make_safe("zero")
            assert all_safe(reports)
            after = world.taken[told:]
            assert after[0] == (began_s, "safe", after[0].text, 0), (
                "zero is sent at once, on the connection of the setpoint"
            )
            assert world.kinds("safe").count("safe") >= TIMES
            assert max(map(abs, world.twin.mechanism.runs)) < 1e-9, "the base stands when the stop is confirmed"

    virtual(test)


def test_saf_005_a_base_that_moves_on_is_not_reported_as_stopped() -> None:
    async def test() -> None:
        world = World()
        async with running(world) as wire:
            world.twin.set_fault(Fault.WRONG)
            began_s = trio.current_time()
            reports = await wire.make_safe("zero")
            assert not any(report.safe for report in reports)
            assert "not confirmed: it reports speed 0.5, 0, 0" in reports[0].detail
            assert trio.current_time() - began_s == pytest.approx(STOP_S, abs=0.01)
            assert world.kinds("safe").count("safe") > 10

    virtual(test)


@pytest.mark.parametrize("answer_s", [0.05, 0.3, 0.8])
def test_saf_005_slow_answers_confirm_late_and_hold_no_zero_up(answer_s: float) -> None:
    async def test() -> None:
        world = World()
        async with running(world) as wire:
            await wire.write(target(world, linear_x=1.0), Permission())
            await trio.sleep(0.1)
            world.answer_s = answer_s
            began_s = trio.current_time()
            assert all_safe(await wire.make_safe("zero"))
            assert answer_s < trio.current_time() - began_s < max(0.1, answer_s) + 0.15
            zeros = [one.t_s - began_s for one in world.taken if one.kind == "safe"]
            assert zeros[0] == 0.0 and zeros[2] == pytest.approx(0.1, abs=0.001)

    virtual(test)


def test_saf_005_odometry_of_before_the_zero_confirms_nothing() -> None:
    """Reports that were under way when the bridge took the zero show a base at rest before its command to move."""

    async def test() -> None:
        world = World(watchdog_s=0)
        async with running(world) as wire:
            world.answer_s = 0.2  # reports of rest go on arriving for this time
            await trio.sleep(0.01)
            await wire.write(target(world, linear_x=1.0), Permission())
            await trio.sleep(0.1)
            began_s = trio.current_time()
            assert all_safe(await wire.make_safe("zero"))
            assert trio.current_time() - began_s > 0.2
            assert world.twin.mechanism.runs == m.REST

    virtual(test)


def test_saf_005_a_bridge_without_services_confirms_nothing_and_is_not_flooded() -> None:
    async def test() -> None:
        world = World()
        async with running(world) as wire:
            world.denies = True
            reports = await wire.make_safe("zero")
            assert {(one.written, one.acknowledged, one.safe) for one in reports} == {(True, False, False)}
            assert "/rosapi/get_time failed" in reports[0].detail
            assert len(world.taken) < 3 * STOP_S / 0.05

    virtual(test)


def test_saf_005_odometry_with_an_old_stamp_confirms_nothing() -> None:
    async def test() -> None:
        world = World()
        async with running(world) as wire:
            world.twin.set_fault(Fault.STUCK)
            reports = await wire.make_safe("zero")
            assert "not confirmed: it has reported nothing since" in reports[0].detail

    virtual(test)


def test_saf_005_without_odometry_a_stop_is_acknowledged_and_not_confirmed() -> None:
    async def test() -> None:
        world = World()
        async with running(world) as wire:
            world.mute.add(m.ODOMETRY)
            reports = await wire.make_safe("zero")
            assert {(one.written, one.acknowledged, one.safe) for one in reports} == {(True, True, False)}
            assert "reported nothing since" in reports[0].detail

    virtual(test)


def test_saf_010_a_command_in_a_frozen_bridge_is_followed_by_zero() -> None:
    async def test() -> None:
        world = World()
        async with running(world) as wire:
            world.frozen = True
            await wire.write(target(world, linear_x=0.9), Permission())
            reports = await wire.make_safe("zero")
            assert not any(report.safe or report.acknowledged for report in reports)
            assert all(report.written for report in reports)
            assert world.kinds() == []
            world.thaw()
            assert world.kinds()[:2] == ["setpoint", "safe"]
            assert "setpoint" not in world.kinds()[1:]
            assert all_safe(await wire.make_safe("zero"))

    virtual(test)


def test_saf_020_a_lost_link_is_reached_on_a_new_connection_without_asking() -> None:
    async def test() -> None:
        world = World()
        wire = world.wire()
        await wire.open()
        world.sockets[0].close()
        world.taken.clear()
        began_s = trio.current_time()
        assert all_safe(await wire.reach("zero"))
        first = next(one for one in world.taken if one.kind != "other")
        assert first.kind in ("safe", "read") and first.connection == 1
        zero = next(one for one in world.taken if one.kind == "safe")
        assert zero.t_s - began_s < 0.01
        assert not any("rosapi" in one.text for one in world.taken[: world.taken.index(zero)])

    virtual(test)


def test_saf_020_a_stop_also_uses_a_second_connection_if_the_first_is_dead() -> None:
    async def test() -> None:
        world = World()
        wire = world.wire()
        await wire.open()
        world.frozen = True
        await wire.write(target(world, linear_x=0.9), Permission())
        world.frozen = False
        world.sockets[0].take_waiting = lambda: None  # type: ignore[method-assign]
        reports = await wire.reach("zero")
        assert all_safe(reports)
        assert not world.sockets[0].is_open, "the command that waits on the first connection is dropped"
        zeros = [one for one in world.taken if one.kind == "safe"]
        assert {one.connection for one in zeros} == {1}
        assert len(zeros) >= 2 * TIMES, "the base is stopped again after the first connection is reset"
        wire.close()
        assert not any(socket.is_open for socket in world.sockets)

    virtual(test)


def test_saf_020_without_any_way_it_is_a_report_of_failures() -> None:
    async def test() -> None:
        world = World()
        wire = world.wire()
        await wire.open()
        world.gone = True
        reports = await wire.reach("zero")
        assert {(one.written, one.safe) for one in reports} == {(False, False)}
        assert "cannot connect" in reports[0].detail

    virtual(test)


def test_an_arm_on_its_way_is_named_with_how_long_it_goes_on_and_keeps_its_goal() -> None:
    async def test() -> None:
        world = World()
        async with running(world) as wire:
            await wire.write(target(world, arm1=0.5, time_ms=3000), Permission())
            reports = {report.axis: report for report in await wire.make_safe("zero")}
            assert "for 2." in reports["arm1"].detail and "cannot be stopped" in reports["arm1"].detail
            assert reports["linear.x"].detail == ""
            assert (reports["arm1"].target, reports["arm2"].target) == (0.5, 0.0), (
                "SAF-019: the hold position is the last goal"
            )
            await trio.sleep(3.0)
            assert all(report.detail == "" for report in await wire.make_safe("zero"))

    virtual(test)


# -- the stop channel


def test_saf_003_the_stop_channel_is_connected_before_and_its_zero_leaves_at_once() -> None:
    async def test() -> None:
        world = World()
        channel = world.stop_channel()
        async with served(channel):
            assert world.kinds() == []
            world.taken.clear()
            began_s = trio.current_time()
            assert all_safe(await channel.make_safe("zero"))
            assert (world.taken[0].t_s, world.taken[0].kind) == (began_s, "safe")
            assert not msgs(world, m.ARM)
        channel.close()
        assert not any(socket.is_open for socket in world.sockets)

    virtual(test)


def test_saf_003_the_stop_channel_reconnects_after_a_loss() -> None:
    async def test() -> None:
        world = World()
        channel = world.stop_channel()
        async with served(channel):
            world.sockets[0].close()
            await trio.sleep(0.5)
            assert [socket.is_open for socket in world.sockets] == [False, True]
            world.taken.clear()
            await channel.make_safe("zero")
            assert {one.connection for one in world.taken} == {1}

    virtual(test)


def test_saf_003_a_stop_does_not_wait_for_a_connection_to_be_kept_again() -> None:
    async def test() -> None:
        world = World()
        channel = world.stop_channel()
        async with served(channel):
            await trio.sleep(0.1)
            world.sockets[0].close()
            await trio.sleep(0.01)
            began_s = trio.current_time()
            assert all_safe(await channel.make_safe("zero"))
            zero = next(one for one in world.taken if one.kind == "safe")
            assert zero.t_s - began_s < 0.05

    virtual(test)


def test_without_the_robot_the_stop_channel_does_not_stand() -> None:
    async def test() -> None:
        world = World()
        world.gone = True
        channel = world.stop_channel()
        with pytest.raises(BaseExceptionGroup) as failed:
            async with served(channel):
                pass
        assert failed.group_contains(WireDown, match="cannot connect")

    virtual(test)
