"""Test the wire in virtual time, over the twin's services in memory: the requests and their times."""

from __future__ import annotations

import contextlib
from collections.abc import AsyncIterator
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
import trio

from strands_actors.contract.wire import PermitDenied, WireDown
from strands_actors.drivers.spot import protocol as p
from strands_actors.drivers.spot import session
from strands_actors.drivers.spot.config import PASSWORD, USERNAME, parse_port
from strands_actors.drivers.spot.protocol import Motors
from strands_actors.drivers.spot.session import own_name
from strands_actors.drivers.spot.wire import SpotWire
from strands_actors.kernel.messages import Refused
from strands_actors.supervisors.wire.serving import Serving
from tests.drivers.common.memory_port import virtual

from .rig import Go, World, confirmed, let_a_tablet_drive, pass_time, ready, target, velocity


def test_opening_logs_in_reads_the_directory_and_learns_the_robots_clock() -> None:
    async def test() -> None:
        world = World()
        facts = await world.wire().open()
        assert (facts["serial"], facts["nickname"], facts["software"]) == ("spot-twin", "twin", "5.2.0")
        assert world.names()[:3] == ["GetRobotId", "GetAuthToken", "ListServiceEntries"]
        assert {stream.authority for stream in world.streams} == set(p.AUTHORITIES.values())
        assert world.names("setpoint") == world.names("enable") == world.names("safe") == [], (
            "opening writes no command"
        )

    virtual(test)


def test_opening_waits_for_the_clock_offset_and_names_a_missing_one() -> None:
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
        assert "GetEstopSystemStatus" in world.names(), "the e-stop's state is read back"
        assert world.twin.mechanism.motors is Motors.OFF, "nothing is energised"

    virtual(test)


def test_saf_013_an_endpoint_with_a_longer_timeout_than_requested_is_not_used() -> None:
    async def test() -> None:
        world = World()
        wire = world.wire()
        await wire.open()
        set_config = world.twin.estop.set_config

        def lazy(wanted: dict[str, Any], target: str, motors_on: bool) -> dict[str, Any]:
            (one,) = wanted["endpoints"]
            return set_config({"endpoints": [{**one, "timeout": p.duration(60.0)}]}, target, motors_on)

        world.twin.estop.set_config = lazy  # type: ignore[method-assign]
        with pytest.raises(WireDown, match="timeout is 60 s, not 3"):
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
        first.close()  # as a killed process, which returns nothing
        await ready(again)
        assert len(again.of("TakeLease")) == 1

    virtual(test)


def test_a_lease_is_returned_after_the_e_stop_and_a_failure_is_reported() -> None:
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


def test_a_pressed_button_is_named_and_nothing_is_armed() -> None:
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


def test_another_clients_endpoint_is_left_alone_while_motors_are_on() -> None:
    async def test() -> None:
        world = World()
        let_a_tablet_drive(world)
        wire = world.wire()
        await wire.open()
        assert confirmed(await wire.make_safe("settle")), "we have energised no motor"
        world.twin.leases.owner = ""
        with pytest.raises(WireDown, match="refuses our endpoint"):
            await wire.arm(Go())
        assert world.twin.leases.owner == "", "the lease is free for the other client"
        reports = await wire.make_safe("settle")
        assert not confirmed(reports), "no client drives the robot, and its motors are on"
        assert reports[0].detail == "not confirmed: the motors are on, and another client has configured the e-stop"
        assert world.safe() == [] and world.twin.mechanism.motors is Motors.ON
        world.twin.mechanism.cut()
        assert confirmed(await wire.make_safe("settle"))

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
        assert (await wire.read()).position[0] == 0.0, "the robot stands without our command"
        assert world.safe() == []

    virtual(test)


def test_arm_and_claw_are_commanded_only_if_named() -> None:
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
        assert point["el0"]["value"] == 1.5 and point["sh1"]["value"] == -2.8, "the other joints keep their targets"
        assert sorted(second) == ["gripper_command", "mobility_command"]

    virtual(test)


