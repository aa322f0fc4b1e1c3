"""Test how the twin's hand moves: along poses, with a velocity, and towards what it looks at."""

from __future__ import annotations

import math
import random
from typing import Any

import pytest
import trio

from strands_actors.drivers.spot import protocol as p
from strands_actors.drivers.spot.messages import Message
from strands_actors.drivers.spot.robots import TABLES
from strands_actors.drivers.spot.twin import SpotTwin
from strands_actors.drivers.spot.twin.commands import CLOCK
from strands_actors.drivers.spot.twin.feedback import (
    CANCELLED,
    DONE,
    HAND_STALLED,
    IN_PROGRESS,
    INCOMPATIBLE_HARDWARE,
    OVERRIDDEN,
    PROCESSING,
    TIMED_OUT,
)
from strands_actors.drivers.spot.twin.frames import frames_of
from strands_actors.drivers.spot.twin.geometry import Pose, distance, looking_at, pose_at
from strands_actors.drivers.spot.twin.limbs import hand_at, wrist_at
from strands_actors.drivers.spot.twin.mechanism import CLAW_INDEX
from strands_actors.drivers.spot.twin.reach import joints_for, within_reach
from tests.drivers.common.memory_port import virtual

from .test_twin import base_feedback, mobility, own_twin, send

RANGES = [(low, high) for low, high in TABLES.table("spot")["joints_rad"].values()][:CLAW_INDEX]
READY = [float(angle) for angle in TABLES.table("spot")["ready_rad"]]
AHEAD = pose_at(0.75, 0.0, 0.25)


def standing(**options: Any) -> SpotTwin:
    """Return a twin that stands, with its arm in the ready position."""
    twin = own_twin(**options)
    twin.mechanism.up, twin.mechanism.wants_up = 1.0, True
    twin.mechanism.joints = list(READY)
    twin.mechanism.halt()
    return twin


def arm(name: str, content: Message) -> Message:
    return {"synchronized_command": {"arm_command": {name: content}}}


def poses(*points: tuple[float, Pose]) -> Message:
    """Return a trajectory through poses at these times, seconds."""
    return {
        "points": [
            {"pose": pose.as_message(), "time_since_reference": p.duration(time_s)} for time_s, pose in points
        ]
    }


def cartesian(frame: str, *points: tuple[float, Pose], **content: Any) -> Message:
    request = {"root_frame_name": frame, "pose_trajectory_in_task": poses(*points), **content}
    return arm("arm_cartesian_command", request)


def feedback(twin: SpotTwin, number: int, name: str = "arm_cartesian_feedback") -> Message:
    twin.pass_time()
    reported: Message = twin.commands.feedback(number)["synchronized_feedback"]["arm_command_feedback"]
    return {"whole": reported["status"], **reported.get(name, {})}


def hand_in(twin: SpotTwin, frame: str) -> Pose:
    frames = frames_of(twin.mechanism, True)
    return frames[frame].inverse().compose(frames["hand"])


async def let_pass(twin: SpotTwin, seconds: float) -> None:
    for _ in range(round(seconds * 10)):
        await trio.sleep(0.1)
        twin.pass_time()


def accepted(twin: SpotTwin, command: Message) -> int:
    status, number = send(twin, command)
    assert status is p.Command.OK
    return number


# -- which joints put the wrist at a pose


def test_the_joints_for_a_pose_put_the_wrist_there() -> None:
    chance = random.Random(1)
    for _ in range(300):
        joints = [chance.uniform(low, high) for low, high in RANGES]
        wrist = wrist_at(joints)
        found = joints_for(wrist, READY, RANGES)
        assert found is not None, joints
        far, angle = distance(wrist_at(found), wrist)
        assert far < 1e-6 and angle < 1e-6, joints
        assert all(low <= joint <= high for joint, (low, high) in zip(found, RANGES, strict=True))


