"""Test what stops the robot, in virtual time over the twin's services in memory: the wire, a lost link, the
stop channel."""

from __future__ import annotations

import math

import pytest
import trio

from strands_actors.contract.driver import Candidate, GateState
from strands_actors.contract.wire import WireDown
from strands_actors.drivers.common.physics.body import Commander
from strands_actors.drivers.common.twin import Fault
from strands_actors.drivers.spot import protocol as p
from strands_actors.drivers.spot.protocol import Motors
from tests.drivers.common.memory_port import virtual

from .rig import (
    Go,
    World,
    confirmed,
    let_a_tablet_drive,
    let_a_tablet_have_the_e_stop,
    pass_time,
    ready,
    target,
)

# -- safe


def test_saf_005_a_stop_is_confirmed_by_a_later_report() -> None:
    async def test() -> None:
        world = World()
        wire = await ready(world)
        seen = await wire.read()
        await wire.write(target(world, seen, vx=1.0), Go())
        await pass_time(world, 0.3, wire)
        assert confirmed(await wire.make_safe("hold"))
        assert world.twin.mechanism.present_twist == pytest.approx((0.0, 0.0, 0.0), abs=0.05)
        for fault in (Fault.WRONG, Fault.STUCK):
            world.twin.set_fault(fault)
            reports = await wire.make_safe("hold")
            assert not confirmed(reports) and reports[0].detail.startswith("not confirmed"), fault

    virtual(test)


def test_saf_011_a_hold_reports_the_arms_position() -> None:
    """The next command holds the joints that it does not name at this position, and not at an older reading."""

    async def test() -> None:
        world = World()
        wire = await ready(world)
        seen = await wire.read()
        await wire.write(target(world, seen, arm_sh0=2.0, arm_wr0=-1.0), Go())
        await pass_time(world, 0.3, wire)
        reports = await wire.make_safe("hold")
        assert world.safe()[-1] == "hold" and confirmed(reports)
        assert [report.target for report in reports] == [0.0] * 3 + world.twin.mechanism.joints
        assert 0.3 < world.twin.mechanism.joints[0] < 1.9, "the arm is in motion"
        world.twin.set_fault(Fault.WRONG)
        assert {report.target for report in await wire.make_safe("hold")} == {None}, "the hold is not confirmed"

    virtual(test)


def test_saf_005_an_arm_that_goes_on_after_a_stop_is_not_reported_as_held() -> None:
    async def test() -> None:
        world = World()
        wire = await ready(world)
        seen = await wire.read()
        world.twin.mechanism.halt = lambda: None  # type: ignore[method-assign]
        await wire.write(target(world, seen, arm_sh0=3.0), Go())
        await pass_time(world, 0.1, wire)
        world.twin.mechanism._table = {**world.twin.mechanism._table, "arm_rad_s": 0.2}
        reports = await wire.make_safe("hold")
        assert not confirmed(reports)
        assert reports[0].detail == "not confirmed: the arm reports 0.20 rad/s"

    virtual(test)


def test_saf_005_an_arm_without_a_reported_speed_does_not_count_as_at_rest() -> None:
    async def test() -> None:
        world = World()
        wire = await ready(world)
        seen = await wire.read()
        joints = world.twin.reports.joints
        world.twin.reports.joints = lambda: [  # type: ignore[method-assign]
            {key: value for key, value in one.items() if key != "velocity"} for one in joints()
        ]
        world.twin.mechanism.halt = lambda: None  # type: ignore[method-assign]
        await wire.write(target(world, seen, arm_sh0=3.0), Go())
        await pass_time(world, 0.1, wire)
        reports = await wire.make_safe("hold")
        assert not confirmed(reports)
        assert reports[0].detail == "not confirmed: the arm does not report its speed"
        assert math.isnan((await wire.read()).velocity[3])

    virtual(test)


def test_a_robot_without_an_arm_is_held() -> None:
    async def test() -> None:
        world = World(arm=False)
        assert confirmed(await (await ready(world)).make_safe("hold"))

    virtual(test)


