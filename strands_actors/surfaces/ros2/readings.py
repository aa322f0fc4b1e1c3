"""Convert the topics of a robot to ROS messages. Pure.

A stamp is the time of the reading, by the wall clock of the robot's host.
"""

from __future__ import annotations

from typing import Any

from strands_actors.contract.axis import finite
from strands_actors.kernel.clock import NS

from .joints import Layout
from .samples import State


def stamp(time_s: float) -> dict[str, int]:
    """Return builtin_interfaces/msg/Time for a time of the wall clock, in seconds."""
    time_ns = round(time_s * NS)
    return {"sec": time_ns // NS, "nanosec": time_ns % NS}


def header(time_s: float, frame: str = "") -> dict[str, Any]:
    return {"stamp": stamp(time_s), "frame_id": frame}


def joint_state(state: State, layout: Layout) -> dict[str, Any] | None:
    """Return sensor_msgs/msg/JointState with each joint that was read.

    Velocities are given only if all these joints have one, since ROS expects as many velocities as names.

    Returns:
        None if no joint was read, or if the reading is too old.
    """
    if state.age_s is None or not 0.0 <= state.age_s <= layout.stale_s:
        return None
    names: list[str] = []
    positions: list[float] = []
    velocities: list[float] = []
    for joint in layout.joints:
        value, speed = finite(state.joints.get(joint.key)), finite(state.velocities.get(joint.key))
        if value is None:
            continue
        names.append(joint.key)
        positions.append(joint.position(value))
        if speed is not None:
            velocities.append(joint.velocity(speed))
    if not names:
        return None
    return {
        "header": header(state.t - state.age_s),
        "name": names,
        "position": positions,
        "velocity": velocities if len(velocities) == len(names) else [],
    }