def test_of_several_solutions_the_nearest_is_taken_and_a_pose_out_of_reach_has_none() -> None:
    chance = random.Random(2)
    for _ in range(100):
        joints = [chance.uniform(low, high) for low, high in RANGES]
        found = joints_for(wrist_at(joints), joints, RANGES)
        assert found == pytest.approx(joints, abs=1e-5)
    far = pose_at(2.0, 0.0, 0.2)
    assert joints_for(far, READY, RANGES) is None
    assert within_reach(far).xyz[0] == pytest.approx(0.292 + 0.3385 + math.hypot(0.4033, 0.075), abs=0.001)
    assert joints_for(within_reach(far), READY, RANGES) is not None


# -- along poses


@pytest.mark.parametrize("frame", ["odom", "vision", "body", "flat_body"])
def test_the_hand_arrives_at_a_pose_at_its_time(frame: str) -> None:
    async def test() -> None:
        twin = standing()
        twin.mechanism.x_m, twin.mechanism.yaw_rad = 0.5, 0.3
        goal = frames_of(twin.mechanism, True)[frame].inverse().compose(twin.mechanism.body_pose).compose(AHEAD)
        number = accepted(twin, cartesian(frame, (2.0, goal)))
        await let_pass(twin, 1.9)
        moving = feedback(twin, number)
        assert (moving["whole"], moving["status"]) == (PROCESSING, IN_PROGRESS)
        await let_pass(twin, 0.2)
        there = feedback(twin, number)
        assert there["status"] == DONE and there["measured_pos_distance_to_goal"] < 1e-3
        assert distance(hand_in(twin, frame), goal) == pytest.approx((0.0, 0.0), abs=1e-3)

    virtual(test)


def test_the_distance_to_the_goal_shrinks_and_the_hand_goes_through_the_points() -> None:
    async def test() -> None:
        twin = standing()
        left, right = pose_at(0.75, 0.3, 0.1), pose_at(0.75, -0.3, 0.1)
        number = accepted(twin, cartesian("flat_body", (0.0, pose_at(0.75, 0.0, 0.1)), (2.0, left), (4.0, right)))
        await let_pass(twin, 2.0)
        assert distance(hand_in(twin, "flat_body"), left)[0] < 0.02
        seen = [feedback(twin, number)["measured_pos_distance_to_goal"]]
        for _ in range(4):
            await let_pass(twin, 0.5)
            seen.append(feedback(twin, number)["measured_pos_distance_to_goal"])
        assert seen[0] == pytest.approx(0.6, abs=0.02) and seen == sorted(seen, reverse=True)
        await let_pass(twin, 0.1)
        assert feedback(twin, number)["status"] == DONE

    virtual(test)


def test_a_hand_held_in_the_world_stays_there_while_the_robot_walks_and_one_held_in_the_body_walks_with_it() -> (
    None
):
    async def test() -> None:
        for frame, moved_m in (("odom", 0.0), ("body", 0.2)):
            twin = standing()
            accepted(twin, cartesian(frame, (1.0, hand_in(twin, frame))))
            await let_pass(twin, 1.0)
            before = hand_in(twin, "odom")
            end = p.stamp(twin.robot_ns() + 2 * p.NS)
            slow = {"end_time": end, "velocity": {"linear": {"x": 0.1}}, "se2_frame_name": "body"}
            accepted(twin, mobility("se2_velocity_request", slow))
            await let_pass(twin, 2.5)
            assert twin.mechanism.x_m == pytest.approx(0.2, abs=0.01)
            assert hand_in(twin, "odom").xyz[0] - before.xyz[0] == pytest.approx(moved_m, abs=0.01), frame

    virtual(test)


