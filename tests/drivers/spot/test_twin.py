"""Test the twin by itself, in virtual time: how long it takes, its login, and the commands that it refuses."""

from __future__ import annotations

import math
from typing import Any

import pytest
import trio

from strands_actors.drivers.common.physics.body import Commander
from strands_actors.drivers.spot import protocol as p
from strands_actors.drivers.spot.messages import Message, decode
from strands_actors.drivers.spot.protocol import Motors
from strands_actors.drivers.spot.twin import SpotTwin
from strands_actors.drivers.spot.twin.commands import CLOCK
from strands_actors.drivers.spot.twin.directory import Directory
from strands_actors.drivers.spot.twin.feedback import OVERRIDDEN, PROCESSING
from strands_actors.drivers.spot.twin.limbs import HIPS, foot_at, leg_to
from strands_actors.drivers.spot.twin.login import TOKEN_S
from strands_actors.drivers.spot.twin.paths import Path
from tests.drivers.common.memory_port import virtual

from .rig import World, let_a_tablet_drive


def own_twin(**options: Any) -> SpotTwin:
    """Return a twin at the robot's own pace, with its motors on and the e-stop released."""
    world = World(haste=1.0, **options)
    let_a_tablet_drive(world)
    return world.twin


def mobility(name: str, content: Message | None = None, **params: Any) -> Message:
    command: Message = {name: content or {}}
    if params:
        command["params"] = {"type_url": p.MOBILITY_PARAMS, "value": params}
    return {"synchronized_command": {"mobility_command": command}}


def send(twin: SpotTwin, command: Message) -> tuple[p.Command, int]:
    twin.pass_time()
    return twin.commands.carry_out(command, CLOCK, is_estopped=False)


def base_feedback(twin: SpotTwin, number: int) -> Message:
    twin.pass_time()
    feedback: Message = twin.commands.feedback(number)["synchronized_feedback"]["mobility_command_feedback"]
    return feedback


async def seconds_until(twin: SpotTwin, number: int, name: str) -> float:
    """Return how long a command takes that reports 2 (in progress), then 1 (done)."""
    began_s, seen = trio.current_time(), []
    while not seen or seen[-1] != 1:
        seen.append(base_feedback(twin, number)[name]["status"])
        await trio.sleep(0.01)
    assert set(seen[:-1]) == {2} and len(seen) > 10
    return trio.current_time() - began_s


# -- the robot's time


def test_powering_on_standing_up_and_sitting_take_the_robots_time() -> None:
    async def test() -> None:
        twin = own_twin()
        twin.mechanism.motors = Motors.OFF
        twin.mechanism.power_on()
        began_s = trio.current_time()
        while twin.mechanism.motors is not Motors.ON:
            assert twin.state()["power_state"]["motor_power_state"] == Motors.POWERING_ON
            await trio.sleep(0.01)
            twin.pass_time()
        assert trio.current_time() - began_s == pytest.approx(2.0, abs=0.05)
        _, number = send(twin, mobility("stand_request"))
        assert twin.state()["behavior_state"]["state"] == 2, "from sitting to standing"
        assert await seconds_until(twin, number, "stand_feedback") == pytest.approx(2.0, abs=0.05)
        assert twin.state()["behavior_state"]["state"] == 3
        _, number = send(twin, mobility("sit_request"))
        assert await seconds_until(twin, number, "sit_feedback") == pytest.approx(2.5, abs=0.05)
        assert twin.state()["behavior_state"]["state"] == 1

    virtual(test)


def test_a_twist_that_ends_before_the_robot_stands_moves_it_nowhere() -> None:
    async def test() -> None:
        twin = own_twin()
        end = {"end_time": p.stamp(twin.robot_ns() + p.NS), "se2_frame_name": "body"}
        status, _ = send(twin, mobility("se2_velocity_request", {**end, "velocity": {"linear": {"x": 0.5}}}))
        assert status is p.Command.OK
        for _ in range(30):
            await trio.sleep(0.1)
            twin.pass_time()
        assert twin.mechanism.stands and twin.mechanism.x_m == 0.0

    virtual(test)


def test_a_body_that_is_moved_reports_its_speed() -> None:
    """A stop is confirmed only by a robot at rest."""

    async def test() -> None:
        twin = own_twin()
        twin.mechanism.up, twin.mechanism.wants_up = 1.0, True
        raised = {"points": [{"pose": {"position": {"z": 0.08}}}]}
        send(twin, mobility("stand_request", body_control={"base_offset_rt_footprint": raised}))
        await trio.sleep(0.1)
        twin.pass_time()
        speed = twin.state()["kinematic_state"]["velocity_of_body_in_odom"]["linear"]["z"]
        assert speed == pytest.approx(0.3)
        twin.mechanism.halt()
        twin.mechanism.run(0.01)
        assert twin.state()["kinematic_state"]["velocity_of_body_in_odom"]["linear"]["z"] == 0.0
        assert 0.02 < twin.mechanism.posture.offset[2] < 0.05, "it stays where it was stopped"

    virtual(test)


# -- login


