"""The texts of the refusals before a command or a motion is sent: one function for each text."""

from __future__ import annotations

from strands_actors.contract.shown import shown
from strands_actors.kernel.messages import Refused
from strands_actors.kernel.refusals import Code

# -- the right to command, and the state of the robot


def no_lease(verb: str = "") -> Refused:
    return Refused(Code.LEASE, "no lease", verb=verb)


def stopped_meanwhile(verb: str) -> Refused:
    return Refused(Code.STOPPED, "the robot was stopped meanwhile", "call resume() again", verb=verb)


def not_armed(verb: str, mode: str) -> Refused:
    return Refused(Code.NOT_ARMED, f"the robot is {mode}", "call connect_eagerly() or resume() first", verb=verb)


def no_reading(verb: str) -> Refused:
    reason = "no reading of the robot has come yet"
    return Refused(Code.NO_OBSERVATION, reason, "wait for the first observation", verb=verb)


# -- rollouts


def no_rollouts(verb: str, robot: str, cause: str) -> Refused:
    return Refused(Code.NO_ROLLOUT, f"{robot}: {cause}", "call send_action()", verb=verb)


def no_tasks(verb: str, robot: str, cause: str) -> Refused:
    return Refused(Code.NO_TASK, f"{robot}: {cause}", "call run_policy()", verb=verb)


def task_running(verb: str, starts_another: bool) -> Refused:
    reason = "a task is already running" if starts_another else "a task is running"
    return Refused(Code.RUNNING, reason, "call stop_task() first", verb=verb)


def no_teleoperation() -> Refused:
    return Refused(Code.NO_TELEOP, "no teleoperation runs", "call attach_teleop() first", verb="operate")


# -- a motion to targets


def bad_time(verb: str, argument: str, seconds: object, longest_s: float) -> Refused:
    offered, limit = shown(seconds), f"above 0, at most {longest_s:g}"
    return Refused(Code.BAD_TIME, f"{argument} is {offered}", f"give seconds, {limit}", offered, limit, verb=verb)


def no_positions(robot: str) -> Refused:
    reason = f"{robot} has no joints that go to a target"
    return Refused(Code.NO_POSITIONS, reason, "use send_action(), or move(..., duration_s=)")


def keeps_no_pose(robot: str, fallback: str) -> Refused:
    reason = f"{robot} keeps no pose by itself: when its commands end it goes to {fallback}"
    return Refused(Code.KEEPS_NO_POSE, reason, "use run_policy() with a policy that keeps its pose afterwards, too")


def a_speed(key: object) -> Refused:
    reason = f"{shown(key)} is a speed, and has no target to reach"
    remedy = "give joints here, and speeds to move(..., duration_s=) or send_action()"
    return Refused(Code.A_SPEED, reason, remedy, shown(key), "joints")


def no_number(key: object, value: object) -> Refused:
    reason = f"{shown(key)} is {shown(value)}"
    return Refused(Code.NOT_FINITE, reason, "give a number for each joint", shown(value), "a number")


def unknown_pose(joint: str) -> Refused:
    remedy = "use send_action(), which says how the robot goes there"
    return Refused(Code.UNKNOWN_POSE, f"where {joint} is, is not known", remedy, joint)


def too_far(joint: str, distance: float, unit: str, seconds: float, least_s: str) -> Refused:
    reason = f"{joint} has {distance:.4g}{unit} to go, too far for {seconds:g} s"
    return Refused(Code.TOO_FAST, reason, f"give seconds={least_s} or more", f"{seconds:g}", least_s)


# -- a motion along a path


def bad_row_rate(hz: object, most_hz: float) -> Refused:
    offered, limit = shown(hz), f"above 0, at most {most_hz:g}"
    return Refused(Code.BAD_PATH, f"hz is {offered}", f"give rows a second, {limit}", offered, limit)


def no_rows() -> Refused:
    remedy = "give a list of joints with numbers: [{'joint': 0.0}, ...]"
    return Refused(Code.BAD_PATH, "it is no list of rows", remedy)


def other_joints(row: int) -> Refused:
    reason = f"row {row} names other joints than row 0"
    return Refused(Code.BAD_PATH, reason, "name the same joints in each row")


def incomplete_row(row: int, joint: str) -> Refused:
    return Refused(Code.BAD_PATH, f"row {row} has no number for {joint}", "give a finite number")


def path_too_long(seconds: float, longest_s: float) -> Refused:
    limit = f"at most {longest_s:g}"
    return Refused(Code.BAD_PATH, f"it takes {seconds:.4g} s", f"give a path of {limit} s", "", limit)


def unknown_joint(robot: str, joint: str, joints: str) -> Refused:
    reason = f"{robot} has no joint {shown(joint)}"
    return Refused(Code.UNKNOWN_JOINT, reason, f"use some of {joints}", shown(joint))