def test_a_pose_out_of_reach_stalls_and_is_reached_when_the_robot_has_walked_closer() -> None:
    async def test() -> None:
        twin = standing()
        goal = hand_in(twin, "odom").compose(pose_at(0.6, 0.0, 0.0))
        number = accepted(twin, cartesian("odom", (1.0, goal)))
        await let_pass(twin, 3.0)
        stalled = feedback(twin, number)
        assert stalled["status"] == HAND_STALLED and stalled["measured_pos_distance_to_goal"] > 0.1
        aside = cartesian("odom", (1.0, hand_in(twin, "odom").compose(pose_at(0.5, 1.5, 0.0))))
        accepted(twin, aside)
        await let_pass(twin, 3.0)
        assert twin.mechanism.joints[0] > 0.6, "the stretched arm points to a goal out of reach"
        number = accepted(twin, cartesian("odom", (1.0, goal)))
        await let_pass(twin, 3.0)
        end = p.stamp(twin.robot_ns() + 2 * p.NS)
        closer = {"end_time": end, "velocity": {"linear": {"x": 0.3}}, "se2_frame_name": "body"}
        accepted(twin, mobility("se2_velocity_request", closer))
        await let_pass(twin, 3.0)
        assert feedback(twin, number)["status"] == DONE

    virtual(test)


def test_the_body_follows_the_goal_of_the_hand() -> None:
    async def test() -> None:
        twin = standing()
        goal = twin.mechanism.odometry.inverse().compose(twin.mechanism.body_pose).compose(pose_at(1.25, 0.0, 0.25))
        command = cartesian("odom", (3.0, goal))
        command["synchronized_command"]["mobility_command"] = {"follow_arm_request": {}}
        number = accepted(twin, command)
        assert base_feedback(twin, number) == {"status": PROCESSING, "follow_arm_feedback": {}}
        await let_pass(twin, 3.2)
        assert feedback(twin, number)["status"] == DONE
        assert twin.mechanism.x_m == pytest.approx(0.5, abs=0.02), "0.75 m behind the hand"
        assert not twin.mechanism.walks
        accepted(twin, arm("arm_stop_command", {}))
        await let_pass(twin, 1.0)
        assert twin.mechanism.x_m == pytest.approx(0.5, abs=0.02), "no goal in the world, so it stands"

    virtual(test)


def test_the_limits_of_a_command_are_kept() -> None:
    async def test() -> None:
        twin = standing()
        goal = hand_in(twin, "body").compose(pose_at(0.0, 0.4, 0.0))
        number = accepted(twin, cartesian("body", (0.0, goal), max_linear_velocity={"value": 0.1}))
        await let_pass(twin, 1.0)
        assert feedback(twin, number)["measured_pos_distance_to_goal"] == pytest.approx(0.3, abs=0.01)
        limit = {"max_pos_tracking_error": {"value": 0.05}}
        number = accepted(twin, cartesian("body", (0.0, goal), **limit))
        await let_pass(twin, 1.0)
        cancelled = feedback(twin, number)
        assert cancelled["status"] == CANCELLED and cancelled["measured_pos_distance_to_goal"] > 0.25

    virtual(test)


def test_tool_and_task_are_part_of_the_pose() -> None:
    async def test() -> None:
        twin = standing()
        tool, task = pose_at(0.3, 0.0, 0.1, pitch=0.4), pose_at(0.9, 0.1, 0.3, yaw=0.5)
        content = {"wrist_tform_tool": tool.as_message(), "root_tform_task": task.as_message()}
        number = accepted(twin, cartesian("body", (1.0, pose_at(0.1, 0.0, 0.0)), **content))
        await let_pass(twin, 1.5)
        assert feedback(twin, number)["status"] == DONE
        placed = wrist_at(twin.mechanism.joints[:CLAW_INDEX]).compose(tool)
        assert distance(placed, task.compose(pose_at(0.1, 0.0, 0.0))) == pytest.approx((0.0, 0.0), abs=1e-3)

    virtual(test)


