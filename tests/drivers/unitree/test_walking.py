"""Test a Go2 that walks by its onboard controller: lifetimes, stops, postures and refusals.

The tests run in virtual time and read the twin's log of the wire. The twin keeps a velocity for ever.
"""

from __future__ import annotations

import math
from collections.abc import Awaitable, Callable
from pathlib import Path

import pytest
import trio

from strands_actors import Robot
from strands_actors.contract.driver import Reason
from strands_actors.contract.safe_state import SafeState
from strands_actors.drivers.common.codecs.malformed import MalformedFrame
from strands_actors.drivers.unitree import rpc
from strands_actors.drivers.unitree.driver import Go2Driver
from strands_actors.drivers.unitree.twin.gait import REST, Gait
from strands_actors.drivers.unitree.walking.sport import BALANCE, DAMPING, LIE, LOCK, SIT
from strands_actors.drivers.unitree.walking.states import (
    STATE_BYTES,
    SportState,
    decode_state,
    encode_state,
)
from strands_actors.drivers.unitree.walking.stop import STOP_S, WalkingStopChannel
from strands_actors.kernel.clock import NS, VirtualClock
from strands_actors.kernel.messages import Refused
from strands_actors.supervisors.gate.messages import Accepted, Performed, Stop, StopReport
from strands_actors.testing import run_virtual

from .walking_world import TICK_S, Commander, World


