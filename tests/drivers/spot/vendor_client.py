"""Run the vendor's unmodified client against the twin: ``python -m tests.drivers.spot.vendor_client SCENE PORT``.
It prints the result of each step of the scene as one JSON object."""

from __future__ import annotations

import json
import math
import os
import sys
import time
from collections.abc import Callable, Mapping
from typing import Any

from bosdyn.api import basic_command_pb2, geometry_pb2, robot_command_pb2, service_fault_pb2, trajectory_pb2
from bosdyn.api.spot import robot_command_pb2 as spot_command_pb2
from bosdyn.client import frame_helpers, math_helpers
from bosdyn.client.estop import EstopEndpoint, EstopKeepAlive
from bosdyn.client.image import build_image_request
from bosdyn.client.lease import LeaseKeepAlive
from bosdyn.client.robot_command import (
    RobotCommandBuilder,
    block_for_trajectory_cmd,
    block_until_arm_arrives,
    blocking_sit,
    blocking_stand,
)
from bosdyn.geometry import EulerZXY

from .vendor_robot import Powered, connected, failure, feet_in_odom, powered

STATUS = basic_command_pb2.RobotCommandFeedbackStatus.Status


def drive(port: str) -> dict[str, Any]:
    """Log in, stand, walk, move the arm, and let the e-stop time out."""
    robot = connected(port)
    reported: dict[str, Any] = {"serial": robot.get_id().serial_number}
    reported["no_login"] = failure(lambda: robot.ensure_client("robot-state").get_robot_state())
    reported["bad_password"] = failure(lambda: robot.authenticate("twin", "password"))
    reported["bad_user"] = failure(lambda: robot.authenticate("user", "twin"))
    reported["bad_token"] = failure(lambda: robot.authenticate_with_token("twin-token-999"))
    robot.authenticate("twin", "twin")
    reported["renewed"] = failure(lambda: robot.authenticate_with_token(robot.user_token))
    robot.time_sync.wait_for_sync(8)
    reported["skew_s"] = robot.time_sync.endpoint.clock_skew.ToNanoseconds() / 1e9
    leases, estops = robot.ensure_client("lease"), robot.ensure_client("estop")
    reported["lease"] = leases.acquire("body").lease_proto.resource
    reported["second_lease"] = failure(lambda: leases.acquire("body"))
    keep_lease = LeaseKeepAlive(leases, must_acquire=False, return_at_exit=False)
    reported["power_without_estop"] = failure(lambda: robot.power_on(timeout_sec=5))
    endpoint = EstopEndpoint(estops, "vendor", 3.0)
    endpoint.force_simple_setup()
    keep_estop = EstopKeepAlive(endpoint)
    time.sleep(0.5)
    reported["level"] = int(estops.get_status().stop_level)
    robot.power_on(timeout_sec=10)
    spot = Powered(robot)
    blocking_stand(spot.commands, timeout_sec=10)
    began_x = spot.body.x
    spot.walk(0.5)
    time.sleep(1.0)
    reported["walked_m"] = spot.body.x - began_x
    reported["late"] = failure(lambda: spot.walk(0.5, seconds=-1.0))
    reported["far"] = failure(lambda: spot.walk(0.5, seconds=700.0))
    reported["has_arm"] = robot.has_arm()
    wrench = RobotCommandBuilder.arm_wrench_command(0, 0, -5, 0, 0, 0, "odom")
    reported["force"] = failure(lambda: spot.commands.robot_command(wrench))
    reported["freeze"] = failure(lambda: spot.commands.robot_command(RobotCommandBuilder.freeze_command()))
    reported["fans"] = failure(lambda: robot.ensure_client("power").fan_power_command(50, 1))
    reported["legs"] = sum(name[:2] in ("fl", "fr", "hl", "hr") for name in spot.joints)
    blocking_sit(spot.commands, timeout_sec=10)
    blocking_stand(spot.commands, timeout_sec=10)
    keep_estop.shutdown()
    time.sleep(4.5)
    reported["motors_after_silence"] = int(spot.state.power_state.motor_power_state)
    reported["after_the_cut"] = failure(lambda: spot.walk(0.5))
    keep_lease.shutdown()
    return reported


