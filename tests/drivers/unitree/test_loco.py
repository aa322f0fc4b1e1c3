"""Test a G1 and an H1 that walk by their locomotion service, in virtual time.

The tests cover lifetimes, stops, postures and refusals, and read the twin's log of the wire. The twin keeps a
velocity for ever unless a test changes that.
"""

from __future__ import annotations

import json
import math
import struct
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

import pytest
import trio

from strands_actors import Robot
from strands_actors.contract.driver import Reason
from strands_actors.contract.safe_state import SafeState
from strands_actors.drivers import get_native_driver_class
from strands_actors.drivers.unitree import rpc
from strands_actors.drivers.unitree.driver import G1Driver, Go2Driver
from strands_actors.drivers.unitree.protocol import COMMAND_BYTES
from strands_actors.drivers.unitree.twin.gait import REST, Gait
from strands_actors.drivers.unitree.twin.loco import LocoGait
from strands_actors.drivers.unitree.walking.loco import DAMP, G1, H1, SIT, SQUAT, ZERO_TORQUE, LocoDialect
from strands_actors.drivers.unitree.walking.odometry import Odometry
from strands_actors.drivers.unitree.walking.stop import STOP_S, WalkingStopChannel
from strands_actors.kernel.clock import NS, VirtualClock
from strands_actors.kernel.messages import Refused
from strands_actors.supervisors.gate.messages import Accepted, Performed, Stop, StopReport
from strands_actors.testing import run_virtual
from strands_actors.testing.registering import column, prepare

from .walking_world import TICK_S, Commander, World

WORDS: dict[str, LocoDialect] = {"unitree_g1": G1, "unitree_h1": H1}
MakeWorld = Callable[..., World]