def test_saf_002_nothing_is_sent_without_a_permit() -> None:
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
            await wire.read()  # gate or transport does not answer: the wire reads, but does not feed
            await trio.sleep(0.1)
        assert world.of("EstopCheckIn") == []
        await pass_time(world, 3.0)
        assert world.twin.mechanism.motors is Motors.OFF, "the robot settles by itself"

    virtual(test)


@pytest.mark.parametrize(
    ("control_hz", "timeout_s", "longest_s"),
    [(2.0, 3.0, 1.0), (2.0, 2.0, 0.5), (2.0, 1.0, 0.5), (10.0, 3.0, 1.0), (30.0, 1.0, 1 / 3)],
)
def test_saf_004_check_ins_come_in_time_at_each_control_frequency(
    control_hz: float, timeout_s: float, longest_s: float
) -> None:
    """The wire is fed once in each control period."""

    async def test() -> None:
        world = World({"control_frequency": control_hz, "estop_timeout_s": timeout_s})
        wire = await ready(world, stands=False)
        world.taken.clear()
        for _ in range(round(10 * control_hz)):
            await wire.feed()
            await trio.sleep(1 / control_hz)
        times_s = [request.t_s for request in world.of("EstopCheckIn")]
        assert 8 <= len(times_s) <= 2 * 10 / longest_s + 2
        assert max(later - earlier for earlier, later in pairwise(times_s)) <= longest_s + 0.05

    virtual(test)


def test_a_used_challenge_is_requested_again() -> None:
    async def test() -> None:
        world = World()
        wire = await ready(world)
        (end,) = world.twin.estop._endpoints.values()
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
            await wire.arm(Go(1))  # the stop comes after the first check, directly before the check-in
        await pass_time(world, 4.0, wire)
        assert world.of("EstopCheckIn") == [], "no check-in releases the e-stop"
        assert world.twin.estop.level is not p.StopLevel.NONE

    virtual(test)


def test_saf_004_a_check_in_that_comes_after_the_time_out_is_not_sent() -> None:
    """The robot has settled by then, or is about to. An asserted e-stop is never released by itself."""

    async def test() -> None:
        world = World()
        wire = await ready(world)
        world.taken.clear()
        await trio.sleep(3.5)  # a machine that paused
        await pass_time(world, 2.0, wire)
        assert world.of("EstopCheckIn") == []
        seen = await wire.read()
        assert "late" in seen.faults["estop"]
        assert any(one.check(seen, seen.t_ns) and one.always for one in world.driver.conditions)
        assert world.twin.mechanism.motors is Motors.OFF

    virtual(test)


# -- renewals in the background


@pytest.mark.parametrize("says", ["nothing", "too many attempts"])
def test_a_login_that_is_not_renewed_delays_no_call_and_ends_the_link_when_the_token_runs_out(
    monkeypatch: pytest.MonkeyPatch, says: str
) -> None:
    async def test() -> None:
        world = World()
        wire = world.wire()
        await wire.open()
        async with served(wire) as serving:
            if says == "nothing":
                world.twin.muted = {"GetAuthToken"}
            else:
                world.twin._log_in = lambda request: {"status": 4}  # type: ignore[method-assign]
            await trio.sleep(3599.0)
            for _ in range(100):
                began_s = trio.current_time()
                await wire.feed()
                await wire.read()
                assert trio.current_time() - began_s < world.driver.timing.call_s / 2
                await trio.sleep(0.1)
            assert len(world.of("GetAuthToken")) == 2, "the token is requested at first and after an hour"
            await trio.sleep(300.0)
            assert 5 <= len(world.of("GetAuthToken")) <= 8, "after a failure the token is requested every minute"
            serving.check()
            monkeypatch.setattr(session, "TOKEN_S", 3600.0 + 400.0)
            await trio.sleep(200.0)
            with pytest.raises(WireDown, match=r"GetAuthToken|too many attempts"):
                serving.check()

    virtual(test)