def walk(port: str) -> dict[str, Any]:
    """Walk from sitting, faster than the robot can, along trajectories, and in wrong frames."""
    reported: dict[str, Any] = {}
    with powered(port) as spot:
        number = spot.walk(0.5, seconds=2.0)
        reported["from_sitting"] = int(spot.state.behavior_state.state)
        time.sleep(1.5)
        reported["stood_up_and_walks"] = round(spot.state.kinematic_state.velocity_of_body_in_odom.linear.x, 2)
        time.sleep(1.0)
        reported["ended"] = spot.feedback(number).mobility_command_feedback.status
        spot.walk(9.0, 9.0, 9.0, seconds=1.5)
        time.sleep(1.2)
        speed = spot.state.kinematic_state.velocity_of_body_in_odom
        reported["fastest"] = [
            round(math.hypot(speed.linear.x, speed.linear.y), 2),
            round(speed.angular.z, 2),
        ]
        limits = geometry_pb2.SE2VelocityLimit(
            max_vel=geometry_pb2.SE2Velocity(linear=geometry_pb2.Vec2(x=0.3, y=0.3), angular=0.3)
        )
        params = spot_command_pb2.MobilityParams(vel_limit=limits)
        spot.walk(1.0, seconds=1.5, params=params)
        time.sleep(1.0)
        limited = spot.state.kinematic_state.velocity_of_body_in_odom.linear
        reported["limited"] = round(math.hypot(limited.x, limited.y), 2)
        frames = ("vision", "odom", "flat_body", "hand")
        reported["frames"] = [failure(lambda name=name: spot.walk(0.1, frame_name=name)) for name in frames]
        blocking_stand(spot.commands, timeout_sec=10)
        reported |= trajectory(spot)
        spot.robot.power_off(cut_immediately=False, timeout_sec=20)
        reported["off"] = not spot.robot.is_powered_on()
    return reported


def trajectory(spot: Powered) -> dict[str, Any]:
    """Walk one metre forwards and to the left, and turn."""
    reported: dict[str, Any] = {}
    here = frame_helpers.get_se2_a_tform_b(spot.frames, "odom", "body")
    goal = here * math_helpers.SE2Pose(1.0, 0.5, 1.0)
    there = RobotCommandBuilder.synchro_se2_trajectory_point_command(goal.x, goal.y, goal.angle, "odom")
    number = spot.command(there, 10.0)
    time.sleep(0.3)
    feedback = spot.feedback(number).mobility_command_feedback.se2_trajectory_feedback
    reported["on_the_way"] = [feedback.status, feedback.body_movement_status, feedback.final_goal_status]
    reported["arrives"] = block_for_trajectory_cmd(
        spot.commands, number, body_movement_statuses=(feedback.BODY_STATUS_SETTLED,), timeout_sec=8
    )
    feedback = spot.feedback(number).mobility_command_feedback.se2_trajectory_feedback
    reported["there"] = [feedback.status, feedback.body_movement_status, feedback.final_goal_status]
    now = frame_helpers.get_se2_a_tform_b(spot.frames, "odom", "body")
    reported["misses_m"] = math.hypot(now.x - goal.x, now.y - goal.y)
    reported["misses_rad"] = abs(now.angle - goal.angle)
    back = RobotCommandBuilder.synchro_trajectory_command_in_body_frame(-3.0, 0.0, 0.0, spot.frames)
    number = spot.command(back, 0.5)
    time.sleep(1.0)
    reported["too_far"] = spot.feedback(number).mobility_command_feedback.status
    number = spot.command(back, 5.0)
    spot.commands.robot_command(RobotCommandBuilder.synchro_stand_command())
    reported["replaced"] = spot.feedback(number).mobility_command_feedback.status
    wrong = RobotCommandBuilder.synchro_se2_trajectory_point_command(1.0, 0.0, 0.0, "flat_body")
    reported["wrong_frame"] = failure(lambda: spot.command(wrong))
    return reported