@pytest.mark.parametrize(
    ("command", "status"),
    [
        (cartesian("fiducial_1", (1.0, AHEAD)), p.Command.UNKNOWN_FRAME),
        (cartesian("body", (1.0, AHEAD), x_axis=1), p.Command.UNSUPPORTED),
        (cartesian("body", (1.0, AHEAD), wrench_trajectory_in_task={}), p.Command.UNSUPPORTED),
        (cartesian("body"), p.Command.INVALID_REQUEST),
        (cartesian("body", (2.0, AHEAD), (1.0, AHEAD)), p.Command.INVALID_REQUEST),
        (cartesian("body", (1.0, Pose((0.7, 0.0, 0.0), (0.1, 0.0, 0.0, 0.0)))), p.Command.INVALID_REQUEST),
        (arm("arm_gaze_command", {"frame1_name": "body"}), p.Command.INVALID_REQUEST),
    ],
)
def test_a_command_to_the_hand_that_is_refused_moves_nothing(command: Message, status: p.Command) -> None:
    async def test() -> None:
        twin = standing()
        assert send(twin, command) == (status, 0)
        await let_pass(twin, 0.5)
        assert twin.mechanism.hand is None and twin.mechanism.joints == READY

    virtual(test)


def test_a_stop_ends_the_motion_and_a_later_command_replaces_it() -> None:
    async def test() -> None:
        twin = standing()
        for stop in (arm("arm_stop_command", {}), {"full_body_command": {"stop_request": {}}}):
            number = accepted(twin, cartesian("body", (3.0, pose_at(0.75, 0.4, 0.1))))
            await let_pass(twin, 0.5)
            accepted(twin, stop)
            joints = list(twin.mechanism.joints)
            await let_pass(twin, 1.0)
            assert twin.mechanism.joints == joints and feedback(twin, number)["whole"] == OVERRIDDEN
        number = accepted(twin, cartesian("body", (1.0, AHEAD)))
        accepted(twin, arm("named_arm_position_command", {"position": 3}))
        assert feedback(twin, number)["whole"] == OVERRIDDEN and twin.mechanism.hand is None

    virtual(test)


def test_a_robot_without_an_arm_cannot_move_a_hand_or_follow_it() -> None:
    async def test() -> None:
        twin = own_twin(arm=False)
        command = cartesian("body", (1.0, AHEAD))
        command["synchronized_command"]["mobility_command"] = {"follow_arm_request": {}}
        number = accepted(twin, command)
        assert feedback(twin, number) == {"whole": INCOMPATIBLE_HARDWARE}
        assert base_feedback(twin, number) == {"status": INCOMPATIBLE_HARDWARE}
        assert not twin.mechanism.walks

    virtual(test)


# -- with a velocity


def velocity(twin: SpotTwin, seconds: float, **content: Any) -> Message:
    end = p.stamp(twin.robot_ns() + round(seconds * p.NS))
    return arm("arm_velocity_command", {"end_time": end, **content})


def test_the_hand_moves_with_a_velocity_until_its_time() -> None:
    async def test() -> None:
        twin = standing()
        before = hand_in(twin, "flat_body")
        up = {"linear_velocity": {"z": -0.5}}
        number = accepted(twin, velocity(twin, 1.0, cylindrical_velocity=up))
        assert feedback(twin, number) == {"whole": PROCESSING}
        await let_pass(twin, 1.5)
        assert feedback(twin, number) == {"whole": TIMED_OUT}
        after = hand_in(twin, "flat_body")
        assert after.xyz[2] - before.xyz[2] == pytest.approx(-0.25, abs=0.01), "half of 0.5 m/s for 1 s"
        assert after.xyz[:2] == pytest.approx(before.xyz[:2], abs=0.01)
        left = {"frame_name": "odom", "velocity_in_frame_name": {"y": 0.2}}
        twin.mechanism.yaw_rad = 0.5
        before = hand_in(twin, "odom")
        accepted(twin, velocity(twin, 1.0, cartesian_velocity=left))
        await let_pass(twin, 1.5)
        after = hand_in(twin, "odom")
        assert after.xyz[1] - before.xyz[1] == pytest.approx(0.2, abs=0.01)
        assert after.xyz[0] == pytest.approx(before.xyz[0], abs=0.01)

    virtual(test)


