"""Read the table of a robot that is a node of a ROS 2 graph: its topics, joints and limits."""

from __future__ import annotations

import math
import os
import tomllib
from collections.abc import Mapping
from typing import Any, Literal

import msgspec

BASE = ("linear.x", "linear.y", "angular.z")
"""The keys of a base, as a ``geometry_msgs/msg/Twist`` names them."""

EXAMPLE = "{'base': {'linear.x': 0.5, 'angular.z': 1.0}, 'odom': '/odom', 'cmd_vel': '/cmd_vel'}"


class Joint(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """One joint.

    Attributes:
        low: Its lowest position, in ``unit``.
        high: Its highest position.
        speed: Its greatest speed, in ``unit`` per second.
        unit: ``rad`` or ``m``.
    """

    low: float
    high: float
    speed: float
    unit: Literal["rad", "m"] = "rad"


class Table(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """One robot.

    Attributes:
        joints: Its joints, by their names in ``joint_states``.
        joint_states: The topic with their positions.
        follow_joint_trajectory: The action that moves them.
        base: The greatest speed of each axis of its base (``linear.x``, ``linear.y``: m/s, ``angular.z``: rad/s).
        odom: The topic with the odometry of the base.
        cmd_vel: The topic of its twists.
        stamped: True if that topic has the type TwistStamped.
        node_timeout_s: The time without a twist after which the node stops the base by itself, in seconds, as its
            documentation states it. None if it is not known.
    """

    joints: dict[str, Joint] = {}
    joint_states: str = "/joint_states"
    follow_joint_trajectory: str = ""
    base: dict[Literal["linear.x", "linear.y", "angular.z"], float] = {}
    odom: str = "/odom"
    cmd_vel: str = "/cmd_vel"
    stamped: bool = False
    node_timeout_s: float | None = None

    @property
    def base_keys(self) -> tuple[str, ...]:
        return tuple(key for key in BASE if key in self.base)


def read_table(table: object) -> dict[str, Any]:
    """Return a table as plain data, after it was checked.

    Args:
        table: The table, or the path of a TOML file with it.

    Raises:
        ValueError: The table cannot be used. The text has the reason.
    """
    if isinstance(table, str | os.PathLike):
        path = os.path.expanduser(table)
        try:
            with open(path, "rb") as file:
                table = tomllib.load(file)
        except (OSError, tomllib.TOMLDecodeError) as error:
            raise ValueError(f"table: {path}: {error}") from None
    if not isinstance(table, Mapping):
        raise ValueError(f"table is {table!r}. Give the topics and limits of the robot: table={EXAMPLE}")
    try:
        read = msgspec.convert(dict(table), Table)
    except msgspec.ValidationError as error:
        raise ValueError(f"table: {error}. docs/ros2.md lists its entries") from None
    if reason := _refuse(read):
        raise ValueError(f"table: {reason}")
    plain: dict[str, Any] = msgspec.to_builtins(read)
    return plain


def _refuse(table: Table) -> str:
    """Return why a table cannot be used; empty if it can."""
    if not table.joints and not table.base:
        return f"it has neither joints nor a base. Give one of them: table={EXAMPLE}"
    if bool(table.joints) is not bool(table.follow_joint_trajectory):
        return "joints need follow_joint_trajectory, the name of their action, and it needs joints. Give both"
    for key, joint in table.joints.items():
        if key in BASE or not -math.inf < joint.low < joint.high < math.inf or not 0 < joint.speed < math.inf:
            return f"joints: {key}: give low below high, and a speed above 0, as finite numbers"
    for key, speed in table.base.items():
        if not 0 < speed < math.inf:
            return f"base: {key} is {speed:g}. Give its greatest speed, above 0"
    if table.node_timeout_s is not None and not 0 < table.node_timeout_s < math.inf:
        return f"node_timeout_s is {table.node_timeout_s:g}. Give seconds above 0, or leave it out"
    for name in (table.joint_states, table.odom, table.cmd_vel, table.follow_joint_trajectory or "/a"):
        if not name.startswith("/") or name.endswith("/") or any(sign in name for sign in " *$?#"):
            return f"{name!r} is no full name of a topic. Give one such as '/odom'"
    return ""