def pose(port: str) -> dict[str, Any]:
    """Stand as the vendor's example hello_spot does: twisted, then along three poses of the body."""
    reported: dict[str, Any] = {}
    with powered(port) as spot:
        blocking_stand(spot.commands, timeout_sec=10)
        feet = feet_in_odom(spot)
        nominal = spot.body
        flat = frame_helpers.get_a_tform_b(spot.frames, "odom", "flat_body")
        twisted = RobotCommandBuilder.synchro_stand_command(footprint_R_body=EulerZXY(yaw=0.4), body_height=0.05)
        number = spot.commands.robot_command(twisted)
        reported["moving"] = spot.feedback(number).mobility_command_feedback.stand_feedback.status
        time.sleep(1.0)
        reported["done"] = spot.feedback(number).mobility_command_feedback.stand_feedback.status
        reported["yaw"] = round(spot.body.rot.to_yaw() - nominal.rot.to_yaw(), 3)
        reported["raised_m"] = round(spot.body.z - nominal.z, 3)
        moved = zip(feet, feet_in_odom(spot), strict=True)
        reported["feet_moved_m"] = max(math.dist(before, after) for before, after in moved)
        poses = ((0.075, 0.0), (0.0, 0.1736), (0.0, 0.0))
        points = [
            trajectory_pb2.SE3TrajectoryPoint(pose=(flat * math_helpers.SE3Pose(x, 0, 0, pitched(y))).to_proto())
            for x, y in poses
        ]
        for number, point in enumerate(points, 1):
            point.time_since_reference.seconds = number
        body_pose = spot_command_pb2.BodyControlParams.BodyPose(
            root_frame_name="odom", base_offset_rt_root=trajectory_pb2.SE3Trajectory(points=points)
        )
        params = posed(body_pose)
        seen: list[Any] = []
        stand = RobotCommandBuilder.synchro_stand_command(params=params)
        number = spot.commands.robot_command(stand)
        for _ in range(2):
            time.sleep(0.95)
            seen.append(spot.body)
        began_s = time.monotonic()
        while spot.feedback(number).mobility_command_feedback.stand_feedback.status != 1:
            time.sleep(0.02)
        reported["ahead_m"] = round(seen[0].x - nominal.x, 2)
        reported["pitch"] = round(seen[1].rot.to_pitch(), 1)
        reported["took_s"] = 1.9 + time.monotonic() - began_s
        reported["back_m"] = math.dist((spot.body.x, spot.body.z), (nominal.x, nominal.z))
        far = RobotCommandBuilder.synchro_stand_command(body_height=1.0, footprint_R_body=EulerZXY(yaw=3.0))
        blocking = spot.commands.robot_command(far)
        time.sleep(1.5)
        reported["saturated"] = [
            spot.feedback(blocking).mobility_command_feedback.stand_feedback.status,
            round(spot.body.z - nominal.z, 2),
            round(spot.body.rot.to_yaw() - nominal.rot.to_yaw(), 2),
        ]
        body_pose.root_frame_name = "fiducial_1"
        params = posed(body_pose)
        reported["unknown_frame"] = failure(lambda: blocking_stand(spot.commands, params=params))
    return reported


def pitched(y: float) -> Any:
    return math_helpers.Quat(math.sqrt(1 - y * y), 0, y, 0)


def posed(body_pose: Any) -> Any:
    return spot_command_pb2.MobilityParams(body_control=spot_command_pb2.BodyControlParams(body_pose=body_pose))