def test_the_hand_turns_about_its_own_axes_and_goes_around_the_shoulder() -> None:
    async def test() -> None:
        twin = standing()
        before = hand_in(twin, "odom")
        accepted(twin, velocity(twin, 1.0, angular_velocity_of_hand_rt_odom_in_hand={"x": 0.5}))
        await let_pass(twin, 1.5)
        after = hand_in(twin, "odom")
        assert after.roll_pitch_yaw[0] - before.roll_pitch_yaw[0] == pytest.approx(0.5, abs=0.01)
        assert after.xyz == pytest.approx(before.xyz, abs=0.01)
        around = {"linear_velocity": {"theta": 1.0}, "max_linear_velocity": {"value": 0.3}}
        accepted(twin, velocity(twin, 1.0, cylindrical_velocity=around))
        await let_pass(twin, 1.5)
        body = hand_in(twin, "body")
        assert math.hypot(body.xyz[0] - 0.292, body.xyz[1]) == pytest.approx(after_radius(), abs=0.01)
        assert body.xyz[1] > 0.25

    virtual(test)


def after_radius() -> float:
    x, y, _ = hand_at(READY[:CLAW_INDEX]).xyz
    return math.hypot(x - 0.292, y)


def test_a_velocity_stops_at_the_edge_of_the_reach_and_needs_an_end() -> None:
    async def test() -> None:
        twin = standing()
        outwards = {"linear_velocity": {"r": 9.0}, "max_linear_velocity": {"value": 1.0}}
        accepted(twin, velocity(twin, 3.0, cylindrical_velocity=outwards))
        await let_pass(twin, 3.2)
        assert 0.9 < hand_in(twin, "body").xyz[0] < 1.25
        assert send(twin, velocity(twin, -1.0)) == (p.Command.EXPIRED, 0)
        assert send(twin, velocity(twin, 700.0)) == (p.Command.TOO_DISTANT, 0)
        unknown = {"frame_name": "fiducial_1", "velocity_in_frame_name": {"y": 0.2}}
        assert send(twin, velocity(twin, 1.0, cartesian_velocity=unknown)) == (p.Command.UNKNOWN_FRAME, 0)
        assert twin.commands.carry_out(velocity(twin, 1.0), "another clock", False) == (p.Command.NO_TIMESYNC, 0)
        assert CLOCK != "another clock"

    virtual(test)


# -- towards a place


def gaze(frame: str, *places: tuple[float, tuple[float, float, float]], **content: Any) -> Message:
    points = [
        {"point": dict(zip("xyz", place, strict=True)), "time_since_reference": p.duration(time_s)}
        for time_s, place in places
    ]
    return arm(
        "arm_gaze_command", {"target_trajectory_in_frame1": {"points": points}, "frame1_name": frame, **content}
    )


def off_target(twin: SpotTwin, place: tuple[float, float, float], pitch: float = math.radians(-9.0)) -> float:
    """Return the angle between the look of the hand and a place in the frame of odometry, radians."""
    wrist = frames_of(twin.mechanism, True)["arm0.link_wr1"]
    tool = twin.mechanism.odometry.inverse().compose(wrist).compose(pose_at(0.19557, 0.0, 0.0, pitch=pitch))
    ahead = tool.compose(Pose((1.0, 0.0, 0.0))).xyz
    look = [end - start for start, end in zip(tool.xyz, ahead, strict=True)]
    way = [end - start for start, end in zip(tool.xyz, place, strict=True)]
    return math.acos(min(1.0, sum(a * b for a, b in zip(look, way, strict=True)) / math.hypot(*way)))


