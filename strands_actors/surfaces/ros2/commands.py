"""Convert messages of the graph to targets in the units of a robot's driver. Pure.

Range and speed are not checked here: the robot's own gate does that for every writer.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from strands_actors.contract.shown import shown
from strands_actors.kernel.messages import Refused

from . import refusals
from .joints import Layout

Targets = dict[str, float]


def targets_of_joints(topic: str, message: Mapping[str, Any], layout: Layout) -> Targets | Refused:
    """Return the targets in a sensor_msgs/msg/JointState. Its velocities and efforts are ignored.

    Args:
        topic: The name of the topic, for refusals.
        message: The message. A joint that it does not name keeps its target.
        layout: The joints of the robot.
    """
    names, positions = message["name"], message["position"]
    if not names:
        return refusals.no_targets(topic)
    if len(names) != len(positions):
        return refusals.unequal_lengths(topic, len(names), len(positions))
    joints = {joint.key: joint for joint in layout.joints if joint.key in layout.commanded}
    targets: Targets = {}
    for name, position in zip(names, positions, strict=True):
        if name not in joints:
            return refusals.unknown_joint(topic, shown(name), ", ".join(joints))
        if name in targets:
            return refusals.named_twice(topic, name)
        targets[name] = joints[name].value(position)
    return targets


def targets_of_numbers(topic: str, message: Mapping[str, Any], layout: Layout) -> Targets | Refused:
    """Return the targets in a std_msgs/msg/Float64MultiArray: one position for each joint that can be commanded, in
    the order of ``joint_states``. Its layout is ignored."""
    joints = [joint for joint in layout.joints if joint.key in layout.commanded]
    numbers = message["data"]
    if len(numbers) != len(joints):
        return refusals.unequal_numbers(topic, len(numbers), ", ".join(joint.key for joint in joints))
    return {joint.key: joint.value(number) for joint, number in zip(joints, numbers, strict=True)}


def targets_of_twist(topic: str, message: Mapping[str, Any], layout: Layout) -> Targets | Refused:
    """Return the speeds in a geometry_msgs/msg/Twist. A component that the robot lacks must be zero.

    Args:
        topic: The name of the topic, for refusals.
        message: The message: metres per second, radians per second, in the robot's own frame.
        layout: The axes of the robot's base.
    """
    targets: Targets = {}
    for part in ("linear", "angular"):
        for component, speed in message[part].items():
            key = layout.twist.get((part, component))
            if key is not None:
                targets[key] = speed
            elif speed != 0.0:
                accepted = ", ".join(".".join(each) for each in layout.twist)
                return refusals.unknown_direction(topic, f"{part}.{component}", accepted)
    return targets