def report(port: str) -> dict[str, Any]:
    """Read what programs ask first: state, frames, hardware, faults."""
    robot = connected(port)
    robot.authenticate("twin", "twin")
    states = robot.ensure_client("robot-state")
    state = states.get_robot_state()
    frames = state.kinematic_state.transforms_snapshot
    hardware = states.get_hardware_config_with_link_info()
    tforms = ("get_odom_tform_body", "get_vision_tform_body")
    return {
        "names": sorted(frame_helpers.get_frame_names(frames)),
        "valid": frame_helpers.validate_frame_tree_snapshot(frames),
        "heights": [round(getattr(frame_helpers, name)(frames).z, 3) for name in tforms],
        "ground": round(frame_helpers.get_a_tform_b(frames, "body", "gpe").z, 3),
        "has_arm": robot.has_arm(),
        "links": [len(hardware.skeleton.links), hardware.skeleton.links[0].obj_model.file_name],
        "faults": [len(state.system_fault_state.faults), len(state.behavior_fault_state.faults)],
        "feet": [foot.contact for foot in state.foot_state],
        "stowed": state.manipulator_state.stow_state,
        "metrics": [metric.label for metric in states.get_robot_metrics().metrics],
        "objects": failure(lambda: robot.ensure_client("world-objects")),
    }


def arm(port: str) -> dict[str, Any]:
    """Move arm and gripper, by name, by joints and through points."""
    reported: dict[str, Any] = {}
    with powered(port) as spot:
        blocking_stand(spot.commands, timeout_sec=10)
        commands, build = spot.commands, RobotCommandBuilder
        for name in ("ready", "carry", "stow"):
            number = commands.robot_command(getattr(build, f"arm_{name}_command")())
            early = spot.feedback(number).arm_command_feedback.named_arm_position_feedback.status
            arrives = block_until_arm_arrives(commands, number, 5)
            reported[name] = [early, arrives, spot.state.manipulator_state.stow_state]
        number = commands.robot_command(build.arm_joint_command(0.1, -1.0, 1.5, 0.0, 0.2, 0.0))
        reported["left_s"] = (
            spot.feedback(number).arm_command_feedback.arm_joint_move_feedback.time_to_goal.nanos / 1e9
        )
        reported["arrives"] = block_until_arm_arrives(commands, number, 5)
        reported["joints"] = {
            name: round(spot.joints[name], 3) for name in ("arm0.sh0", "arm0.sh1", "arm0.el0", "arm0.wr0")
        }
        hand = frame_helpers.get_a_tform_b(spot.frames, "body", "hand")
        reported["hand"] = [round(value, 2) for value in (hand.x, hand.y, hand.z)]
        number = commands.robot_command(build.arm_joint_command(9.0, -1.0, 1.5, 0.0, 0.2, 0.0))
        reported["past_a_limit"] = block_until_arm_arrives(commands, number, 5)
        move = spot.feedback(number).arm_command_feedback.arm_joint_move_feedback
        reported["stalled"] = [move.status, move.planner_status, round(spot.joints["arm0.sh0"], 3)]
        points = [(0.0, -1.0, 1.5, 0.0, 0.0, 0.0), (0.5, -1.0, 1.5, 0.0, 0.0, 0.0)]
        number = commands.robot_command(build.arm_joint_move_helper(points, [2.0, 3.0]))
        began_s = time.monotonic()
        reported["through"] = block_until_arm_arrives(commands, number, 6)
        reported["through_s"] = time.monotonic() - began_s
        number = commands.robot_command(build.claw_gripper_open_fraction_command(0.5))
        time.sleep(0.5)
        grip = spot.feedback(number).gripper_command_feedback
        reported["claw"] = [
            grip.status,
            grip.claw_gripper_feedback.status,
            round(spot.state.manipulator_state.gripper_open_percentage),
        ]
        walks = spot.walk(0.3, seconds=1.5)
        commands.robot_command(build.arm_stow_command())
        reported["walk_goes_on"] = STATUS.Name(spot.feedback(walks).mobility_command_feedback.status)
        nothing = robot_command_pb2.RobotCommand()
        nothing.synchronized_command.arm_command.named_arm_position_command.position = 0
        reported["no_position"] = failure(lambda: commands.robot_command(nothing))
    return reported