@pytest.fixture
def make_world(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> MakeWorld:
    def make(robot: str, **options: float) -> World:
        world = World(tmp_path, monkeypatch, robot, **options)
        # the test does not need physics
        monkeypatch.setattr(world.server.onboard.body, "catch_up", lambda now_s: None)
        return world

    return make


@pytest.fixture(params=WORDS)
def world(request: pytest.FixtureRequest, make_world: MakeWorld) -> World:
    return make_world(request.param)


def words_of(world: World) -> LocoDialect:
    return WORDS[world.driver.robot]


def on(world: World, act: Callable[[Commander], Awaitable[None]]) -> None:
    async def test() -> None:
        async with world.tree() as robot:
            await act(robot)

    run_virtual(test)


def numbers_asked(world: World, since_ns: int = 0) -> list[int]:
    """Return the FSM ids that the robot was set to, in order."""
    entries = (entry for entry in world.log.entries(since_ns) if entry.sender == "host" and entry.kind != "read")
    requests = [rpc.decode_request(entry.data) for entry in entries]
    set_mode = words_of(world).set_mode
    return [json.loads(request.parameter)["data"] for request in requests if request.api == set_mode]


async def stop(robot: Commander, reason: Reason = Reason.STOP, within_s: float = 5.0) -> StopReport:
    report = await robot.tree.gate.ask(Stop(reason, "test", lock=reason is Reason.ESTOP), within_s)
    assert isinstance(report, StopReport)
    return report


# -- lifetime


def test_saf_001_a_velocity_ends_with_its_lifetime_and_the_robot_stands(world: World) -> None:
    async def act(robot: Commander) -> None:
        began_s = trio.current_time()
        assert isinstance(await robot.move(vx=0.5), Accepted)
        await robot.tree.until("holding")
        await trio.sleep(0.5)
        moves = [entry.t_ns / NS - began_s for entry in world.log.host("setpoint", round(began_s * NS))]
        stop_s = world.log.host("safe", round(began_s * NS))[0].t_ns / NS - began_s
        assert 3 <= len(moves) <= 4, "the velocity is re-sent ten times a second"
        assert max(moves) < 0.3 < stop_s <= 0.3 + 0.02
        world.log.no_setpoint_after_safe(round(began_s * NS))
        assert world.gait.twist == REST and world.gait.mode in words_of(world).walks
        assert world.gait.position[0] == pytest.approx(0.5 * stop_s, abs=0.5 * 2 * TICK_S)
        assert not numbers_asked(world)
        await robot.acquire()
        assert isinstance(await robot.move(vx=0.1), Accepted), "after a hold the next velocity is accepted"

    on(world, act)


def test_saf_001_the_robot_ends_a_velocity_by_itself_without_requests(make_world: MakeWorld) -> None:
    """The duration is part of the request."""
    world = make_world("unitree_g1", keeps_s=1.0)

    async def act(robot: Commander) -> None:
        assert isinstance(await robot.move(vx=0.5), Accepted)
        world.bus.deaf = True
        await trio.sleep(0.3 + 2 * TICK_S)
        assert world.gait.twist == REST
        world.bus.deaf = False

    on(world, act)


# -- stops


def test_a_stop_does_not_end_another_program_s_arms_and_an_e_stop_does(make_world: MakeWorld) -> None:
    """The driver does not see a program that commands the arms by rt/arm_sdk. docs/robots/unitree.md says so."""
    world = make_world("unitree_g1")
    onboard = world.server.onboard
    frame = bytearray(COMMAND_BYTES["hg"])
    struct.pack_into("<f", frame, 28 * 29 + 4, 1.0)  # the weight
    struct.pack_into("<5f", frame, 28 * 18 + 4, 0.5, 0.0, 0.0, 60.0, 1.5)  # the left elbow

    async def act(robot: Commander) -> None:
        await robot.move(vx=0.5)
        onboard.command_arms(bytes(frame), trio.current_time())
        report = await stop(robot)
        assert report.confirmed and world.gait.twist == REST
        assert onboard.arm_joints == (18,), "the arms follow the other program"
        report = await stop(robot, Reason.ESTOP)
        assert report.confirmed and not onboard.arm_joints

    on(world, act)


def test_saf_002_a_stop_leaves_the_robot_on_its_feet_and_disarmed(world: World) -> None:
    async def act(robot: Commander) -> None:
        await robot.move(vx=0.5)
        began_ns = round(trio.current_time() * NS)
        report = await stop(robot)
        assert report.confirmed and report.safe_state == "stop"
        world.log.safe_within(began_ns, 0.001)
        world.log.no_setpoint_after_safe(began_ns)
        assert world.gait.mode in words_of(world).walks and not numbers_asked(world)
        refused = await robot.move(vx=0.5)
        assert isinstance(refused, Refused) and refused.code == "disarmed"

    on(world, act)


def test_saf_007_an_e_stop_damps_the_robot_and_only_stand_up_mends_that(world: World) -> None:
    async def act(robot: Commander) -> None:
        await robot.move(vx=0.5)
        report = await stop(robot, Reason.ESTOP)
        assert report.confirmed and report.safe_state == "damp"
        assert world.gait.mode == DAMP and ZERO_TORQUE not in numbers_asked(world)
        await robot.resume()
        refused = await robot.move(vx=0.5)
        assert isinstance(refused, Refused)
        assert (refused.code, refused.remedy) == ("posture", "call stand_up() first")
        done = await robot.do("stand_up")
        assert isinstance(done, Performed) and done.result == {"mode": "start", "already": False}
        assert isinstance(await robot.move(vx=0.5), Accepted)

    on(world, act)


def test_saf_022_the_stop_of_the_root_leaves_before_its_first_wait(world: World) -> None:
    async def test() -> None:
        channel = WalkingStopChannel(world.driver.config, (), VirtualClock())
        await trio.sleep(1.0)
        async with trio.open_nursery() as nursery:
            nursery.start_soon(world.live)
            await nursery.start(channel.serve)
            world.gait._move((0.5, 0.0, 0.0))
            await trio.sleep(0.2)
            began_ns = round(trio.current_time() * NS)
            motors = await channel.make_safe(SafeState.STOP)
            assert all(motor.safe for motor in motors), motors
            assert world.log.first_safe(began_ns).t_ns == began_ns  # type: ignore[union-attr]
            assert world.gait.twist == REST
            nursery.cancel_scope.cancel()

    run_virtual(test)


def test_saf_023_a_stop_that_is_not_answered_is_not_confirmed(world: World) -> None:
    async def act(robot: Commander) -> None:
        await robot.move(vx=0.5)
        world.bus.deaf = True
        report = await stop(robot, within_s=2 * STOP_S)
        assert not report.confirmed
        assert all("it has not answered" in motor.detail for motor in report.motors)
        world.bus.deaf = False
        await robot.tree.until("disarmed")
        assert world.gait.twist == REST, "the stop is tried again"

    on(world, act)


def test_saf_021_a_robot_that_answers_and_walks_on_is_not_confirmed(
    world: World, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def act(robot: Commander) -> None:
        await robot.move(vx=0.5)
        await trio.sleep(0.2)
        with monkeypatch.context() as patch:
            patch.setattr(Gait, "_turn", lambda *_: None)
            report = await stop(robot, within_s=2 * STOP_S)
        assert not report.confirmed
        assert all(motor.acknowledged for motor in report.motors)
        assert "it reports speed 0.5" in report.motors[0].detail

    on(world, act)


def test_saf_021_a_stop_overtakes_standing_up_and_nothing_follows_it(world: World) -> None:
    """The robot then stands with locked joints. The request to walk is never sent."""

    async def act(robot: Commander) -> None:
        await robot.do("damp")
        async with trio.open_nursery() as nursery:
            answers: list[object] = []

            async def stand_up() -> None:
                answers.append(await robot.do("stand_up"))

            nursery.start_soon(stand_up)
            await trio.sleep(0.1)
            began_ns = round(trio.current_time() * NS)
            report = await stop(robot, within_s=10.0)
            assert report.confirmed
            world.log.safe_within(began_ns, 0.001)
        await trio.sleep(3.0)
        words = words_of(world)
        assert isinstance(answers[0], Refused) and not numbers_asked(world, began_ns + NS // 1000)
        assert world.gait.mode == words.stand and words.start not in numbers_asked(world)

    on(world, act)


def test_saf_023_a_g1_without_odometry_is_confirmed_after_the_report_time(
    make_world: MakeWorld,
) -> None:
    """The root begins to receive odometry when it stops the robot. The answer alone would confirm the stop at
    once."""
    world = make_world("unitree_g1")
    world.server._gait_writer = None

    async def act(robot: Commander) -> None:
        assert isinstance(await robot.move(vx=0.5), Accepted)
        report = await stop(robot)
        assert report.confirmed and world.gait.twist == REST
        channel = WalkingStopChannel(world.driver.config, (), VirtualClock())
        async with trio.open_nursery() as nursery:
            await nursery.start(channel.serve)
            began_s = trio.current_time()
            motors = await channel.make_safe(SafeState.STOP)
            assert all(motor.safe for motor in motors), motors
            assert 0.59 < trio.current_time() - began_s < 1.0
            nursery.cancel_scope.cancel()

    on(world, act)


@pytest.mark.parametrize("mode", [DAMP, 500])
def test_saf_021_a_stop_that_is_refused_counts_only_of_a_robot_that_rests(
    make_world: MakeWorld, monkeypatch: pytest.MonkeyPatch, mode: int
) -> None:
    world = make_world("unitree_g1")
    order = LocoGait.order

    def refuse(gait: LocoGait, api: int, parameter: dict[str, Any]) -> tuple[int, Any]:
        return (7301, None) if api == rpc.SET_VELOCITY else order(gait, api, parameter)

    async def act(robot: Commander) -> None:
        world.server.onboard.set_fsm(mode)
        await trio.sleep(0.2)
        monkeypatch.setattr(LocoGait, "order", refuse)
        report = await stop(robot)
        assert report.confirmed is (mode == DAMP)
        assert report.confirmed or "the locomotion state is missing" in report.motors[0].detail

    on(world, act)


# -- refusals, which are not written


@pytest.mark.parametrize(
    ("robot_name", "mode", "remedy"),
    [
        ("unitree_g1", ZERO_TORQUE, "call damp() first"),
        ("unitree_g1", SQUAT, "call stand_up() first"),
        ("unitree_g1", SIT, "call stand_up() first"),
        ("unitree_g1", G1.stand, "call stand_up() first"),
        ("unitree_g1", 702, "wait until this motion has ended"),
        ("unitree_h1", DAMP, "call stand_up() first"),
        ("unitree_h1", H1.stand, "call stand_up() first"),
    ],
)
def test_saf_014_a_velocity_that_the_robot_would_ignore_is_not_sent(
    make_world: MakeWorld, robot_name: str, mode: int, remedy: str
) -> None:
    """The robot answers success, but the twin shows that it does not move."""
    world = make_world(robot_name)

    async def act(robot: Commander) -> None:
        world.server.onboard.set_fsm(mode)
        await trio.sleep(0.5)
        velocity = {"velocity": [0.5, 0.0, 0.0], "duration": 1.0}
        assert world.gait.order(words_of(world).set_velocity, velocity)[0] == rpc.OK
        assert world.gait.twist == REST
        refused = await robot.move(vx=0.5)
        assert isinstance(refused, Refused) and (refused.code, refused.remedy) == ("posture", remedy)
        assert not world.log.host("setpoint")

    on(world, act)


@pytest.mark.parametrize(
    ("action", "code"),
    [
        ({"vx": 1.1}, "past_travel"),
        ({"wz": math.nan}, "not_finite"),
        ({"left_elbow": 0.1}, "level"),
        ({"vz": 0.1}, "unknown_joint"),
        ({}, "empty"),
    ],
)
def test_saf_014_an_invalid_command_is_not_written(world: World, action: dict[str, float], code: str) -> None:
    async def act(robot: Commander) -> None:
        refused = await robot.move(**action)
        assert isinstance(refused, Refused) and refused.code == code, refused
        assert not world.log.host("setpoint")

    on(world, act)


# -- postures


def test_postures_are_done_when_the_robot_reports_them(make_world: MakeWorld) -> None:
    world = make_world("unitree_g1")

    async def act(robot: Commander) -> None:
        for service, mode in (("squat", SQUAT), ("stand_up", G1.start), ("sit", SIT), ("damp", DAMP)):
            done = await robot.do(service)
            assert isinstance(done, Performed) and not done.result["already"], done
            assert world.gait.mode == mode
        refused = await robot.do("balance")
        assert isinstance(refused, Refused) and "not possible in the mode damp" in refused.reason
        done = await robot.do("damp")
        assert isinstance(done, Performed) and done.result["already"]

    on(world, act)


def test_saf_021_a_robot_that_answers_and_does_not_stand_up_is_no_success(
    world: World, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def act(robot: Commander) -> None:
        await robot.do("damp")
        monkeypatch.setattr(LocoGait, "_goes_to", lambda *_: False)
        answers: list[object] = []

        async def stand_up() -> None:
            answers.append(await robot.do("stand_up"))

        async with trio.open_nursery() as nursery:
            nursery.start_soon(stand_up)
            await trio.sleep(2.0)
            assert not answers and len(numbers_asked(world)) > 3, "the state is requested again"
            await stop(robot)
        assert isinstance(answers[0], Refused) and world.gait.mode == DAMP


def test_saf_021_a_robot_whose_joints_still_move_has_not_stood_up(make_world: MakeWorld) -> None:
    """It reports the new state at once. The wire sends Start only when the joints have come to rest."""
    world = make_world("unitree_g1")

    async def act(robot: Commander) -> None:
        await robot.do("damp")
        moves = [0.5] * len(world.server.onboard.model.joints)
        rests = world.server.onboard.body.velocity_rad_s
        body = type(world.server.onboard.body)
        answers: list[object] = []

        async def stand_up() -> None:
            answers.append(await robot.do("stand_up"))

        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(body, "velocity_rad_s", property(lambda _: moves))
            async with trio.open_nursery() as nursery:
                nursery.start_soon(stand_up)
                await trio.sleep(2.0)
                assert world.gait.mode == G1.stand and G1.start not in numbers_asked(world)
                patch.setattr(body, "velocity_rad_s", property(lambda _: rests))
        assert isinstance(answers[0], Performed) and world.gait.mode == G1.start

    on(world, act)


def test_the_twin_walks_only_once_it_has_stood_up(make_world: MakeWorld) -> None:
    """The twin ignores a toggle or a number, yet answers success, as the robot does."""
    gait = make_world("unitree_g1").gait
    gait.advance(1.0)
    for number in (DAMP, 500, SQUAT, 500, 4, 500):
        assert gait.order(rpc.SET_FSM_ID, {"data": number}) == (rpc.OK, None)
        assert gait.mode == (number if number != 500 else gait.mode) and not gait.walks
    gait.advance(3.0)
    gait.order(rpc.SET_FSM_ID, {"data": 500})
    assert gait.walks
    assert gait.order(rpc.SET_FSM_ID, {"data": 4711}) == (rpc.NO_SUCH_FSM, None)


# -- the two levels refuse each other


def test_joints_and_walking_are_two_levels_of_one_robot() -> None:
    for low in (G1Driver("unitree_g1", "127.0.0.77", {}), Go2Driver("unitree_h1", "127.0.0.77", {})):
        for service in ("move", "stand_up", "balance", "damp"):
            refused = low.check_service(service, {})
            assert refused is not None and refused.code == "level" and "level='sport'" in refused.remedy
    h1_2 = Go2Driver("unitree_h1_2", "127.0.0.77", {}).check_service("move", {})
    assert h1_2 is not None and "level='sport'" not in h1_2.remedy
    robot = Robot("h1", mode="real", port="127.0.0.77", level="sport")
    refused = robot.driver.check_service("release_sport_mode", {})
    assert refused is not None and refused.code == "level" and "level='low'" in refused.remedy
    assert "release_sport_mode" not in dir(Robot("g1", mode="real", port="127.0.0.77", level="sport"))


# -- odometry


def test_a_speed_is_the_difference_of_two_poses_in_the_frame_of_the_body() -> None:
    odometry = Odometry()
    odometry.take_mode(204, NS)
    assert odometry.state() is not None and not odometry.reports_speed
    odometry.take_pose((1.0, 2.0, math.pi / 2), NS)
    odometry.take_pose((1.0, 2.05, math.pi / 2), NS + NS // 10)
    state = odometry.state()
    assert state is not None and state.velocity == pytest.approx((0.5, 0.0, 0.0))
    assert odometry.stamp_ns == NS, "the stamp is that of the older of mode and pose"
    odometry.take_mode(1, NS // 2)
    assert odometry.state() == state, "an older answer changes nothing"
    odometry.take_pose((1.0, 2.05, -math.pi + 0.1), NS + 2 * NS // 10)
    turned = odometry.state()
    assert turned is not None and turned.velocity[2] == pytest.approx(10 * (math.pi / 2 + 0.1))


@pytest.mark.parametrize("data", ['{"x": 1, "y": 2}', '{"x": 1, "y": 2, "z": NaN}', '{"x": 1, "y": 2, "z": "a"}'])
def test_an_invalid_pose_is_refused(data: str) -> None:
    with pytest.raises(ValueError, match="pose"):
        rpc.odometry(rpc.Response(1, rpc.LOCO_GET_ODOM, 0, data))


def test_the_bench_of_a_robot_that_walks_leaves_the_other_level_as_it_is() -> None:
    """One process measures both levels, one after the other."""
    prepare("unitree_g1:sport", "")
    assert get_native_driver_class("unitree_g1") is G1Driver
    assert column("unitree_g1:sport")[1].endswith(":G1Walking")