def test_saf_005_a_robot_without_a_lease_holder_counts_as_held_only_at_rest() -> None:
    """The robot has taken the lease from us without a new holder. An earlier command may still run."""

    async def test() -> None:
        world = World()
        wire = await ready(world)
        seen = await wire.read()
        walk = world.twin.mechanism.walk
        world.twin.mechanism.walk = lambda twist, for_s, hand, **how: walk(twist, 10.0, hand, **how)  # type: ignore[method-assign]
        await wire.write(target(world, seen, vx=0.5), Go())
        await pass_time(world, 0.3, wire)
        world.twin.leases.owner = ""
        reports = await wire.make_safe("hold")
        assert reports[0].written and not confirmed(reports)
        assert reports[0].detail == "not confirmed: the robot reports speed 0.50"
        assert (await wire.read()).faults["lease"] == "we no longer have the lease"
        await trio.sleep(10.0)
        world.taken.clear()
        assert confirmed(await wire.make_safe("hold")), "the twist has ended"
        assert "RobotCommand" not in world.names(), "no command is sent without our lease"

    virtual(test)


def test_a_robot_that_another_has_the_lease_of_is_his_however_often_it_is_stopped() -> None:
    async def test() -> None:
        world = World()
        wire = await ready(world)
        world.twin.leases.acquire("tablet-7", take=True)
        world.twin.mechanism.walk((0.5, 0.0, 0.0), 10.0, Commander.NONE)
        for _ in range(2):
            assert confirmed(await wire.make_safe("hold"))
            assert (await wire.read()).faults["lease"] == "the lease was taken over by tablet-7"
        assert world.twin.mechanism.walks

    virtual(test)


def test_saf_005_a_robot_without_a_reported_speed_does_not_count_as_at_rest() -> None:
    reading = p.reading({"robot_state": {"power_state": {"motor_power_state": 2}}})
    assert math.isnan(reading.speed)


def test_saf_010_a_command_that_comes_late_behind_a_stop_is_refused_by_its_lease() -> None:
    async def test() -> None:
        world = World()
        wire = await ready(world)
        seen = await wire.read()
        world.frozen = True
        with pytest.raises(WireDown, match="has not answered"):
            await wire.write(target(world, seen, arm_el0=1.0), Go())
        late = list(world.streams)
        world.frozen = False
        world.taken.clear()
        late[-1].take_waiting()
        ((kind, _),) = [(one.kind, one.name) for one in world.taken]
        assert kind == "setpoint", "the robot carries the command out after all"
        assert confirmed(await wire.make_safe("hold")), "the robot is then stopped"
        lease = world.of("RobotCommand")[0].body["lease"]
        use = world.twin.leases.use(lease)
        assert use["status"] == p.LeaseUse.OLDER, "after the stop an older command is refused"

    virtual(test)


@pytest.mark.parametrize(
    ("service", "method"), [("stand", "PowerCommand"), ("stand", "RobotCommand"), ("set_twist", "RobotCommand")]
)
def test_saf_010_a_service_that_is_not_answered_ends_the_link(service: str, method: str) -> None:
    """The robot may carry it out all the same. The caller gets an error, and the robot is settled."""

    async def test() -> None:
        world = World()
        wire = await ready(world, stands=service == "set_twist")
        world.twin.muted = {method}
        with pytest.raises(WireDown, match=f"{method}: .* has not answered"):
            await wire.perform(service, {"vx": 0.5} if service == "set_twist" else {}, Go())
        world.twin.muted = set()
        with pytest.raises(WireDown, match=f"{method}: .* has not answered"):
            await wire.read()
        assert confirmed(await wire.reach("settle")) and world.twin.mechanism.motors is Motors.OFF
        await wire.open()
        await wire.read()

    virtual(test)


def test_saf_010_a_service_that_the_robot_refuses_for_its_clock_ends_the_link() -> None:
    async def test() -> None:
        world = World()
        wire = await ready(world)
        wire._time.clock_identifier = "the clock before"
        with pytest.raises(WireDown, match="clock was changed"):
            await wire.perform("set_twist", {"vx": 0.5}, Go())
        with pytest.raises(WireDown, match="clock was changed"):
            await wire.read()

    virtual(test)


@pytest.mark.parametrize("method", ["PowerCommandFeedback", "RobotCommandFeedback"])
def test_a_look_that_is_not_answered_is_taken_again_while_it_stands_up(method: str) -> None:
    async def test() -> None:
        world = World()
        wire = await ready(world, stands=False)
        world.twin.muted = {method}
        async with trio.open_nursery() as nursery:
            nursery.start_soon(let_it_speak, world)
            assert await wire.perform("stand", {}, Go()) == {"standing": True}
        await wire.read()

    virtual(test)


