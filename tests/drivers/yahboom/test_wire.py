"""The wire and the stop channel in virtual time, over rosbridge in memory: what leaves, when,
and what is confirmed."""

from __future__ import annotations

import json
import math
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Any

import pytest
import trio

from strands_actors.contract.wire import MotorReport, PermitDenied, StopChannel, Wire, WireDown
from strands_actors.drivers.common.reporting_base import TIMES
from strands_actors.drivers.common.twin import Fault
from strands_actors.drivers.yahboom import messages as m
from strands_actors.drivers.yahboom.rosbridge import MOST_OWED
from strands_actors.drivers.yahboom.stop import STOP_S
from strands_actors.drivers.yahboom.wire import QUIET_S, SILENT_S, YahboomWire
from tests.drivers.common.memory_port import Permission, virtual
from tests.drivers.yahboom.rig import NOW_NS, World, state

NAN = math.nan


@asynccontextmanager
async def served(wire: Wire | StopChannel) -> AsyncIterator[None]:
    async with trio.open_nursery() as nursery:
        await nursery.start(wire.serve)
        yield
        nursery.cancel_scope.cancel()


@asynccontextmanager
async def running(world: World) -> AsyncIterator[YahboomWire]:
    """A wire that is open, served and armed."""
    wire = world.wire()
    await wire.open()
    async with served(wire):
        await wire.arm(Permission())
        world.taken.clear()
        yield wire
    wire.close()


def target(world: World, now_ns: int = NOW_NS, **action: float) -> tuple[float, ...]:
    """What an action comes to on an arm that is at zero."""
    named = {
        key.replace("_x", ".x").replace("_y", ".y").replace("_z", ".z"): value for key, value in action.items()
    }
    candidate = world.driver.parse(named, state(now_ns=now_ns))
    return candidate.values  # type: ignore[union-attr]


def msgs(world: World, topic: str) -> list[dict[str, Any]]:
    sent = [json.loads(one.text) for one in world.taken]
    return [one["msg"] for one in sent if one["op"] == "publish" and one["topic"] == topic]


def all_safe(reports: tuple[MotorReport, ...]) -> bool:
    assert [report.axis for report in reports] == [
        "linear.x", "linear.y", "angular.z", "arm1", "arm2", "arm3", "arm4", "arm5", "gripper",
    ]  # fmt: skip
    return all(report.safe for report in reports)


# -- connecting


def test_connecting_checks_listens_and_commands_nothing() -> None:
    async def test() -> None:
        world = World()
        wire = world.wire()
        facts = await wire.open()
        assert facts["rosbridge"] == "ws://192.0.2.1:9090"
        assert facts["joints"] == "reported"
        assert world.kinds() == []
        observation = await wire.read()
        assert observation.position[4] == pytest.approx(math.radians(30)), "home, as it is measured"
        assert all(observation.stamp_ns)

    virtual(test)


def test_saf_011_an_arm_that_is_not_reported_is_not_known() -> None:
    async def test() -> None:
        world = World(joints=False)
        async with running(world) as wire:
            observation = await wire.read()
            assert [math.isnan(value) for value in observation.position] == [False] * 3 + [True] * 6
            assert observation.stamp_ns[3:] == (0,) * 6
            first = world.driver.first_target(observation)
            assert first[:3] == (0.0, 0.0, 0.0)

    virtual(test)


def test_a_joint_topic_on_which_nobody_publishes_is_not_waited_for() -> None:
    async def test() -> None:
        world = World()
        world.mute.add(m.JOINT_STATES)
        wire = world.wire()
        await wire.open()
        assert trio.current_time() < 1.0
        assert math.isnan((await wire.read()).position[3])

    virtual(test)


def test_joints_that_fall_silent_are_not_known_any_more() -> None:
    async def test() -> None:
        world = World()
        async with running(world) as wire:
            world.mute.add(m.JOINT_STATES)
            await trio.sleep(SILENT_S + 0.1)
            observation = await wire.read()
            assert math.isnan(observation.position[3]) and not math.isnan(observation.position[0])

    virtual(test)