def test_a_token_is_renewed_every_hour_and_a_failure_after_a_minute() -> None:
    async def test() -> None:
        world = World()
        wire = world.wire()
        await wire.open()
        async with served(wire) as serving:
            world.twin.muted = {"GetAuthToken"}
            await trio.sleep(3650.0)
            world.twin.muted = set()
            await trio.sleep(2 * 3600.0 - 60.0)
            assert len(world.of("GetAuthToken")) == 4, (
                "four requests: at first, one that fails, a minute later, an hour later"
            )
            assert not [one for one in world.streams if one.is_open and one.authority == p.AUTHORITIES["auth"]]
            await trio.sleep(3600.0)
            serving.check()

    virtual(test)


def test_missing_clock_updates_end_the_link_only_when_the_known_offset_is_old() -> None:
    async def test() -> None:
        world = World()
        wire = await ready(world)
        seen = await wire.read()
        async with served(wire) as serving:
            world.twin.muted = {"TimeSyncUpdate"}
            await pass_time(world, 70.0, wire)
            assert len(world.of("TimeSyncUpdate")) == 3, "time sync: twice at first, then after a minute"
            await wire.write(target(world, seen, vx=0.5), Go())
            await pass_time(world, 0.3, wire)
            assert world.twin.mechanism.present_twist[0] == pytest.approx(0.5), (
                "the robot walks with the last known clock offset"
            )
            serving.check()
            await trio.sleep(600.0)
            with pytest.raises(WireDown, match="TimeSyncUpdate"):
                serving.check()

    virtual(test)


def test_a_slow_clock_update_delays_no_call() -> None:
    async def test() -> None:
        world = World()
        wire = await ready(world)
        before_s = wire._time.skew_s
        async with served(wire) as serving:
            world.twin._sync_s, world.twin._sync_since_s = 2.0, None
            world.twin._skew_s += 7.0  # its clock was set again, and its name is unchanged
            await pass_time(world, 65.0, wire)
            serving.check()
            assert wire._time.skew_s == pytest.approx(before_s + 7.0, abs=0.05)

    virtual(test)


@contextlib.asynccontextmanager
async def served(wire: SpotWire) -> AsyncIterator[Serving]:
    """Serve a wire as the transport does."""
    serving = Serving()
    async with trio.open_nursery() as nursery:
        nursery.start_soon(serving.run, wire)
        await serving.ready.wait()
        yield serving
        nursery.cancel_scope.cancel()


# -- leases


def test_a_sign_that_is_overtaken_by_a_newer_command_is_no_lost_lease() -> None:
    async def test() -> None:
        world = World()
        wire = await ready(world)
        world.twin.leases._newest = [*world.twin.leases._newest[:1], 10**6]
        await pass_time(world, 1.2, wire)
        assert "lease" not in (await wire.read()).faults

    virtual(test)


def test_hosts_with_the_same_name_are_distinguished(tmp_path: Path) -> None:
    names = set()
    for number in ("a", "b"):
        (tmp_path / number).write_text(f"{number * 32}\n")
        names.add(own_name(tmp_path / number))
    assert len(names) == 2 and own_name(tmp_path / "none") == own_name(tmp_path / "none")
    assert all("a" * 32 not in name for name in names)


def test_a_stolen_lease_is_reported_with_its_new_owner_who_is_left_alone() -> None:
    async def test() -> None:
        world = World()
        wire = await ready(world)
        seen = await wire.read()
        world.twin.leases.acquire("tablet-7", take=True)
        await wire.write(target(world, seen, vx=0.5), Go())
        seen = await wire.read()
        assert seen.faults["lease"] == "the lease was taken over by tablet-7"
        assert world.twin.mechanism.target_twist == (0.0, 0.0, 0.0), "the robot did not carry the command out"
        (broken,) = [one for one in world.driver.conditions if one.check(seen, seen.t_ns)]
        refusal = broken.check(seen, seen.t_ns)
        assert isinstance(refusal, Refused) and "tablet-7" in refusal.reason
        assert confirmed(await wire.make_safe("hold"))
        assert world.safe() in ([], [""]), "nothing is sent that stops the other client"
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
        assert confirmed(reports), "our e-stop endpoint confirms the stop"
        assert reports[0].detail == "the lease was taken over by tablet-7, so it is not returned"
        assert world.of("ReturnLease") == [] and world.twin.leases.owner == "tablet-7"

    virtual(test)