async def let_it_speak(world: World) -> None:
    await trio.sleep(1.0)
    world.twin.muted = set()


def test_saf_005_a_failed_sit_is_followed_by_the_e_stop() -> None:
    async def test() -> None:
        world = World()
        wire = await ready(world)
        world.twin.muted = {"RobotCommand"}
        settle, world.twin.mechanism.settle = world.twin.mechanism.settle, lambda: None  # type: ignore[method-assign]
        world.twin.mechanism.settle = lambda: settle() if world.twin.estop.level != 4 else None  # type: ignore[method-assign]
        assert confirmed(await wire.make_safe("settle"))
        assert world.safe() == ["settle", "settle"]
        assert [one.name for one in world.taken if one.kind == "safe"] == ["RobotCommand", "EstopCheckIn"]

    virtual(test)


def test_a_cutting_e_stop_is_sent_at_once_and_alone() -> None:
    async def test() -> None:
        world = World({"on_estop": "cut"})
        assert world.driver.fallbacks["estop"] == "off"  # type: ignore[index]
        wire = await ready(world)
        assert confirmed(await wire.make_safe("off"))
        assert world.safe() == ["off"] and world.twin.mechanism.motors is Motors.OFF
        world.taken.clear()
        await pass_time(world, 5.0, wire)
        assert world.of("EstopCheckIn") == [], "only a resume releases the e-stop"
        await wire.arm(Go())
        assert world.twin.estop.level is p.StopLevel.NONE

    virtual(test)


def test_saf_006_a_robot_that_is_hung_is_given_up_in_time_and_reported() -> None:
    async def test() -> None:
        world = World()
        wire = await ready(world)
        world.frozen = True
        for state in ("hold", "settle"):
            began_s = trio.current_time()
            reports = await wire.make_safe(state)
            assert trio.current_time() - began_s < world.driver.timing.safe_s - 0.5
            assert reports[0].written and not confirmed(reports)

    virtual(test)


def test_saf_012_an_answer_that_is_missing_leaves_the_age_and_a_silent_robot_is_lost() -> None:
    async def test() -> None:
        world = World()
        wire = await ready(world, stands=False)
        first = await wire.read()
        world.frozen = True
        again = await wire.read()
        assert again.stamp_ns == first.stamp_ns, "an old reading keeps its time stamp"
        with pytest.raises(WireDown, match="has not answered"):
            for _ in range(5):
                await wire.read()

    virtual(test)


def test_saf_012_an_answer_that_repeats_itself_is_not_new_and_ends_the_link() -> None:
    async def test() -> None:
        world = World()
        wire = await ready(world)
        first = await wire.read()
        world.twin.set_fault(Fault.STUCK)
        last = await wire.read()  # it sends one more report of its state before it got stuck
        await trio.sleep(0.9)
        again = await wire.read()
        assert again.t_ns == last.t_ns < first.t_ns + 10**8 and set(again.stamp_ns) == {last.t_ns}
        now_ns = round(trio.current_time() * 1e9)
        late = GateState(now_ns, again, again.position, again.t_ns, False)
        candidate = world.driver.parse({"vx": 0.1}, late)
        assert isinstance(candidate, Candidate)
        refusals = [refusal.code for gate in world.driver.gates if (refusal := gate(candidate, late))]
        assert refusals == ["stale"]
        await trio.sleep(0.2)
        with pytest.raises(WireDown, match="has reported nothing new for"):
            await wire.read()
        world.taken.clear()
        with pytest.raises(WireDown, match="has reported nothing new for 1 s"):
            await world.wire().open()
        assert not {"setpoint", "enable", "safe"} & {one.kind for one in world.taken}
        world.twin.set_fault(Fault.OK)
        await world.wire().open()

    virtual(test)


def test_saf_020_a_lost_link_is_reached_by_lease_and_e_stop_on_a_new_connection() -> None:
    async def test() -> None:
        world = World()
        wire = await ready(world)
        world.gone = True
        assert not confirmed(await wire.reach("settle"))
        world.gone = False
        world.taken.clear()
        assert confirmed(await wire.reach("settle"))
        assert world.safe() == ["settle"] * 3 and world.twin.mechanism.motors is Motors.OFF
        assert world.names("setpoint") == []

    virtual(test)