@pytest.mark.parametrize("topic", [m.CMD_VEL, m.ARM, m.ODOMETRY])
def test_saf_014_a_robot_without_its_topics_is_refused(topic: str) -> None:
    async def test() -> None:
        for kind, why in ((None, "there is no topic"), ("std_msgs/String", "is a std_msgs/String, not a")):
            world = World()
            types = {name: known for name, known in world.twin.graph.types.items() if name != topic}
            world.twin.graph.types = types if kind is None else {**types, topic: kind}
            with pytest.raises(WireDown, match=why):
                await world.wire().open()
            assert world.kinds() == []

    virtual(test)


def test_saf_012_without_odometry_there_is_no_connection() -> None:
    async def test() -> None:
        world = World(driver={"timeout_s": 2.0})
        world.mute.add(m.ODOMETRY)
        with pytest.raises(WireDown, match="no odometry within 2 s"):
            await world.wire().open()
        assert trio.current_time() == pytest.approx(2.0, abs=0.1)
        assert not any(socket.is_open for socket in world.sockets)

    virtual(test)


def test_a_bridge_that_answers_nothing_is_given_up_in_time() -> None:
    async def test() -> None:
        world = World(driver={"timeout_s": 3.0})
        world.frozen = True
        with pytest.raises(WireDown, match="no answer within 3 s"):
            await world.wire().open()
        assert not any(socket.is_open for socket in world.sockets)

    virtual(test)


def test_saf_012_odometry_that_does_not_come_any_more_is_a_lost_link() -> None:
    async def test() -> None:
        world = World()
        async with running(world) as wire:
            world.frozen = True
            await trio.sleep(SILENT_S - 0.1)
            seen = await wire.read()
            assert trio.current_time() - seen.t_ns / 1e9 == pytest.approx(SILENT_S - 0.1, abs=0.05)
            await trio.sleep(0.2)
            with pytest.raises(WireDown, match=r"odometry has for 0\.7 s not come"):
                await wire.read()

    virtual(test)


# -- commands


def test_arming_is_a_zero_that_the_permit_allows() -> None:
    async def test() -> None:
        world = World()
        wire = world.wire()
        await wire.open()
        with pytest.raises(PermitDenied):
            await wire.arm(Permission(denied_at=0))
        assert world.kinds() == []
        await wire.arm(Permission())
        assert world.kinds() == ["safe"]

    virtual(test)


def test_saf_001_nothing_leaves_without_a_permit() -> None:
    async def test() -> None:
        world = World()
        async with running(world) as wire:
            with pytest.raises(PermitDenied):
                await wire.write(target(world, linear_x=0.5, arm1=0.1), Permission(denied_at=0))
            assert world.kinds() == []

    virtual(test)


def test_a_twist_is_written_each_time_and_an_arm_goal_once() -> None:
    async def test() -> None:
        world = World()
        async with running(world) as wire:
            both = target(world, linear_x=0.5, arm1=0.1)
            for _ in range(3):
                await wire.write(both, Permission())
                await trio.sleep(0.02)
            assert [one["linear"]["x"] for one in msgs(world, m.CMD_VEL)] == [0.5] * 3
            assert msgs(world, m.ARM) == [
                {"joint1": 96, "joint2": 90, "joint3": 90, "joint4": 90, "joint5": 90, "joint6": 180, "time": 1500}
            ]
            await trio.sleep(0.02)
            await wire.write(target(world, NOW_NS + 1000, arm1=0.1), Permission())
            assert len(msgs(world, m.ARM)) == 2, "the same action, given anew, is written anew"

    virtual(test)


def test_saf_010_a_bridge_that_takes_nothing_is_sent_a_few_commands_and_no_more() -> None:
    async def test() -> None:
        world = World()
        async with running(world) as wire:
            world.frozen = True
            written = 0
            for at in range(20):
                try:
                    await wire.write(target(world, NOW_NS + at, linear_x=0.5), Permission())
                    written += 1
                except PermitDenied:
                    await trio.sleep(0.0005)
            assert written == MOST_OWED
            world.thaw()
            await trio.sleep(0.02)
            await wire.write(target(world, linear_x=0.5), Permission())
            assert world.kinds() == ["setpoint"] * (MOST_OWED + 1)

    virtual(test)