def test_only_the_user_of_its_options_logs_in() -> None:
    async def test() -> None:
        twin = World(user="anna", password="secret").twin
        for login in ({}, {"username": "twin", "password": "twin"}, {"username": "anna", "password": "Secret"}):
            assert twin.logins.log_in(login) == {"status": 2}, login
        answer = twin.logins.log_in({"username": "anna", "password": "secret"})
        assert answer["status"] == p.OK and twin.logins.is_valid(answer["token"])
        again = twin.logins.log_in({"token": answer["token"]})
        assert again["status"] == p.OK and again["token"] != answer["token"]
        assert twin.logins.log_in({"token": "forged"}) == {"status": 3}

    virtual(test)


def test_a_call_without_a_valid_token_is_refused_and_one_that_is_too_old_too() -> None:
    async def test() -> None:
        world = World()
        token = world.twin.logins.log_in({"username": "twin", "password": "twin"})["token"]
        state, login = p.METHODS["GetRobotState"].path, p.METHODS["GetAuthToken"].path
        allows = world.twin.logins.allows
        assert allows(login, "") and not allows(state, "")
        assert allows(state, f"Bearer {token}") and not allows(state, token) and not allows(state, "Bearer forged")
        await trio.sleep(TOKEN_S)
        assert not allows(state, f"Bearer {token}")
        assert world.twin.logins.log_in({"token": token}) == {"status": 3}

    virtual(test)


def test_a_request_without_a_token_has_no_effect() -> None:
    async def test() -> None:
        world = World()
        wire = world.wire()
        await wire.open()
        session = wire.session
        session._token = "forged"
        with pytest.raises(Exception, match="no valid token"):
            await session.call("TakeLease", {"resource": p.LEASE_RESOURCE})
        assert world.twin.leases.owner == "" and world.of("TakeLease") == []

    virtual(test)


# -- commands that are refused


TRAJECTORY = {"points": [{"pose": {"position": {"x": 1.0}}}]}


@pytest.mark.parametrize(
    ("command", "status"),
    [
        ({}, p.Command.INVALID_REQUEST),
        ({"synchronized_command": {}}, p.Command.INVALID_REQUEST),
        (mobility("stance_request"), p.Command.EXPIRED),
        (mobility("freeze_request"), p.Command.UNSUPPORTED),
        ({"full_body_command": {"freeze_request": {}}}, p.Command.UNSUPPORTED),
        ({"synchronized_command": {"arm_command": {"arm_drag_command": {}}}}, p.Command.UNSUPPORTED),
        ({"synchronized_command": {"arm_command": {"arm_gaze_command": {}}}}, p.Command.UNKNOWN_FRAME),
        ({"synchronized_command": {"arm_command": {"arm_cartesian_command": {}}}}, p.Command.UNKNOWN_FRAME),
        ({"synchronized_command": {"arm_command": {"arm_velocity_command": {}}}}, p.Command.EXPIRED),
        (mobility("se2_velocity_request"), p.Command.EXPIRED),
        (mobility("se2_trajectory_request", {"trajectory": TRAJECTORY}), p.Command.EXPIRED),
        ({"synchronized_command": {"arm_command": {"arm_joint_move_command": {}}}}, p.Command.INVALID_REQUEST),
        ({"synchronized_command": {"gripper_command": {"claw_gripper_command": {}}}}, p.Command.INVALID_REQUEST),
        (
            {"synchronized_command": {"mobility_command": {"sit_request": {}, "stand_request": {}}}},
            p.Command.INVALID_REQUEST,
        ),
        (
            {
                "synchronized_command": {
                    "mobility_command": {"stand_request": {}, "params": {"type_url": "x/Other"}}
                }
            },
            p.Command.INVALID_REQUEST,
        ),
        (
            mobility(
                "stand_request",
                body_control={"base_offset_rt_footprint": {"points": [{"pose": {"rotation": {"w": 0.2}}}]}},
            ),
            p.Command.INVALID_REQUEST,
        ),
        (mobility("stand_request", vel_limit={"max_vel": {"angular": math.nan}}), p.Command.INVALID_REQUEST),
    ],
)
def test_a_refused_command_changes_nothing_and_has_no_number(command: Message, status: p.Command) -> None:
    async def test() -> None:
        twin = own_twin()
        reply, _ = twin.answer(
            "RobotCommand",
            {"command": command, "lease": twin.leases.listed()["lease"], "clock_identifier": CLOCK},
        )
        assert reply["status"] == status and "robot_command_id" not in reply
        assert not twin.mechanism.wants_up and twin.mechanism.commander is Commander.NONE
        assert twin.commands.feedback(1) == {}

    virtual(test)


def test_an_asserted_e_stop_refuses_commands_and_power() -> None:
    """Also while the robot still sits down, before its motors are off."""

    async def test() -> None:
        twin = own_twin()
        assert twin.mechanism.motors is Motors.ON
        assert twin.commands.carry_out(mobility("stand_request"), CLOCK, is_estopped=True) == (
            p.Command.NOT_POWERED_ON,
            0,
        )
        assert not twin.mechanism.wants_up
        twin.estop.pressed = True
        twin.pass_time()
        request = {"lease": twin.leases.listed()["lease"], "request": p.POWER_ON}
        assert twin.answer("PowerCommand", request)[0]["status"] == p.Power.ESTOPPED
        assert twin.mechanism.motors is Motors.OFF

    virtual(test)


