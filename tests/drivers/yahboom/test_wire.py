"""Test the wire in virtual time, over rosbridge in memory: the messages and their times."""

from __future__ import annotations

import math

import pytest
import trio

from strands_actors.contract.driver import Candidate
from strands_actors.contract.wire import PermitDenied, WireDown
from strands_actors.drivers.common.twin import Fault
from strands_actors.drivers.yahboom import messages as m
from strands_actors.drivers.yahboom import protocol as p
from strands_actors.drivers.yahboom.rosbridge import MAX_UNANSWERED
from strands_actors.drivers.yahboom.wire import QUIET_S, SILENT_S
from tests.drivers.common.memory_port import Permission, virtual
from tests.drivers.yahboom.rig import NOW_NS, World

from .rig import NAN, msgs, running, state, target

# -- connecting


def test_connecting_checks_and_reads_and_commands_nothing() -> None:
    async def test() -> None:
        world = World(joints=True)
        wire = world.wire()
        facts = await wire.open()
        assert facts["rosbridge"] == "ws://192.0.2.1:9090"
        assert facts["joints"] == "reported"
        assert world.kinds() == []
        observation = await wire.read()
        assert observation.position[4] == pytest.approx(math.radians(30)), (
            "the measured position is the home position"
        )
        assert all(observation.stamp_ns)

    virtual(test)


SIGNS = [-1.0, 1.0, -1.0, 1.0, -1.0]


def test_saf_011_a_joint_that_is_not_named_stays_whichever_way_it_turns() -> None:
    """A command has all six servos. The others get their reported positions."""

    async def test() -> None:
        world = World(driver={"joint_signs": SIGNS}, joints=True)
        async with running(world) as wire:
            wanted = {"arm1": 0.5, "arm2": -0.3, "arm3": 0.2, "arm4": 0.0, "arm5": 0.7, "gripper": -1.0}
            told = target(world, NOW_NS, **wanted, time_ms=200)
            await wire.write(told, Permission())
            await trio.sleep(1.0)
            degrees = [61, 73, 79, 90, 50, 83]  # 90 + sign x degrees; the gripper has no sign
            assert world.twin.mechanism.degrees == degrees, "the servos stand at these angles"
            observation = await wire.arm(Permission())
            assert observation.position[3:] == pytest.approx(list(wanted.values()), abs=math.radians(0.6))
            world.taken.clear()
            now_ns = NOW_NS + 1000
            begins = world.driver.first_target(observation)
            alone = world.driver.parse({"arm2": 0.1, "time_ms": 200}, state(begins, now_ns=now_ns))
            assert isinstance(alone, Candidate)
            await wire.write(alone.values, Permission())
            goal = msgs(world, m.ARM)[-1]
            assert [goal[f"joint{at}"] for at in range(1, 7)] == [61, 96, *degrees[2:]]

    virtual(test)


def test_the_twin_reports_its_servos_without_signs() -> None:
    """The positions have no signs. On a robot every client receives this topic."""

    async def test() -> None:
        world = World(driver={"joint_signs": SIGNS}, joints=True)
        world.twin.mechanism.degrees = [61.0, 73.0, 90.0, 90.0, 200.0, 180.0]
        told = world.twin.graph.message(m.JOINT_STATES)
        assert told["position"] == pytest.approx([math.radians(way) for way in (-29, -17, 0, 0, 110, 0)])

    virtual(test)


def test_saf_011_an_arm_without_a_report_has_no_known_position() -> None:
    async def test() -> None:
        world = World(joints=False)
        async with running(world) as wire:
            observation = await wire.read()
            assert [math.isnan(value) for value in observation.position] == [False] * 3 + [True] * 6
            assert observation.stamp_ns[3:] == (0,) * 6
            first = world.driver.first_target(observation)
            assert first[:3] == (0.0, 0.0, 0.0)

    virtual(test)


def test_connecting_does_not_wait_for_a_joint_topic_without_a_publisher() -> None:
    async def test() -> None:
        world = World(joints=True)
        world.mute.add(m.JOINT_STATES)
        wire = world.wire()
        await wire.open()
        assert trio.current_time() < 1.0
        assert math.isnan((await wire.read()).position[3])

    virtual(test)


def test_silent_joints_become_unknown() -> None:
    async def test() -> None:
        world = World(joints=True)
        async with running(world) as wire:
            world.mute.add(m.JOINT_STATES)
            await trio.sleep(SILENT_S + 0.1)
            observation = await wire.read()
            assert math.isnan(observation.position[3]) and not math.isnan(observation.position[0])

    virtual(test)


@pytest.mark.parametrize("topic", [m.CMD_VEL, m.ARM, m.ODOMETRY])
def test_saf_014_a_robot_without_its_topics_is_refused(topic: str) -> None:
    async def test() -> None:
        for kind, why in ((None, "the robot has no topic"), ("std_msgs/String", "is a std_msgs/String, not a")):
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


def test_a_bridge_without_answers_is_given_up_in_time() -> None:
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
            with pytest.raises(WireDown, match=r"no odometry has arrived for 0\.7 s"):
                await wire.read()

    virtual(test)