def hand(port: str) -> dict[str, Any]:
    """Move the hand as the vendor's examples arm_simple, arm_trajectory, arm_gaze and arm_freeze_hand do."""
    reported: dict[str, Any] = {}
    with powered(port) as spot:
        blocking_stand(spot.commands, timeout_sec=10)
        build, command = RobotCommandBuilder, spot.commands.robot_command
        flat = frame_helpers.get_a_tform_b(spot.frames, "odom", "flat_body")
        goal = flat * math_helpers.SE3Pose(0.75, 0.0, 0.25, math_helpers.Quat(math.sqrt(0.5), math.sqrt(0.5), 0, 0))
        pose = (goal.x, goal.y, goal.z, goal.rot.w, goal.rot.x, goal.rot.y, goal.rot.z, "odom")
        number = command(build.arm_pose_command(*pose, 2))
        early = spot.feedback(number).arm_command_feedback.arm_cartesian_feedback
        reported["far_m"] = round(early.measured_pos_distance_to_goal, 1)
        began_s = time.monotonic()
        reported["arrives"] = block_until_arm_arrives(spot.commands, number, 5)
        reported["took_s"] = time.monotonic() - began_s
        reported["misses"] = misses(frame_helpers.get_a_tform_b(spot.frames, "odom", "hand"), goal)
        forwards = build.synchro_trajectory_command_in_body_frame(0.2, 0, 0, spot.frames)
        block_for_trajectory_cmd(spot.commands, spot.command(forwards, 8.0), timeout_sec=8)
        reported["held_while_walking"] = misses(frame_helpers.get_a_tform_b(spot.frames, "odom", "hand"), goal)
        away = command(build.arm_pose_command(3.0, 0.0, 0.2, 1.0, 0.0, 0.0, 0.0, "body", 1))
        reported["too_far"] = block_until_arm_arrives(spot.commands, away, 5)
        command(build.arm_ready_command())
        target = flat.transform_point(x=3.0, y=4.0, z=0.0)
        number = command(build.arm_gaze_command(*target, "odom"))
        reported["gazes"] = block_until_arm_arrives(spot.commands, number, 4)
        reported["at_target"] = spot.feedback(number).arm_command_feedback.arm_gaze_feedback.gazing_at_target
        request = robot_command_pb2.RobotCommand()
        velocity = request.synchronized_command.arm_command.arm_velocity_command
        velocity.cylindrical_velocity.linear_velocity.z = 0.5
        velocity.end_time.CopyFrom(spot.robot.time_sync.robot_timestamp_from_local_secs(time.time() + 0.5))
        before = frame_helpers.get_a_tform_b(spot.frames, "flat_body", "hand").z
        command(request)
        time.sleep(1.0)
        reported["raised_m"] = frame_helpers.get_a_tform_b(spot.frames, "flat_body", "hand").z - before
        reported["unknown_frame"] = failure(
            lambda: command(build.arm_pose_command(1, 0, 0, 1, 0, 0, 0, "fiducial"))
        )
        reach = frame_helpers.get_a_tform_b(spot.frames, "odom", "flat_body") * math_helpers.SE3Pose(
            1.25, 0.0, 0.25, math_helpers.Quat()
        )
        there = build.arm_pose_command_from_pose(reach.to_proto(), "odom", 3)
        number = command(build.build_synchro_command(build.follow_arm_command(), there))
        reported["follows"] = block_until_arm_arrives(spot.commands, number, 6)
    return reported


def misses(now: Any, goal: Any) -> float:
    """Return how far two poses are apart: the larger of metres and radians."""
    difference = now.inverse() * goal
    far = math.sqrt(difference.x**2 + difference.y**2 + difference.z**2)
    return max(far, 2 * math.acos(min(1.0, abs(difference.rot.w))))


