"""Test how the simulated robot carries out each kind of command to joints and base, and which it refuses."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from strands_actors.drivers.common.codecs import protobuf as pb
from strands_actors.drivers.rby1.commands import Feedback, Finish, JointPosition, Status, encode_command
from strands_actors.drivers.rby1.protocol import Control, JointOrder, Manager, Method
from strands_actors.drivers.rby1.twin.parts import (
    BASE,
    BODY,
    JOINTS,
    Aim,
    BaseMove,
    CartesianMove,
    Jog,
    JointMove,
    Optimum,
    Part,
    Pose,
    Reach,
    Spring,
    Weightless,
)
from strands_actors.drivers.rby1.twin.requests import Request
from strands_actors.drivers.rby1.twin.service import RBY1Service
from tests.drivers.modelled.grpc_call import GrpcCall

from .test_twin import Client, Robot

RIGHT = JOINTS["right_arm"]
BENT = (0.2, -0.2, 0.0, -1.0, 0.0, 0.7, 0.0)
ELBOW = RIGHT[3]


def request(*parts: Part, priority: int = 1) -> Request:
    return Request({str(number): part for number, part in enumerate(parts)}, priority)


def energised() -> Robot:
    """Return a robot with bent arms, from where its hands can move in any direction."""
    robot = Robot()
    robot.energise()
    moves = [
        JointMove(path=(3,), joints=JOINTS[side], minimum_s=0.5, position=position)
        for side, position in (
            ("right_arm", BENT),
            ("left_arm", tuple(-rad if at in (1,) else rad for at, rad in enumerate(BENT))),
        )
    ]
    client = Client()
    assert robot.command(client, request(*moves)) is None
    robot.wait(1.0)
    assert client.reasons == [Finish.OK]
    return robot


def pose(robot: Robot, link: str, reference: str = "base") -> Pose:
    """Return the measured pose of a link."""
    kinematics = robot._joints.kinematics
    kinematics.place(robot.plant.position_rad)
    return kinematics.relative(reference, link)


def commanded(robot: Robot, link: str, reference: str = "base") -> Pose:
    kinematics = robot._joints.kinematics
    kinematics.place(robot._target)
    return kinematics.relative(reference, link)


def moved(here: Pose, x: float = 0.0, y: float = 0.0, z: float = 0.0) -> Pose:
    return Pose(here.place + np.array((x, y, z)), here.rotation)


def reach(robot: Robot, link: str = "ee_right", reference: str = "base", z: float = 0.1, **limits: float) -> Reach:
    """Return a pose 10 cm above the one where the link is, or elsewhere."""
    goal = moved(commanded(robot, link, reference), z=z)
    return Reach(reference=reference, link=link, pose=goal, **limits)


def push(robot: Robot, body: str, force: tuple[float, float, float]) -> None:
    robot.plant.data.body(body).xfrc_applied[:3] = force


# -- joints


def test_a_motion_keeps_the_limits_of_its_command() -> None:
    robot, client = energised(), Client()
    slow = JointMove(path=(3,), joints=JOINTS["head"], position=(0.4, 0.0), speed=(0.4, 1.0))
    assert robot.command(client, request(slow)) is None
    robot.wait(0.5)
    assert robot.plant.position_rad[20] == pytest.approx(0.2, abs=0.02)
    robot.wait(0.6)
    assert client.reasons == [Finish.OK]
    soft = JointMove(path=(3,), joints=JOINTS["head"], position=(0.0, 0.0), acceleration=(0.4, 0.4))
    robot.command(client, request(soft))
    robot.wait(1.9)
    assert client.reasons == [Finish.OK], "0.4 rad at 0.4 rad/s2 take 2 s"
    robot.wait(0.2)
    assert client.reasons == [Finish.OK] * 2


def test_named_joints_move_and_the_others_stay() -> None:
    robot, client = energised(), Client()
    before = robot.plant.position_rad
    group = JointMove(
        path=(3,), joints=JOINTS["torso"], minimum_s=0.5, position=(0.3, -0.3), names=("torso_1", "torso_5")
    )
    assert robot.command(client, request(group)) is None
    robot.wait(0.8)
    assert client.reasons == [Finish.OK]
    after = robot.plant.position_rad
    assert (after[1], after[5]) == pytest.approx((0.3, -0.3), abs=0.02)
    assert after[2:5] == pytest.approx(before[2:5], abs=0.02)


@pytest.mark.parametrize(
    ("kind", "value", "goal"), [("absolute", 0.3, 0.3), ("relative", 0.2, 0.2), ("one_step", 0.0, -0.0873)]
)
def test_a_jog_moves_one_joint(kind: str, value: float, goal: float) -> None:
    robot, client = energised(), Client()
    jog = Jog(path=(4,), joints=BODY, name="head_0", kind=kind, value=value, rad_s=math.inf)
    assert robot.command(client, request(jog)) is None
    robot.wait(0.5)
    assert client.reasons == [Finish.OK]
    assert robot.plant.position_rad[20] == pytest.approx(goal, abs=0.02)


def test_a_time_scale_slows_a_motion_down() -> None:
    robot, client = energised(), Client()
    robot.set_time_scale(0.5)
    robot.command(client, request(JointMove(path=(3,), joints=JOINTS["head"], minimum_s=1.0, position=(0.4, 0.0))))
    robot.wait(1.0)
    assert robot.plant.position_rad[20] == pytest.approx(0.2, abs=0.03)
    assert (client.reasons, robot.state().manager.time_scale) == ([], 0.5)
    robot.wait(1.1)
    assert client.reasons == [Finish.OK]


def test_a_spring_gives_way_as_far_as_it_is_soft() -> None:
    bends = []
    for stiffness in (None, 200.0, 50.0):
        robot = energised()
        spring = Spring((stiffness,) * 7, 1.0, ()) if stiffness else None
        hold = JointMove(path=(3,), joints=RIGHT, minimum_s=0.1, hold_s=9.0, position=BENT, spring=spring)
        assert robot.command(Client(), request(hold)) is None
        robot.wait(1.0)
        rest = robot.plant.position_rad[ELBOW]
        assert rest == pytest.approx(BENT[3], abs=0.05), "gravity is compensated"
        push(robot, "right_6", (0.0, 0.0, 30.0))
        robot.wait(1.5)
        bends.append(abs(robot.plant.position_rad[ELBOW] - rest))
    stiff, firm, soft = bends
    assert stiff < 0.02 < firm < soft / 2


def test_a_springs_torque_has_its_limit() -> None:
    ways = []
    for most_nm in (40.0, 2.0):
        robot = energised()
        spring = Spring((400.0,) * 7, 1.0, (most_nm,) * 7)
        hold = JointMove(path=(3,), joints=RIGHT, minimum_s=0.1, hold_s=9.0, position=BENT, spring=spring)
        robot.command(Client(), request(hold))
        robot.wait(0.5)
        push(robot, "right_6", (0.0, 0.0, 30.0))
        robot.wait(0.5)
        ways.append(abs(robot.plant.position_rad[ELBOW] - BENT[3]))
    assert ways[1] > 5 * ways[0]


def test_after_a_spring_the_joint_is_stiff_again_where_it_is() -> None:
    robot, client = energised(), Client()
    soft = JointMove(path=(3,), joints=RIGHT, hold_s=1.0, position=BENT, spring=Spring((20.0,) * 7))
    robot.command(client, request(soft))
    push(robot, "right_6", (0.0, 0.0, 20.0))
    robot.wait(0.95)
    bent = robot.plant.position_rad[ELBOW]
    assert abs(bent - BENT[3]) > 0.1
    robot.wait(0.1)
    assert client.reasons == [Finish.OK]
    push(robot, "right_6", (0.0, 0.0, 0.0))
    robot.wait(1.0)
    assert robot.plant.position_rad[ELBOW] == pytest.approx(bent, abs=0.08)
    assert not any(robot.plant.is_spring(joint) for joint in range(22))


def test_a_weightless_arm_stays_and_gives_way() -> None:
    robot, client = energised(), Client()
    robot.command(client, request(Weightless(path=(3,), joints=RIGHT, hold_s=3.0, on=True)))
    robot.wait(1.0)
    assert robot.plant.position_rad[ELBOW] == pytest.approx(BENT[3], abs=0.05)
    push(robot, "right_6", (0.0, 0.0, 30.0))
    robot.wait(1.0)
    assert abs(robot.plant.position_rad[ELBOW] - BENT[3]) > 0.3
    robot.wait(1.1)
    assert client.reasons == [Finish.OK]


# -- the base


def test_the_base_moves_for_the_time_of_its_command() -> None:
    robot, client = energised(), Client()
    drive = BaseMove(path=(3, 2), joints=BASE, minimum_s=0.5, hold_s=1.0, velocity=(0.2, 0.0))
    assert robot.command(client, request(drive)) is None
    robot.wait(1.0)
    state = robot.state()
    assert state.velocity[:2] == pytest.approx((-2.0, -2.0)), "0.2 m/s on wheels of 0.1 m"
    robot.wait(0.6)
    assert client.reasons == [Finish.OK]
    x, y, heading = robot.state().odometry
    assert (x, y, heading) == pytest.approx((0.05 + 0.2, 0.0, 0.0), abs=0.01)
    robot.wait(0.5)
    assert robot.state().odometry[0] == pytest.approx(x, abs=0.01), "it stands"


def test_the_base_turns_and_a_cancel_stops_it() -> None:
    robot, client = energised(), Client()
    turn = BaseMove(path=(3, 2), joints=BASE, minimum_s=0.0, hold_s=9.0, velocity=(0.0, 0.5))
    robot.command(client, request(turn))
    robot.wait(1.5)
    heading = robot.state().odometry[2]
    assert heading == pytest.approx(0.5, abs=0.15)
    robot.cancel()
    robot.wait(1.0)
    assert client.reasons == [Finish.CANCELED]
    stopped = robot.state().odometry[2]
    robot.wait(1.0)
    assert robot.state().odometry[2] == stopped
    assert stopped < heading + 0.2


def test_wheels_are_commanded_singly() -> None:
    robot = energised()
    wheels = BaseMove(path=(3, 2), joints=BASE, hold_s=2.0, velocity=(0.0, 0.0), wheels=(-1.0, 1.0))
    robot.command(Client(), request(wheels))
    robot.wait(1.0)
    assert robot.state().velocity[:2] == pytest.approx((-1.0, 1.0))
    assert robot.base.velocity == pytest.approx((0.0, 2 * 0.1 / 0.53))


# -- refusals and priorities


def hand(robot: Robot) -> Reach:
    return reach(robot)


@pytest.mark.parametrize(
    "part",
    [
        lambda robot: JointMove(path=(3,), joints=RIGHT, position=(9.0, *BENT[1:])),
        lambda robot: JointMove(path=(3,), joints=JOINTS["torso"], position=(0.1,), names=("head_0",)),
        lambda robot: JointMove(path=(3,), joints=JOINTS["torso"], position=(0.1,), names=("nose",)),
        lambda robot: JointMove(path=(3,), joints=RIGHT, position=BENT, spring=Spring()),
        lambda robot: JointMove(path=(3,), joints=RIGHT, position=(0.0,) * 7, speed=(0.0,) * 7),
        lambda robot: CartesianMove(
            path=(3,), joints=RIGHT, reaches=(Reach(reference="base", link="ee_middle", pose=hand(robot).pose),)
        ),
        lambda robot: CartesianMove(path=(3,), joints=RIGHT, reaches=(hand(robot),), aims=(Aim("head_0", 0.0),)),
        lambda robot: CartesianMove(
            path=(3,), joints=RIGHT, reaches=(hand(robot),), aims=(Aim("right_arm_3", 2.0),)
        ),
        lambda robot: Optimum(path=(3,), joints=RIGHT, reaches=(hand(robot),), speed_scale=2.0),
        lambda robot: BaseMove(path=(3,), joints=BASE, velocity=(3.0, 0.0)),
        lambda robot: Jog(path=(4,), joints=BODY, name="nose", kind="absolute", value=0.0, rad_s=1.0),
    ],
)
def test_an_impossible_command_is_not_begun(part: Any) -> None:
    robot, client = energised(), Client()
    assert robot.command(client, request(part(robot))) is Finish.INITIALIZED_FAILED
    assert (robot.control, client.reasons) == (Control.IDLE, [])
    assert not any(robot.plant.is_spring(joint) for joint in range(22))


def test_two_commands_to_the_same_joints_are_refused() -> None:
    robot = energised()
    both = JointMove(path=(3,), joints=BODY, position=robot.plant.position_rad[:20])
    arm = JointMove(path=(3,), joints=RIGHT, position=BENT)
    assert robot.command(Client(), request(both, arm)) is Finish.INITIALIZED_FAILED


def test_a_command_without_wheels_is_refused() -> None:
    robot = energised()
    robot.servo_off("left_wheel")
    drive = BaseMove(path=(3, 2), joints=BASE, hold_s=1.0, velocity=(0.1, 0.0))
    assert robot.command(Client(), request(drive)) is Finish.INITIALIZED_FAILED


def test_the_feedback_says_how_far_a_motion_is() -> None:
    robot, client = energised(), Client()
    aim = reach(robot)
    robot.command(client, request(CartesianMove(path=(3, 3, 6, 2, 4), joints=RIGHT, minimum_s=1.0, reaches=(aim,))))
    robot.wait(0.5)
    fields = pb.message(robot.feedback())
    for number in (3, 3, 6, 2, 4):
        fields = pb.message(pb.last_bytes(fields, number))
    error = pb.as_double(pb.last_int(pb.message(pb.last_bytes(fields, 2)), 1))
    assert error == pytest.approx(0.05, abs=0.01), "half of the way is left"


# -- brakes and gains


def test_a_released_brake_lets_the_joint_fall_and_an_engaged_one_holds_it() -> None:
    robot = Robot()
    assert not robot.servo("right_arm_3", JointOrder.BRAKE_RELEASE), "without power"
    assert robot.power("48v", True)
    robot.wait(0.5)
    rest = robot.plant.position_rad[ELBOW]
    assert not robot.servo("head_0", JointOrder.BRAKE_RELEASE), "it has none"
    assert robot.servo("right_arm_3", JointOrder.BRAKE_RELEASE)
    robot.wait(0.3)
    assert robot.servo("right_arm_3", JointOrder.BRAKE_ENGAGE)
    fallen = robot.plant.position_rad[ELBOW]
    assert abs(fallen - rest) > 0.1
    robot.wait(1.0)
    assert robot.plant.position_rad[ELBOW] == pytest.approx(fallen, abs=0.05)
    robot.energise()
    assert not robot.servo("right_arm_3", JointOrder.BRAKE_RELEASE), "the control manager is enabled"
    assert robot.manager == Manager.ENABLED


def test_a_smaller_gain_makes_a_joint_sag() -> None:
    sags = []
    for gain in (35, 1):
        robot = Robot()
        assert robot.power("48v", True)
        assert robot.set_gains("right_arm_3", (gain, None, None))
        assert robot.devices.gains["right_arm_3"] == (gain, 5, 80)
        robot.energise()
        assert not robot.set_gains("right_arm_3", (35, None, None)), "the control manager is enabled"
        robot.wait(0.5)
        sags.append(abs(robot.plant.position_rad[ELBOW] + 1.2))
    assert sags[1] > 5 * sags[0]


def test_a_command_with_a_part_of_another_kind_is_refused_as_a_whole() -> None:
    robot = energised()
    move = JointMove(path=(3,), joints=JOINTS["head"], position=(0.1, 0.1))
    assert robot.command(Client(), Request({"head": move}, 1, others=("arm.",))) is Finish.INITIALIZED_FAILED
    assert robot.control is Control.IDLE


def test_the_first_message_of_a_stream_has_its_priority() -> None:
    robot = energised()
    service = RBY1Service(robot)
    calls: list[Any] = [GrpcCall(path) for path in (Method.COMMAND_STREAM, Method.COMMAND)]
    stream, other = calls
    parts = {"head": JointPosition((0.1, 0.1), 0.1, 1.0)}
    assert service.called(stream) and service.called(other)
    for priority in (10, 0):
        service.message(stream, 0, encode_command(parts, priority))
    service.message(other, 0, encode_command(parts, 5))
    assert Feedback.decode(other.sent[-1]).dropped == "PREEMPTED"
    assert Feedback.decode(stream.sent[-1]).dropped == ""


def test_a_request_for_feedback_changes_nothing() -> None:
    robot = energised()
    service = RBY1Service(robot)
    stream: Any = GrpcCall(Method.COMMAND_STREAM)
    assert service.called(stream)
    asks = pb.bytes_field(2, b"")
    service.message(stream, 0, asks)
    assert Feedback.decode(stream.sent[-1]).dropped == "INITIALIZED_FAILED", "there is no command yet"
    service.message(stream, 0, encode_command({"head": JointPosition((0.1, 0.1), 0.5, 0.1)}, 1))
    for _ in range(2):
        service.message(stream, 0, asks)
        assert Feedback.decode(stream.sent[-1]) == Feedback(Status.RUNNING, Finish.UNKNOWN)
    robot.wait(0.7)
    service.message(stream, 0, asks)
    assert Feedback.decode(stream.sent[-1]) == Feedback(Status.FINISHED, Finish.OK)
    assert robot.plant.position_rad[20] == pytest.approx(0.1, abs=0.02)