@pytest.mark.parametrize("at_once", [True, False])
def test_saf_012_odometry_that_repeats_itself_is_not_new_and_ends_the_link(at_once: bool) -> None:
    """Every socket is open and every answer arrives, but the base repeats its report."""

    async def test() -> None:
        world = World(driver={"timeout_s": 1.0})
        if at_once:
            world.twin.set_fault(Fault.STUCK)
            with pytest.raises(WireDown, match="odometry never changes its stamp within 1 s"):
                await world.wire().open()
            assert world.kinds() == []
            return
        async with running(world) as wire:
            world.twin.set_fault(Fault.STUCK)
            await trio.sleep(0.05)
            seen = await wire.read()
            await trio.sleep(SILENT_S - 0.1)
            again = await wire.read()
            assert again.t_ns == seen.t_ns == max(again.stamp_ns[:3])
            with pytest.raises(PermitDenied, match="receives no commands now"):
                await wire.write(target(world, linear_x=0.5), Permission())
            assert world.kinds() == []
            await trio.sleep(0.2)
            with pytest.raises(WireDown, match=r"odometry has not changed its stamp for 0\.\d s"):
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
            assert len(msgs(world, m.ARM)) == 2, "the same action is written again when it is given again"

    virtual(test)


def test_saf_010_a_bridge_that_reads_nothing_is_sent_only_a_few_commands() -> None:
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
            assert written == MAX_UNANSWERED
            world.thaw()
            await trio.sleep(0.02)
            await wire.write(target(world, linear_x=0.5), Permission())
            assert world.kinds() == ["setpoint"] * (MAX_UNANSWERED + 1)

    virtual(test)


def test_an_answer_that_was_not_requested_acknowledges_no_command() -> None:
    async def test() -> None:
        world = World()
        link = world.link()
        await link.open()
        world.frozen = True
        for _ in range(MAX_UNANSWERED):
            link.drive(m.Twist(0.1, 0.0, 0.0))
        (socket,) = world.sockets
        for number in (10**6, 0, 1):
            socket._say(p.response(p.CallService(p.TIME_SERVICE, id=str(number)), {}))
        async with trio.open_nursery() as nursery:
            nursery.start_soon(link.receive_messages)
            world.frozen = False
            await trio.sleep(0.05)
            assert link.is_behind, "the bridge has not read the commands"
            world.thaw()
            await trio.sleep(0.05)
            assert not link.has_unacknowledged
            nursery.cancel_scope.cancel()

    virtual(test)


def test_a_late_answer_to_a_call_that_was_given_up_is_not_kept() -> None:
    async def test() -> None:
        world = World()
        link = world.link()
        await link.open()
        world.frozen = True
        link.drive(m.Twist(0.1, 0.0, 0.0))
        with pytest.raises(WireDown, match="no answer within 20 ms"):
            await link.acknowledged(0.02)
        world.thaw()
        await link.acknowledged(0.5)
        assert not link.has_unacknowledged
        assert link._exchange.unanswered == 0 and not link._exchange._answers

    virtual(test)


def test_a_call_on_a_connection_that_is_replaced_fails_at_once() -> None:
    async def test() -> None:
        world = World()
        link = world.link()
        await link.open()
        world.frozen = True
        began_s = trio.current_time()

        async def wait() -> None:
            with pytest.raises(WireDown):
                await link.acknowledged(10.0)

        async with trio.open_nursery() as nursery:
            nursery.start_soon(wait)
            nursery.start_soon(wait)
            await trio.sleep(0.1)
            world.frozen = False
            nursery.start_soon(link.listen)
        assert trio.current_time() - began_s < 0.3
        link.close()

    virtual(test)


def test_a_lost_answer_delays_nothing_after_a_later_one() -> None:
    async def test() -> None:
        world = World()
        async with running(world) as wire:
            world.loses = True  # every second answer
            for at in range(40):
                await wire.write(target(world, NOW_NS + at, linear_x=0.5), Permission())
                await trio.sleep(0.05)
            assert world.kinds() == ["setpoint"] * 40

    virtual(test)


def test_saf_010_a_silent_robot_is_sent_nothing() -> None:
    async def test() -> None:
        world = World()
        async with running(world) as wire:
            world.mute.add(m.ODOMETRY)
            await trio.sleep(QUIET_S + 0.05)
            with pytest.raises(PermitDenied, match="receives no commands now"):
                await wire.write(target(world, linear_x=0.5), Permission())
            world.mute.clear()
            await trio.sleep(0.05)
            await wire.write(target(world, linear_x=0.5), Permission())
            assert world.kinds() == ["setpoint"]

    virtual(test)


def test_saf_011_arming_forgets_the_arms_earlier_target() -> None:
    """The arm may have been moved in the meantime, and the robot does not report its position."""

    async def test() -> None:
        world = World(joints=False)
        async with running(world) as wire:
            told = target(world, arm1=0.1)
            await wire.write(told, Permission())
            held = await wire.make_safe("zero")
            assert [report.target for report in held] == [0.0] * 3 + list(told[3:9])
            world.taken.clear()
            await wire.arm(Permission())
            assert [report.target for report in await wire.make_safe("zero")] == [0.0] * 3 + [None] * 6
            assert msgs(world, m.ARM) == []
            await wire.write(told, Permission())
            assert len(msgs(world, m.ARM)) == 1, "the same action after arming is no repetition"

    virtual(test)


def test_an_arm_command_does_not_command_the_base_nor_the_reverse() -> None:
    async def test() -> None:
        world = World(joints=False)
        async with running(world) as wire:
            await wire.write(target(world, arm1=0.1), Permission())
            assert (msgs(world, m.CMD_VEL), len(msgs(world, m.ARM))) == ([], 1)
            base = (0.2, 0.0, 0.0, *(NAN,) * 6, 0.0, 0.0, 1.0)
            await wire.write(base, Permission())
            assert (len(msgs(world, m.CMD_VEL)), len(msgs(world, m.ARM))) == (1, 1)

    virtual(test)