def test_a_frame_that_the_robot_does_not_know_is_refused_and_a_replaced_command_says_so() -> None:
    async def test() -> None:
        twin = own_twin()
        content = {"end_time": p.stamp(twin.robot_ns() + p.NS), "trajectory": TRAJECTORY}
        for frame in ("", "hand", "flat_body"):
            unknown = mobility("se2_trajectory_request", {**content, "se2_frame_name": frame})
            assert send(twin, unknown) == (p.Command.UNKNOWN_FRAME, 0)
        status, number = send(twin, mobility("se2_trajectory_request", {**content, "se2_frame_name": "body"}))
        assert status is p.Command.OK and base_feedback(twin, number)["status"] == PROCESSING
        send(twin, mobility("stand_request"))
        assert base_feedback(twin, number)["status"] == OVERRIDDEN

    virtual(test)


def test_a_command_whose_arm_is_refused_does_not_move_the_base() -> None:
    async def test() -> None:
        twin = own_twin()
        command = mobility("stand_request")
        command["synchronized_command"]["arm_command"] = {"named_arm_position_command": {"position": 7}}
        assert send(twin, command) == (p.Command.INVALID_REQUEST, 0)
        assert not twin.mechanism.wants_up

    virtual(test)


def test_the_axis_of_a_speed_limit_that_is_not_set_does_not_move() -> None:
    """The release notes of the API: "SE2VelocityLimits require care"."""

    async def test() -> None:
        twin = own_twin()
        content = {"end_time": p.stamp(twin.robot_ns() + p.NS), "se2_frame_name": "body"}
        content["velocity"] = {"linear": {"x": 0.5, "y": 0.5}, "angular": 0.5}
        limit = {"max_vel": {"linear": {"x": 0.2}}}
        assert send(twin, mobility("se2_velocity_request", content, vel_limit=limit))[0] is p.Command.OK
        assert twin.mechanism.target_twist == (0.2, 0.0, 0.0)

    virtual(test)


# -- parts


@pytest.mark.parametrize("leg", range(len(HIPS)))
@pytest.mark.parametrize("joints", [(0.0, 1.04, -1.8), (0.3, 0.7, -1.4), (-0.2, 1.2, -2.2)])
def test_a_leg_reaches_the_place_of_its_foot(leg: int, joints: tuple[float, float, float]) -> None:
    assert leg_to(leg, foot_at(leg, joints)) == pytest.approx(joints)
    assert leg_to(leg, (2.0, 0.0, -0.4)) is None, "the leg is too short"


def test_a_path_goes_straight_to_points_with_a_time_and_at_once_to_others() -> None:
    timed = Path(10.0, (0.0,), [(12.0, (1.0,)), (13.0, (3.0,))])
    assert [timed.values_at(time) for time in (10.0, 11.0, 12.5, 13.0, 99.0)] == [
        (0.0,),
        (0.5,),
        (2.0,),
        (3.0,),
        (3.0,),
    ]
    assert not timed.has_ended(12.9) and timed.has_ended(13.0)
    assert Path(10.0, (0.0,), [(10.0, (1.0,))]).values_at(10.0) == (1.0,)


def test_the_vendors_client_decodes_the_whole_state() -> None:
    """All fields of the state exist in the vendor's messages (see also ``test_protocol.py``)."""

    async def test() -> None:
        from bosdyn.api import robot_state_pb2

        from strands_actors.drivers.spot.messages import encode

        twin = own_twin()
        data = encode("RobotState", twin.state())
        read = robot_state_pb2.RobotState.FromString(data)
        assert read.HasField("manipulator_state") and read.HasField("system_fault_state")
        assert len(read.foot_state) == 4 and read.SerializeToString() and decode("RobotState", data)
        without = own_twin(arm=False).state()
        assert "manipulator_state" not in without and len(without["kinematic_state"]["joint_states"]) == 12

    virtual(test)


def test_a_registered_service_has_a_fault_once_its_program_is_silent() -> None:
    now_ns = [0]
    directory = Directory(lambda: now_ns[0])
    request = {"service_entry": {"name": "mine", "liveness_timeout_secs": 5.0}}
    assert directory.register(request, is_new=True) == {"status": p.OK}
    for _ in range(3):  # the vendor's client registers again as its heartbeat, and expects the refusal
        now_ns[0] += 4 * p.NS
        assert directory.register(request, is_new=True) == {"status": 2}
        assert directory.liveness_faults() == []
    now_ns[0] += 6 * p.NS
    assert [fault["fault_id"]["service_name"] for fault in directory.liveness_faults()] == ["mine"]
    assert directory.register({"service_entry": {"name": "lease"}}, is_new=False) == {"status": 2}