def test_the_hand_looks_at_a_place_and_then_along_a_line() -> None:
    async def test() -> None:
        twin = standing()
        place = (
            twin.mechanism.odometry.inverse().compose(twin.mechanism.body_pose).compose(Pose((3.0, 4.0, 0.0))).xyz
        )
        before = hand_in(twin, "body").xyz
        number = accepted(twin, gaze("odom", (0.0, place)))
        looking = feedback(twin, number, "arm_gaze_feedback")
        assert looking["status"] == IN_PROGRESS and not looking["gazing_at_target"]
        await let_pass(twin, 2.0)
        there = feedback(twin, number, "arm_gaze_feedback")
        assert there["status"] == DONE and there["gazing_at_target"] and there["hand_position_at_goal"]
        assert off_target(twin, place) < 0.01
        assert math.dist(hand_in(twin, "body").xyz, before) < 0.05, "the hand stays where it is"
        line = [(4.0, 2.0, 0.4), (4.0, -2.0, 0.4)]
        number = accepted(twin, gaze("odom", (0.0, line[0]), (3.0, line[1])))
        await let_pass(twin, 1.5)
        assert off_target(twin, (4.0, 0.0, 0.4)) < 0.1
        await let_pass(twin, 1.7)
        assert feedback(twin, number, "arm_gaze_feedback")["status"] == DONE and off_target(twin, line[1]) < 0.01

    virtual(test)


def test_a_gaze_moves_the_hand_along_poses_and_keeps_its_roll() -> None:
    async def test() -> None:
        twin = standing()
        low, high = pose_at(0.75, 0.0, 0.1), pose_at(0.75, 0.0, 0.3)
        content = {"tool_trajectory_in_frame2": poses((0.0, low), (2.0, high)), "frame2_name": "flat_body"}
        target = (4.0, 1.0, 0.4)
        number = accepted(twin, gaze("odom", (0.0, target), **content))
        await let_pass(twin, 2.5)
        there = feedback(twin, number, "arm_gaze_feedback")
        assert there["status"] == DONE and there["hand_position_at_goal"] and there["hand_roll_at_goal"]
        assert there["gaze_to_target_rotation_measured"] < 0.01 and off_target(twin, target) < 0.01
        tool = wrist_at(twin.mechanism.joints[:CLAW_INDEX]).compose(pose_at(0.19557, 0.0, 0.0))
        assert tool.xyz == pytest.approx(high.xyz, abs=0.01)

    virtual(test)


def test_a_gaze_of_a_stowed_arm_deploys_it_and_one_to_the_back_stalls() -> None:
    async def test() -> None:
        twin = standing()
        twin.mechanism.joints = [float(angle) for angle in TABLES.table("spot")["home_rad"]]
        twin.mechanism.halt()
        for place in ((1.0, -2.0, 0.0), (1.0, 1.0, 1.5), (-3.0, -3.0, 0.4)):
            number = accepted(twin, gaze("odom", (0.0, place)))
            await let_pass(twin, 3.0)
            assert feedback(twin, number, "arm_gaze_feedback")["status"] == DONE and off_target(twin, place) < 0.01
        pose = {"tool_trajectory_in_frame2": poses((0.0, pose_at(0.95, 0.0, 0.2))), "frame2_name": "body"}
        number = accepted(twin, gaze("odom", (0.0, (-4.0, 0.0, 0.5)), **pose))
        await let_pass(twin, 3.0)
        assert feedback(twin, number, "arm_gaze_feedback")["status"] == 3  # STATUS_TOOL_TRAJECTORY_STALLED

    virtual(test)


def test_a_look_keeps_its_roll() -> None:
    rotation = looking_at((1.0, 0.0, 0.0), (1.0, 5.0, 0.0), (0.0, 0.0, 1.0))
    assert rotation is not None
    assert Pose(rotation=rotation).roll_pitch_yaw == pytest.approx((0.0, 0.0, math.pi / 2))
    for target in ((1.0, 0.0, 0.0), (1.0, 0.0, 3.0)):
        assert looking_at((1.0, 0.0, 0.0), target, (0.0, 0.0, 1.0)) is None
