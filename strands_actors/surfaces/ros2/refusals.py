"""The texts of the refusals of commands from a ROS 2 graph: one function for each text."""

from __future__ import annotations

from strands_actors.kernel.messages import Refused
from strands_actors.kernel.refusals import Code


def second_writer(topic: str, sender: str, holder: str, pause_s: float) -> Refused:
    return Refused(
        Code.LEASE,
        f"{topic}: {holder} commands the robot, so the commands of {sender} are not sent",
        f"end {holder}, and send the next command {pause_s:g} s later",
    )


def stream_ended(topic: str, because: str, pause_s: float) -> Refused:
    return Refused(
        Code.STALE_EPOCH,
        f"{topic}: the robot has refused this stream: {because}",
        f"end the stream for {pause_s:g} s, call resume if the robot is stopped or holds, and start it again",
    )


def late_message(topic: str, late_s: float, lifetime_s: float) -> Refused:
    return Refused(
        Code.EXPIRED,
        f"{topic}: a message came {1e3 * late_s:.0f} ms late, and a command is valid for {1e3 * lifetime_s:.0f} ms",
        "check the network, and the clock of the sender's computer",
    )


def no_targets(topic: str) -> Refused:
    return Refused(Code.EMPTY, f"{topic}: the message has no names of joints", "give a name for each position")


def unequal_lengths(topic: str, names: int, positions: int) -> Refused:
    reason = f"{topic}: the message has {names} names and {positions} positions"
    return Refused(Code.MALFORMED, reason, "give one position for each name")


def named_twice(topic: str, joint: str) -> Refused:
    return Refused(Code.MALFORMED, f"{topic}: {joint} is named twice", "name each joint once")


def unknown_joint(topic: str, joint: str, joints: str) -> Refused:
    return Refused(
        Code.UNKNOWN_JOINT,
        f"{topic}: the robot has no joint {joint} that can be commanded",
        f"use the names of joint_states: {joints}",
        offered=joint,
        limit=joints,
    )


def unknown_direction(topic: str, component: str, accepted: str) -> Refused:
    return Refused(
        Code.UNKNOWN_JOINT,
        f"{topic}: the robot cannot move along {component}",
        f"set it to zero, and use {accepted}",
        offered=component,
        limit=accepted,
    )


def trajectory_not_followed(topic: str, because: str) -> Refused:
    return Refused(
        Code.MALFORMED,
        f"{topic}: the trajectory is not followed to its end: {because}",
        "remove the cause, and send it again",
    )


def unequal_numbers(topic: str, numbers: int, joints: str) -> Refused:
    reason = f"{topic}: the message has {numbers} numbers"
    return Refused(Code.MALFORMED, reason, f"give one position for each of {joints}, in this order", limit=joints)