def stance(port: str) -> dict[str, Any]:
    """Put the feet to places as the vendor's example stance_in_place does."""
    reported: dict[str, Any] = {}
    with powered(port) as spot:
        blocking_stand(spot.commands, timeout_sec=10)
        body = frame_helpers.get_se2_a_tform_b(spot.frames, "vision", "flat_body")
        places = [(body * math_helpers.SE2Pose(x, y, 0)).position for x in (0.3, -0.3) for y in (0.3, -0.3)]
        request = RobotCommandBuilder.stance_command("vision", *places)
        for _ in range(3):
            number = spot.command(stanced(spot, request))
            time.sleep(1.0)
        reported["stanced"] = spot.feedback(number).mobility_command_feedback.stance_feedback.status
        feet = [foot[:2] for foot in feet_in_odom(spot)]
        reported["misses_m"] = max(
            math.dist(foot, (place.x, place.y)) for foot, place in zip(feet, places, strict=True)
        )
        far = [(body * math_helpers.SE2Pose(2 + x, y, 0)).position for x in (0.3, -0.3) for y in (0.3, -0.3)]
        number = spot.command(stanced(spot, RobotCommandBuilder.stance_command("vision", *far)))
        reported["too_far"] = spot.feedback(number).mobility_command_feedback.stance_feedback.status
    return reported


def stanced(spot: Powered, command: Any) -> Any:
    end = spot.robot.time_sync.robot_timestamp_from_local_secs(time.time() + 5)
    command.synchronized_command.mobility_command.stance_request.end_time.CopyFrom(end)
    return command


def images(port: str) -> dict[str, Any]:
    """Take pictures, and leave a comment, as the vendor's examples hello_spot and get_image do."""
    robot = connected(port)
    robot.authenticate("twin", "twin")
    robot.time_sync.wait_for_sync(8)
    client = robot.ensure_client("image")
    sources = client.list_image_sources()
    names = ["frontleft_fisheye_image", "frontleft_depth", "hand_color_image"]
    pictures = client.get_image_from_sources(names)
    frames = [picture.shot for picture in pictures]
    robot.operator_comment("hello")
    raw = [build_image_request(source.name, image_format=2) for source in sources]
    sizes = [len(picture.shot.image.data) for picture in client.get_image(raw)]
    return {
        "sources": len(sources),
        "raw": [len(sizes), sum(sizes) > 7_000_000],
        "sizes": [[picture.shot.image.cols, picture.shot.image.rows] for picture in pictures],
        "formats": [[picture.shot.image.format, picture.shot.image.pixel_format] for picture in pictures],
        "placed": [
            frame_helpers.get_a_tform_b(shot.transforms_snapshot, "odom", shot.frame_name_image_sensor) is not None
            for shot in frames
        ],
        "unknown": failure(lambda: client.get_image_from_sources(["front"])),
        "format": failure(lambda: client.get_image([build_image_request("back_depth", image_format=1)])),
        "pixels": failure(lambda: client.get_image([build_image_request("back_fisheye_image", pixel_format=5)])),
        "ratio": failure(lambda: client.get_image([build_image_request("back_depth", resize_ratio=3.0)])),
    }


def armless(port: str) -> dict[str, Any]:
    """Command an arm and a gripper that the robot lacks."""
    reported: dict[str, Any] = {}
    with powered(port) as spot:
        blocking_stand(spot.commands, timeout_sec=10)
        reported["has_arm"] = spot.robot.has_arm()
        number = spot.commands.robot_command(RobotCommandBuilder.arm_stow_command())
        arm = spot.feedback(number).arm_command_feedback
        reported["stow"] = [STATUS.Name(arm.status), arm.WhichOneof("feedback")]
        reported["arrives"] = block_until_arm_arrives(spot.commands, number, 0.5)
        number = spot.commands.robot_command(RobotCommandBuilder.arm_joint_command(0.1, -1.0, 1.5, 0.0, 0.2, 0.0))
        arm = spot.feedback(number).arm_command_feedback
        reported["joints"] = [STATUS.Name(arm.status), arm.WhichOneof("feedback")]
        number = spot.commands.robot_command(RobotCommandBuilder.claw_gripper_open_command())
        claw = spot.feedback(number).gripper_command_feedback
        reported["claw"] = [STATUS.Name(claw.status), claw.WhichOneof("command")]
        both = RobotCommandBuilder.synchro_velocity_command(0.3, 0, 0)
        both = RobotCommandBuilder.arm_stow_command(build_on_command=both)
        number = spot.command(both, 1.0)
        time.sleep(0.5)
        feedback = spot.feedback(number)
        reported["walks"] = [
            STATUS.Name(feedback.arm_command_feedback.status),
            round(spot.state.kinematic_state.velocity_of_body_in_odom.linear.x, 2),
        ]
        reported["hand"] = "hand" in frame_helpers.get_frame_names(spot.frames)
    return reported