def test_an_answer_that_is_lost_holds_nothing_up_once_a_later_one_came() -> None:
    async def test() -> None:
        world = World()
        async with running(world) as wire:
            world.loses = True  # every second answer
            for at in range(40):
                await wire.write(target(world, NOW_NS + at, linear_x=0.5), Permission())
                await trio.sleep(0.05)
            assert world.kinds() == ["setpoint"] * 40

    virtual(test)


def test_saf_010_a_robot_that_is_silent_is_sent_nothing() -> None:
    async def test() -> None:
        world = World()
        async with running(world) as wire:
            world.mute.add(m.ODOMETRY)
            await trio.sleep(QUIET_S + 0.05)
            with pytest.raises(PermitDenied, match="takes nothing now"):
                await wire.write(target(world, linear_x=0.5), Permission())
            world.mute.clear()
            await trio.sleep(0.05)
            await wire.write(target(world, linear_x=0.5), Permission())
            assert world.kinds() == ["setpoint"]

    virtual(test)


def test_the_arm_alone_leaves_the_base_to_others_and_the_base_the_arm() -> None:
    async def test() -> None:
        world = World(joints=False)
        async with running(world) as wire:
            await wire.write(target(world, arm1=0.1), Permission())
            assert (msgs(world, m.CMD_VEL), len(msgs(world, m.ARM))) == ([], 1)
            base = (0.2, 0.0, 0.0, *(NAN,) * 6, 0.0, 0.0, 1.0)
            await wire.write(base, Permission())
            assert (len(msgs(world, m.CMD_VEL)), len(msgs(world, m.ARM))) == (1, 1)

    virtual(test)


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
            assert after[0] == (began_s, "safe", after[0].text, 0), "at once, on the connection of the setpoint"
            assert world.kinds("safe").count("safe") >= TIMES
            assert world.twin.mechanism.runs == m.REST, "it stands when it is said to"

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
    """What was on its way when the bridge took the zero shows a base that stood before it was told
    to move."""

    async def test() -> None:
        world = World(watchdog_s=0)
        async with running(world) as wire:
            world.answer_s = 0.2  # odometry of rest goes on coming for so long
            await trio.sleep(0.01)
            await wire.write(target(world, linear_x=1.0), Permission())
            await trio.sleep(0.1)
            began_s = trio.current_time()
            assert all_safe(await wire.make_safe("zero"))
            assert trio.current_time() - began_s > 0.2
            assert world.twin.mechanism.runs == m.REST

    virtual(test)


def test_saf_005_a_bridge_whose_services_are_gone_confirms_nothing_and_is_not_flooded() -> None:
    async def test() -> None:
        world = World()
        async with running(world) as wire:
            world.denies = True
            reports = await wire.make_safe("zero")
            assert {(one.written, one.acknowledged, one.safe) for one in reports} == {(True, False, False)}
            assert "/rosapi/get_time says no" in reports[0].detail
            assert len(world.taken) < 3 * STOP_S / 0.05

    virtual(test)


def test_saf_005_odometry_with_an_old_stamp_confirms_nothing() -> None:
    async def test() -> None:
        world = World()
        async with running(world) as wire:
            world.twin.set_fault(Fault.STUCK)
            reports = await wire.make_safe("zero")
            assert "not confirmed: what it reports is old" in reports[0].detail

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


def test_saf_010_what_waits_in_a_frozen_bridge_is_followed_by_zero() -> None:
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


def test_saf_020_a_connection_that_is_dead_and_has_not_said_so_is_not_the_only_way() -> None:
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
        assert {one.connection for one in world.taken if one.kind == "safe"} == {1}
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
            assert "for 2." in reports["arm1"].detail and "cannot be told to stop" in reports["arm1"].detail
            assert reports["linear.x"].detail == ""
            assert (reports["arm1"].target, reports["arm2"].target) == (0.5, 0.0), "SAF-019: its last goal"
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


def test_saf_003_the_stop_channel_is_made_anew_after_a_loss() -> None:
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