@pytest.fixture
def world(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> World:
    return World(tmp_path, monkeypatch)


def on(world: World, act: Callable[[Commander], Awaitable[None]]) -> None:
    async def test() -> None:
        async with world.tree() as robot:
            await act(robot)

    run_virtual(test)


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
        assert world.gait.twist == REST and world.gait.mode == BALANCE
        assert world.gait.position[0] == pytest.approx(0.5 * stop_s, abs=0.5 * 2 * TICK_S)
        await robot.acquire()
        assert isinstance(await robot.move(vx=0.1), Accepted), "after a hold the next velocity is accepted"

    on(world, act)


# -- stops


def test_saf_002_a_stop_leaves_the_robot_on_its_feet_and_disarmed(world: World) -> None:
    async def act(robot: Commander) -> None:
        await robot.move(vx=0.5)
        began_ns = round(trio.current_time() * NS)
        report = await robot.tree.gate.ask(Stop(Reason.STOP), 5.0)
        assert isinstance(report, StopReport) and report.confirmed and report.safe_state == "stop"
        world.log.safe_within(began_ns, 0.001)
        world.log.no_setpoint_after_safe(began_ns)
        assert world.gait.mode == BALANCE and rpc.DAMP not in world.asked()
        refused = await robot.move(vx=0.5)
        assert isinstance(refused, Refused) and refused.code == "disarmed"

    on(world, act)


def test_saf_007_an_e_stop_damps_the_robot_and_only_stand_up_mends_that(world: World) -> None:
    async def act(robot: Commander) -> None:
        await robot.move(vx=0.5)
        report = await robot.tree.gate.ask(Stop(Reason.ESTOP, "test", lock=True), 5.0)
        assert isinstance(report, StopReport) and report.confirmed and report.safe_state == "damp"
        assert world.gait.mode == DAMPING
        assert "damp" in {entry.safe_state for entry in world.log.host("safe")}, "the log has the vendor's Damp"
        await robot.resume()
        refused = await robot.move(vx=0.5)
        assert isinstance(refused, Refused) and (refused.code, refused.remedy) == (
            "posture",
            "call stand_up() first",
        )
        done = await robot.do("stand_up")
        assert isinstance(done, Performed) and done.result == {"mode": "balance stand", "already": False}
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
        report = await robot.tree.gate.ask(Stop(Reason.STOP), 2 * STOP_S)
        assert isinstance(report, StopReport) and not report.confirmed
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
        with monkeypatch.context() as patch:
            patch.setattr(Gait, "_turn", lambda *_: None)
            report = await robot.tree.gate.ask(Stop(Reason.STOP), 2 * STOP_S)
        assert isinstance(report, StopReport) and not report.confirmed
        assert all(motor.acknowledged for motor in report.motors)
        assert "it reports speed 0.50" in report.motors[0].detail

    on(world, act)


# -- refusals, which are not written


@pytest.mark.parametrize(
    ("api", "mode", "remedy"),
    [
        (rpc.STAND_DOWN, LIE, "call stand_up() first"),
        (rpc.SIT, SIT, "call rise() first"),
        (rpc.STAND_UP, LOCK, "call stand_up() first"),
    ],
)
def test_saf_014_a_velocity_that_the_robot_would_ignore_is_not_sent(
    world: World, api: int, mode: int, remedy: str
) -> None:
    """The robot answers success, but the twin shows that it does not move."""

    async def act(robot: Commander) -> None:
        world.gait.order(api, {})
        await trio.sleep(1.5)
        assert world.gait.mode == mode
        assert world.gait.order(rpc.MOVE, {"x": 0.5, "y": 0.0, "z": 0.0})[0] == rpc.OK
        assert world.gait.twist == REST
        refused = await robot.move(vx=0.5)
        assert isinstance(refused, Refused) and (refused.code, refused.remedy) == ("posture", remedy)
        assert not world.log.host("setpoint")

    on(world, act)


@pytest.mark.parametrize(
    ("action", "code"),
    [
        ({"vx": 3.9}, "past_travel"),
        ({"vy": -1.1}, "past_travel"),
        ({"wz": math.nan}, "not_finite"),
        ({"FL_hip_joint": 0.1}, "level"),
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


def test_a_released_robot_is_refused_until_its_sport_mode_is_selected(world: World) -> None:
    async def act(robot: Commander) -> None:
        world.server.onboard.set_mode("")
        await trio.sleep(0.3)
        refused = await robot.move(vx=0.5)
        assert isinstance(refused, Refused) and refused.code == "sport_mode_released"
        assert "select_sport_mode()" in refused.remedy and not world.log.host("setpoint")
        done = await robot.do("select_sport_mode")
        assert isinstance(done, Performed) and done.result["onboard_mode"] == "normal"
        await trio.sleep(0.3)
        assert isinstance(await robot.move(vx=0.5), Accepted)

    on(world, act)


def test_postures_are_done_when_the_robot_reports_them(world: World) -> None:
    async def act(robot: Commander) -> None:
        for service, mode in (("lie_down", LIE), ("stand_up", BALANCE), ("sit", SIT), ("rise", BALANCE)):
            done = await robot.do(service)
            assert isinstance(done, Performed) and not done.result["already"], done
            assert world.gait.mode == mode
        done = await robot.do("balance")
        assert isinstance(done, Performed) and done.result["already"]
        await robot.do("sit")
        refused = await robot.do("lie_down")
        assert isinstance(refused, Refused) and "not possible in the mode sitting" in refused.reason

    on(world, act)


def test_saf_006_a_stop_cuts_a_posture_short(world: World) -> None:
    async def act(robot: Commander) -> None:
        await robot.do("lie_down")
        async with trio.open_nursery() as nursery:
            answers: list[object] = []

            async def stand_up() -> None:
                answers.append(await robot.do("stand_up"))

            nursery.start_soon(stand_up)
            await trio.sleep(0.1)
            began_ns = round(trio.current_time() * NS)
            report = await robot.tree.gate.ask(Stop(Reason.STOP), 10.0)
            assert isinstance(report, StopReport) and report.confirmed
            world.log.safe_within(began_ns, 0.001)
        assert isinstance(answers[0], Refused) and rpc.STAND_UP not in world.asked(began_ns / NS + 0.001)

    on(world, act)


# -- the two levels refuse each other


def test_joints_and_walking_are_two_levels_of_one_robot() -> None:
    low = Go2Driver("unitree_go2", "127.0.0.77", {})
    for service in ("move", "stand_up", "lie_down", "balance"):
        refused = low.check_service(service, {})
        assert refused is not None and refused.code == "level" and "level='sport'" in refused.remedy
    robot = Robot("unitree_go2", mode="real", port="127.0.0.77", level="sport")
    refused = robot.driver.check_service("release_sport_mode", {})
    assert refused is not None and refused.code == "level" and "level='low'" in refused.remedy
    assert {"move", "stand_up", "release_sport_mode"} <= set(dir(robot))
    with pytest.raises(ValueError, match="only b2, unitree_go2, unitree_h1 have level='sport'"):
        Robot("h1_2", mode="real", port="127.0.0.77", level="sport")
    with pytest.raises(ValueError, match="level"):
        Robot("go2", mode="real", port="127.0.0.77", level="high")
    assert "sit" not in Robot("b2", mode="real", port="127.0.0.77", level="sport").driver.SERVICES


# -- the codec


def test_a_state_is_read_as_it_was_written() -> None:
    state = SportState(12 * NS + 34, 3, (1.0, -2.0, 0.25), (0.5, -0.25, 0.125), (1.0, 0.0, 0.0, 0.0), 0.25)
    body = encode_state(state)
    assert len(body) == STATE_BYTES == 512
    assert body[65] == 3 and decode_state(body) == state, "the mode follows the temperature of the IMU"


@pytest.mark.parametrize("size", [0, 1, 111])
def test_a_truncated_state_is_refused(size: int) -> None:
    body = encode_state(SportState(1, 1, (0.0,) * 3, (0.0,) * 3, (1.0, 0.0, 0.0, 0.0), 0.3))
    with pytest.raises(MalformedFrame, match=f"512 bytes, not {size}"):
        decode_state(body[:size])


def test_a_state_with_an_invalid_number_is_refused() -> None:
    with pytest.raises(MalformedFrame, match="not finite"):
        decode_state(encode_state(SportState(1, 1, (math.nan, 0.0, 0.0), (0.0,) * 3, (1.0, 0.0, 0.0, 0.0), 0.3)))
