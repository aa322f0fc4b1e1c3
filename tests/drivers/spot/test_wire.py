"""The wire and the stop channel in virtual time, over the twin's services in memory: what leaves,
when, and what is confirmed."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import pytest
import trio

from strands_actors.contract.driver import Candidate, GateState
from strands_actors.contract.wire import MotorReport, Observation, PermitDenied, WireDown
from strands_actors.drivers.common.twin import Fault
from strands_actors.drivers.spot import protocol as p
from strands_actors.drivers.spot.config import PASSWORD, USERNAME, parse_port
from strands_actors.drivers.spot.protocol import Motors
from strands_actors.drivers.spot.session import own_name
from strands_actors.drivers.spot.wire import SpotWire
from strands_actors.kernel.messages import Refused
from tests.drivers.common.memory_port import virtual

from .rig import Go, Taken, World, let_a_tablet_drive, ready


def target(world: World, seen: Observation, **action: float) -> tuple[float, ...]:
    """Return what an action comes to."""
    now_ns = seen.t_ns
    at = GateState(now_ns, seen, tuple(0.0 if value != value else value for value in seen.position), now_ns, False)
    candidate = world.driver.parse(action, at)
    assert isinstance(candidate, Candidate), candidate
    return candidate.values


def velocity(taken: Taken) -> dict[str, Any]:
    asked: dict[str, Any] = taken.body["command"]["synchronized_command"]["mobility_command"][
        "se2_velocity_request"
    ]
    return asked


def confirmed(reports: tuple[MotorReport, ...]) -> bool:
    assert len(reports) == 10
    return all(report.safe for report in reports)


async def pass_time(world: World, seconds: float, *wires: SpotWire) -> None:
    """Let time pass as a tree does: feed and read, ten times a second."""
    for _ in range(round(seconds * 10)):
        for wire in wires:
            await wire.feed()
            await wire.read()
        world.twin.pass_time()
        await trio.sleep(0.1)


def test_opening_logs_in_reads_the_directory_and_learns_the_robots_clock() -> None:
    async def test() -> None:
        world = World()
        facts = await world.wire().open()
        assert (facts["serial"], facts["nickname"], facts["software"]) == ("spot-twin", "twin", "5.2.0")
        assert world.names()[:3] == ["GetRobotId", "GetAuthToken", "ListServiceEntries"]
        assert {stream.authority for stream in world.streams} == set(p.AUTHORITIES.values())
        assert world.names("setpoint") == world.names("enable") == world.names("safe") == [], "and moves nothing"

    virtual(test)


def test_a_clock_that_is_known_late_is_waited_for_and_one_that_never_is_is_named() -> None:
    async def test() -> None:
        began_s = trio.current_time()
        await World(sync_s=4.0).wire().open()
        assert 4.0 <= trio.current_time() - began_s < 4.5
        with pytest.raises(WireDown, match="time sync: the robot's clock is not known after 5 s"):
            await World(sync_s=6.0).wire().open()

    virtual(test)


def test_a_login_that_is_refused_or_missing_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    async def refused() -> None:
        with pytest.raises(WireDown, match="login: user or password is wrong"):
            await World().wire().open()

    monkeypatch.setenv(USERNAME, "user")
    monkeypatch.setenv(PASSWORD, "wrong")
    virtual(refused)


@pytest.mark.parametrize(("port", "wanted"), [("192.0.2.1", 443), ("192.0.2.1:8443?ca=/x/ca.pem", 8443)])
def test_a_port_names_a_host_and_may_name_a_certificate(port: str, wanted: int) -> None:
    assert parse_port(port)[:2] == ("192.0.2.1", wanted)


def test_saf_013_arming_takes_the_lease_and_reads_the_e_stop_back() -> None:
    async def test() -> None:
        world = World({"estop_timeout_s": 2.0})
        await ready(world, stands=False)
        (set_up,) = world.of("SetEstopConfig")
        (endpoint,) = set_up.body["config"]["endpoints"]
        assert p.stamp_ns(endpoint["timeout"]) == 2_000_000_000
        assert world.twin.leases.owner == endpoint["name"]
        assert "GetEstopSystemStatus" in world.names(), "and is read back"
        assert world.twin.mechanism.motors is Motors.OFF, "nothing is energised"

    virtual(test)


def test_saf_013_an_endpoint_that_waits_longer_than_it_was_told_is_not_armed_with() -> None:
    async def test() -> None:
        world = World()
        wire = world.wire()
        await wire.open()
        set_config = world.twin.estop.set_config

        def lazy(wanted: dict[str, Any], target: str, motors_on: bool) -> dict[str, Any]:
            (one,) = wanted["endpoints"]
            return set_config({"endpoints": [{**one, "timeout": p.duration(60.0)}]}, target, motors_on)

        world.twin.estop.set_config = lazy  # type: ignore[method-assign]
        with pytest.raises(WireDown, match="waits 60 s, not 3"):
            await wire.arm(Go())

    virtual(test)


def test_a_lease_that_another_has_is_a_refusal_that_names_him_and_one_of_ours_is_taken_back() -> None:
    async def test() -> None:
        world = World()
        world.twin.leases.acquire("tablet-7")
        wire = world.wire()
        await wire.open()
        with pytest.raises(WireDown, match="held by tablet-7"):
            await wire.arm(Go())
        assert world.of("TakeLease") == []

        again = World()
        first = await ready(again, stands=False)
        first.close()  # as a process that was killed: it returned nothing
        await ready(again)
        assert len(again.of("TakeLease")) == 1

    virtual(test)


def test_a_lease_is_returned_when_the_e_stop_had_to_sit_it_down_and_one_that_cannot_be_is_told() -> None:
    async def test() -> None:
        world = World()
        wire = await ready(world)
        world.twin.muted = {"RobotCommand"}
        assert confirmed(await wire.make_safe("settle"))
        assert world.twin.leases.owner == ""

        world = World()
        wire = await ready(world)
        world.twin.muted = {"ReturnLease"}
        reports = await wire.make_safe("settle")
        assert confirmed(reports) and reports[0].detail.startswith("the lease was not returned: ReturnLease")

    virtual(test)


def test_a_button_that_is_pressed_is_named_and_nothing_is_armed() -> None:
    async def test() -> None:
        world = World()
        world.twin.estop.pressed = True
        wire = world.wire()
        await wire.open()
        with pytest.raises(WireDown, match=r"E-stopped \(hardware_estop, software_estop\). Release it first"):
            await wire.arm(Go())
        seen = await wire.read()
        assert seen.sensors["estopped"] == (2.0,)

    virtual(test)


def test_an_endpoint_that_another_has_with_motors_on_is_left_to_him() -> None:
    async def test() -> None:
        world = World()
        let_a_tablet_drive(world)
        wire = world.wire()
        await wire.open()
        with pytest.raises(WireDown, match="no endpoint of ours"):
            await wire.arm(Go())
        assert confirmed(await wire.make_safe("settle")), "nothing of ours is energised"
        assert world.safe() == [] and world.twin.mechanism.motors is Motors.ON

    virtual(test)


def test_saf_001_every_twist_ends_six_tenths_later_on_the_robots_clock() -> None:
    async def test() -> None:
        world = World()
        wire = await ready(world)
        seen = await wire.read()
        sent_ns = world.twin.robot_ns()
        await wire.write(target(world, seen, vx=0.5, wz=-0.2), Go())
        (walk,) = [one for one in world.of("RobotCommand") if one.kind == "setpoint"]
        assert abs(p.stamp_ns(velocity(walk)["end_time"]) - sent_ns - 600_000_000) < 30_000_000
        assert velocity(walk)["velocity"] == {"linear": {"x": 0.5, "y": 0.0}, "angular": -0.2}
        await pass_time(world, 0.3, wire)
        assert (await wire.read()).position[0] == pytest.approx(0.5)
        await pass_time(world, 0.6, wire)
        assert (await wire.read()).position[0] == 0.0, "it stands, and nobody told it"
        assert world.safe() == []

    virtual(test)


def test_arm_and_claw_are_told_when_they_are_named_and_not_otherwise() -> None:
    async def test() -> None:
        world = World()
        wire = await ready(world)
        seen = await wire.read()
        world.taken.clear()
        await wire.write(target(world, seen, arm_el0=1.5), Go())
        await wire.write(target(world, seen, arm_f1x=-1.0, vx=0.1), Go())
        first, second = (one.body["command"]["synchronized_command"] for one in world.of("RobotCommand"))
        assert list(first) == ["arm_command"]
        point = first["arm_command"]["arm_joint_move_command"]["trajectory"]["points"][0]["position"]
        assert point["el0"]["value"] == 1.5 and point["sh1"]["value"] == -2.8, "the others stay"
        assert sorted(second) == ["gripper_command", "mobility_command"]

    virtual(test)


def test_saf_002_a_permit_that_is_denied_sends_nothing() -> None:
    async def test() -> None:
        world = World()
        wire = await ready(world)
        seen = await wire.read()
        world.taken.clear()
        with pytest.raises(PermitDenied):
            await wire.write(target(world, seen, vx=0.1), Go(0))
        with pytest.raises(PermitDenied):
            await wire.perform("set_twist", {"vx": 0.1}, Go(0))
        assert world.taken == []

    virtual(test)


def test_saf_009_a_stop_while_the_motors_come_on_leaves_them_off() -> None:
    async def test() -> None:
        world = World()
        wire = await ready(world, stands=False)
        with trio.move_on_after(0.1):
            await wire.perform("stand", {}, Go())
        assert world.twin.mechanism.motors is Motors.POWERING_ON
        assert confirmed(await wire.make_safe("hold"))
        await pass_time(world, 1.0)
        assert world.twin.mechanism.motors is Motors.OFF
        with pytest.raises(PermitDenied):
            await wire.perform("stand", {}, Go(0))

    virtual(test)


def test_saf_004_check_ins_come_at_a_third_of_the_time_out_and_only_when_fed() -> None:
    async def test() -> None:
        world = World()
        wire = await ready(world)
        world.taken.clear()
        await pass_time(world, 10.0, wire)
        assert 9 <= len(world.of("EstopCheckIn")) <= 12
        assert 9 <= len(world.of("RetainLease")) <= 11
        assert world.twin.mechanism.motors is Motors.ON
        world.taken.clear()
        for _ in range(20):
            await wire.read()  # gate or transport does not answer: it is read, and not fed
            await trio.sleep(0.1)
        assert world.of("EstopCheckIn") == []
        await pass_time(world, 3.0)
        assert world.twin.mechanism.motors is Motors.OFF, "and the robot settles by itself"

    virtual(test)


def test_a_challenge_that_another_used_up_is_asked_for_again() -> None:
    async def test() -> None:
        world = World()
        wire = await ready(world)
        (end,) = world.twin.estop._ends.values()
        end.challenge += 100
        await pass_time(world, 5.0, wire)
        assert world.twin.mechanism.motors is Motors.ON

    virtual(test)


def test_an_endpoint_that_was_replaced_is_a_fault_that_settles_it() -> None:
    async def test() -> None:
        world = World()
        wire = await ready(world, stands=False)
        target_id = world.twin.estop.config["unique_id"]
        world.twin.estop.set_config({"endpoints": [{"role": p.ESTOP_ROLE, "name": "tablet"}]}, target_id, False)
        await pass_time(world, 1.5, wire)
        seen = await wire.read()
        conditions = [one for one in world.driver.conditions if one.check(seen, seen.t_ns)]
        assert conditions and conditions[0].always and conditions[0].safe_state == "settle"

    virtual(test)


def test_saf_009_a_stop_during_bring_up_keeps_the_e_stop_asserted() -> None:
    async def test() -> None:
        world = World()
        wire = await ready(world)
        assert confirmed(await wire.make_safe("settle"))
        world.taken.clear()
        with pytest.raises(PermitDenied):
            await wire.arm(Go(1))  # the stop comes behind the first look, directly before the check-in
        await pass_time(world, 4.0, wire)
        assert world.of("EstopCheckIn") == [], "and nothing that feeds it lifts it"
        assert world.twin.estop.level is not p.StopLevel.NONE

    virtual(test)


def test_saf_004_a_check_in_that_comes_after_the_time_out_is_not_sent() -> None:
    """The robot has settled by then, or is about to: nothing un-asserts an e-stop by itself."""

    async def test() -> None:
        world = World()
        wire = await ready(world)
        world.taken.clear()
        await trio.sleep(3.5)  # a machine that stood still
        await pass_time(world, 2.0, wire)
        assert world.of("EstopCheckIn") == []
        seen = await wire.read()
        assert "late" in seen.faults["estop"]
        assert any(one.check(seen, seen.t_ns) and one.always for one in world.driver.conditions)
        assert world.twin.mechanism.motors is Motors.OFF

    virtual(test)


# -- leases


def test_a_sign_that_is_overtaken_by_a_newer_command_is_no_lost_lease() -> None:
    async def test() -> None:
        world = World()
        wire = await ready(world)
        world.twin.leases._newest = [*world.twin.leases._newest[:1], 10**6]
        await pass_time(world, 1.2, wire)
        assert "lease" not in (await wire.read()).faults

    virtual(test)


def test_hosts_of_one_name_are_told_apart(tmp_path: Path) -> None:
    names = set()
    for number in ("a", "b"):
        (tmp_path / number).write_text(f"{number * 32}\n")
        names.add(own_name(tmp_path / number))
    assert len(names) == 2 and own_name(tmp_path / "none") == own_name(tmp_path / "none")
    assert all("a" * 32 not in name for name in names)


def test_a_stolen_lease_is_told_with_its_owner_and_he_is_left_alone() -> None:
    async def test() -> None:
        world = World()
        wire = await ready(world)
        seen = await wire.read()
        world.twin.leases.acquire("tablet-7", take=True)
        await wire.write(target(world, seen, vx=0.5), Go())
        seen = await wire.read()
        assert seen.faults["lease"] == "the lease was taken over by tablet-7"
        assert world.twin.mechanism.told == (0.0, 0.0, 0.0), "the robot did not do it"
        (broken,) = [one for one in world.driver.conditions if one.check(seen, seen.t_ns)]
        refusal = broken.check(seen, seen.t_ns)
        assert isinstance(refusal, Refused) and "tablet-7" in refusal.reason
        assert confirmed(await wire.make_safe("hold"))
        assert world.safe() in ([], [""]), "nothing that stops him"
        answer = await wire.perform("set_twist", {"vx": 0.1}, Go())
        assert isinstance(answer, Refused) and "tablet-7" in answer.reason

    virtual(test)


def test_a_lease_that_was_taken_over_is_seen_without_a_command_too() -> None:
    async def test() -> None:
        world = World()
        wire = await ready(world)
        world.twin.leases.acquire("tablet-7", take=True)
        await pass_time(world, 1.5, wire)
        assert "tablet-7" in (await wire.read()).faults["lease"]

    virtual(test)


def test_sitting_down_returns_the_lease_and_one_that_was_taken_over_is_reported() -> None:
    async def test() -> None:
        world = World()
        wire = await ready(world)
        assert confirmed(await wire.make_safe("settle"))
        assert world.safe() == ["settle"] and world.twin.mechanism.motors is Motors.OFF
        assert world.twin.leases.owner == "" and len(world.of("ReturnLease")) == 1

        world = World()
        wire = await ready(world)
        world.twin.leases.acquire("tablet-7", take=True)
        reports = await wire.make_safe("settle")
        assert confirmed(reports), "by our e-stop endpoint"
        assert reports[0].detail == "the lease was taken over by tablet-7: it is not returned"
        assert world.of("ReturnLease") == [] and world.twin.leases.owner == "tablet-7"

    virtual(test)


# -- safe


def test_saf_005_a_stop_is_confirmed_by_what_it_reports_afterwards() -> None:
    async def test() -> None:
        world = World()
        wire = await ready(world)
        seen = await wire.read()
        await wire.write(target(world, seen, vx=1.0), Go())
        await pass_time(world, 0.3, wire)
        assert confirmed(await wire.make_safe("hold"))
        assert world.twin.mechanism.runs == pytest.approx((0.0, 0.0, 0.0), abs=0.05)
        for fault in (Fault.WRONG, Fault.STUCK):
            world.twin.set_fault(fault)
            reports = await wire.make_safe("hold")
            assert not confirmed(reports) and reports[0].detail.startswith("not confirmed"), fault

    virtual(test)


def test_saf_005_a_robot_that_does_not_tell_its_speed_is_not_known_to_stand() -> None:
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
        assert kind == "setpoint", "it is done after all"
        assert confirmed(await wire.make_safe("hold")), "so it is stopped"
        lease = world.of("RobotCommand")[0].body["lease"]
        use = world.twin.leases.use(lease)
        assert use["status"] == p.LeaseUse.OLDER, "and once it is, nothing older moves it"

    virtual(test)


def test_saf_005_sitting_that_is_not_done_is_followed_by_the_e_stop() -> None:
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


def test_an_e_stop_that_cuts_is_said_at_once_and_alone() -> None:
    async def test() -> None:
        world = World({"on_estop": "cut"})
        assert world.driver.fallbacks["estop"] == "off"  # type: ignore[index]
        wire = await ready(world)
        assert confirmed(await wire.make_safe("off"))
        assert world.safe() == ["off"] and world.twin.mechanism.motors is Motors.OFF
        world.taken.clear()
        await pass_time(world, 5.0, wire)
        assert world.of("EstopCheckIn") == [], "nothing lifts it but a resume"
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
        assert again.stamp_ns == first.stamp_ns, "an old reading keeps its age"
        with pytest.raises(WireDown, match="has not answered"):
            for _ in range(5):
                await wire.read()

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


def test_saf_003_the_stop_channel_connects_anew_when_its_connection_is_dead() -> None:
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


def test_a_stop_by_a_channel_without_anything_of_ours_leaves_the_robot_alone() -> None:
    async def test() -> None:
        world = World()
        let_a_tablet_drive(world)
        assert confirmed(await world.stop_channel().make_safe("settle"))
        assert world.safe() == [] and world.twin.mechanism.motors is Motors.ON

    virtual(test)