def faulty(port: str) -> dict[str, Any]:
    """Use a robot that has fallen and whose IMU is broken."""
    robot = connected(port)
    robot.authenticate("twin", "twin")
    robot.time_sync.wait_for_sync(8)
    reported: dict[str, Any] = {}
    faults, commands = robot.ensure_client("fault"), robot.ensure_client("robot-command")
    with LeaseKeepAlive(robot.ensure_client("lease"), must_acquire=True, return_at_exit=True):
        endpoint = EstopEndpoint(robot.ensure_client("estop"), "vendor", 5.0)
        endpoint.force_simple_setup()
        with EstopKeepAlive(endpoint):
            reported["power"] = failure(lambda: robot.power_on(timeout_sec=5))
            reported["stand"] = failure(lambda: blocking_stand(commands, timeout_sec=1))
            state = robot.ensure_client("robot-state").get_robot_state()
            behaviour = state.behavior_fault_state.faults
            reported["behaviour"] = [[one.cause, one.status] for one in behaviour]
            reported["hardware"] = [[one.name, one.severity] for one in state.system_fault_state.faults]
            reported["cleared"] = [
                failure(lambda one=one: commands.clear_behavior_fault(one.behavior_fault_id)) for one in behaviour
            ]
    service = service_fault_pb2.ServiceFault(fault_id={"fault_name": "cold", "service_name": "camera"}, severity=2)
    reported["trigger"] = [failure(lambda: faults.trigger_service_fault(service)) for _ in range(2)]
    state = robot.ensure_client("robot-state").get_robot_state()
    reported["service"] = [one.fault_id.fault_name for one in state.service_fault_state.faults]
    reported["clear"] = [failure(lambda: faults.clear_service_fault(service.fault_id)) for _ in range(2)]
    registrations = robot.ensure_client("directory-registration")
    registered = ("mine", "void", "void", "0.0.0.0", 0)
    reported["register"] = [
        failure(lambda: registrations.register(*registered, liveness_timeout_secs=0.2)) for _ in range(2)
    ]
    time.sleep(0.4)
    state = robot.ensure_client("robot-state").get_robot_state()
    reported["silent"] = [one.fault_id.service_name for one in state.service_fault_state.faults]
    reported["update"] = failure(lambda: registrations.update("other", *registered[1:]))
    reported["unregister"] = [failure(lambda: registrations.unregister("mine")) for _ in range(2)]
    return reported


def repaired(port: str) -> dict[str, Any]:
    """Clear the last fault of a robot whose hardware is whole again, and let it stand."""
    robot = connected(port)
    robot.authenticate("twin", "twin")
    (fault,) = robot.ensure_client("robot-state").get_robot_state().behavior_fault_state.faults
    leases = robot.ensure_client("lease")
    leases.acquire("body")
    cleared = robot.ensure_client("robot-command").clear_behavior_fault(fault.behavior_fault_id)
    leases.return_lease(robot.lease_wallet.get_lease("body"))
    with powered(port) as spot:
        blocking_stand(spot.commands, timeout_sec=10)
        return {"cleared": cleared, "state": int(spot.state.behavior_state.state)}


SCENES: Mapping[str, Callable[[str], dict[str, Any]]] = {
    scene.__name__: scene
    for scene in (drive, walk, pose, report, arm, armless, hand, stance, images, faulty, repaired)
}

if __name__ == "__main__":
    print(json.dumps(SCENES[sys.argv[1]](sys.argv[2])), flush=True)
    os._exit(0)  # the vendor's threads would keep the process