@pytest.mark.parametrize("state", ["hold", "settle"])
def test_saf_002_a_network_that_is_slow_to_connect_is_waited_for(state: str) -> None:
    async def test() -> None:
        world = World()
        wire = await ready(world)
        for stream in world.streams:
            stream.close()
        world.taken.clear()
        world.connect_s = 0.8
        reports = await wire.reach(state)
        first = next(one for one in world.taken if one.kind == "safe")
        assert (first.name, first.safe_state) == ("RobotCommand", state), world.names()
        assert confirmed(reports) and world.names("setpoint") == []

    virtual(test)


# -- the stop channel


def test_saf_003_the_stop_channel_asserts_our_endpoint_and_needs_no_lease() -> None:
    async def test() -> None:
        for state, level in (("settle", "settle"), ("hold", "settle"), ("off", "off")):
            world = World()
            await ready(world)
            channel = world.stop_channel()
            async with trio.open_nursery() as nursery:
                await nursery.start(channel.serve)
                world.taken.clear()
                reports = await channel.make_safe(state)
                nursery.cancel_scope.cancel()
            assert confirmed(reports), reports[0].detail
            assert world.safe() == [level] and world.twin.mechanism.motors is Motors.OFF
            assert not {"AcquireLease", "TakeLease", "RobotCommand"} & set(world.names())
            channel.close()

    virtual(test)


def test_saf_003_the_stop_channel_replaces_a_dead_connection() -> None:
    async def test() -> None:
        world = World()
        await ready(world)
        channel = world.stop_channel()
        async with trio.open_nursery() as nursery:
            await nursery.start(channel.serve)
            world.streams[-1].close()
            first = await channel.make_safe("settle")
            assert confirmed(first) or confirmed(await channel.make_safe("settle"))
            nursery.cancel_scope.cancel()
        assert world.twin.mechanism.motors is Motors.OFF

    virtual(test)


def test_a_stop_channel_without_a_renewed_login_keeps_its_session_and_retries() -> None:
    async def test() -> None:
        world = World()
        channel = world.stop_channel()
        async with trio.open_nursery() as nursery:
            await nursery.start(channel.serve)
            session = channel.session
            world.twin.muted = {"GetAuthToken"}
            await trio.sleep(1.2 * 3600.0)
            assert 10 < len(world.of("GetAuthToken")) < 20, "the token is requested every minute"
            assert channel.session is session
            nursery.cancel_scope.cancel()

    virtual(test)


def test_saf_005_an_answer_without_the_e_stops_configuration_is_not_one_without_our_endpoint() -> None:
    async def test() -> None:
        world = World()
        wire = await ready(world)
        await wire.write(target(world, await wire.read(), vx=1.0), Go())
        answer = world.twin.answer
        world.twin.answer = lambda name, request: (  # type: ignore[method-assign]
            ({}, ("read", None)) if name == "GetEstopConfig" else answer(name, request)
        )
        channel = world.stop_channel()
        reports = await channel.make_safe("settle")
        assert not confirmed(reports)
        assert reports[0].detail == "not confirmed: e-stop: GetEstopConfig: no configuration in its answer"
        world.twin.answer = answer  # type: ignore[method-assign]
        assert confirmed(await channel.make_safe("settle")) and world.twin.mechanism.motors is Motors.OFF
        channel.close()

    virtual(test)


def test_saf_005_a_robot_that_our_lease_has_powered_is_not_safe_because_its_e_stop_is_anothers() -> None:
    async def test() -> None:
        world = World()
        wire = await ready(world, stands=False)
        let_a_tablet_have_the_e_stop(world)
        assert await wire.perform("stand", {}, Go()) == {"standing": True}
        channel = world.stop_channel()
        reports = await channel.make_safe("settle")
        assert not confirmed(reports)
        assert reports[0].detail == "not confirmed: the motors are on, and another client has configured the e-stop"
        world.twin.mechanism.cut()
        assert confirmed(await channel.make_safe("settle"))
        channel.close()

    virtual(test)


def test_a_stop_channel_without_lease_and_e_stop_leaves_the_robot_alone() -> None:
    async def test() -> None:
        world = World()
        let_a_tablet_drive(world)
        assert confirmed(await world.stop_channel().make_safe("settle"))
        assert world.safe() == [] and world.twin.mechanism.motors is Motors.ON

    virtual(test)
