"""Read the arguments of a motion to a pose."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from strands_actors.contract.axis import finite
from strands_actors.contract.plain_numbers import as_python
from strands_actors.contract.rotations import quaternion, roll_pitch_yaw
from strands_actors.kernel.messages import Refused

from . import refusals

FRAMES = ("base", "tool")
DEFAULT_SPEED_M_S = 0.1
MOST_SPEED_M_S = 3.0
FARTHEST_M = 10.0
"""Greatest coordinate. A greater one was probably meant in millimetres."""
MOST_DEG = 360.0
MOST_BOXES = 32
UNIT_TOLERANCE = 0.05
"""Largest difference between the length of a quaternion and 1."""

Vector = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]


class Box(NamedTuple):
    """A space that the arm may not enter: its centre and its edges in m, along the axes of the base."""

    center: Vector
    size: Vector


class PoseRequest(NamedTuple):
    """A requested pose, checked.

    Attributes:
        xyz: Position in m. None keeps the position.
        quat: Orientation as w, x, y, z. None keeps the orientation.
        frame: ``base``: the pose is in the frame of the base. ``tool``: relative to the present pose of the tool.
        speed_m_s: Top speed of the tool.
        linear: True moves the tool along a straight line. False interpolates the joints.
        keep_out: Spaces that the arm may not enter.
    """

    xyz: Vector | None
    quat: Quaternion | None
    frame: str = "base"
    speed_m_s: float = DEFAULT_SPEED_M_S
    linear: bool = True
    keep_out: tuple[Box, ...] = ()


def read_request(
    xyz: Any = None,
    rpy: Any = None,
    quat: Any = None,
    frame: Any = "base",
    speed: Any = DEFAULT_SPEED_M_S,
    linear: Any = True,
    keep_out: Any = (),
) -> PoseRequest | Refused:
    """Return the checked request, or a refusal. The arguments are those of ``RealRobot.move_to``."""
    if xyz is None and rpy is None and quat is None:
        return refusals.no_pose()
    if rpy is not None and quat is not None:
        return refusals.two_orientations()
    place = None if xyz is None else _numbers(xyz, 3)
    if xyz is not None and (place is None or max(map(abs, place)) > FARTHEST_M):
        return refusals.bad_numbers("xyz", xyz, f"3 numbers in metres, at most {FARTHEST_M:g}")
    turn = _orientation(rpy, quat)
    if isinstance(turn, Refused):
        return turn
    if frame not in FRAMES:
        return refusals.bad_frame(frame, FRAMES)
    rate = finite(as_python(speed))
    if rate is None or not 0 < rate <= MOST_SPEED_M_S:
        return refusals.bad_numbers("speed", speed, f"m/s, above 0 and at most {MOST_SPEED_M_S:g}")
    if not isinstance(linear, bool):
        return refusals.bad_numbers("linear", linear, "True or False")
    boxes = _boxes(keep_out)
    if isinstance(boxes, Refused):
        return boxes
    vector = None if place is None else (place[0], place[1], place[2])
    return PoseRequest(vector, turn, frame, rate, linear, boxes)


def quat_of(rpy_deg: Sequence[float]) -> Quaternion:
    """Return the quaternion w, x, y, z of roll, pitch and yaw in degrees, about the fixed axes x, y and z."""
    roll, pitch, yaw = map(math.radians, rpy_deg)
    return quaternion(roll, pitch, yaw)


def rpy_of(quat: Sequence[float]) -> Vector:
    """Return roll, pitch and yaw in degrees of a quaternion w, x, y, z."""
    roll, pitch, yaw = map(math.degrees, roll_pitch_yaw(quat))
    return roll, pitch, yaw


def _orientation(rpy: Any, quat: Any) -> Quaternion | Refused | None:
    if rpy is not None:
        angles = _numbers(rpy, 3)
        if angles is None or max(map(abs, angles)) > MOST_DEG:
            return refusals.bad_numbers("rpy", rpy, f"3 angles in degrees, at most {MOST_DEG:g}")
        return quat_of(angles)
    if quat is None:
        return None
    numbers = _numbers(quat, 4)
    length = 0.0 if numbers is None else math.hypot(*numbers)
    if numbers is None or abs(length - 1) > UNIT_TOLERANCE:
        return refusals.bad_numbers("quat", quat, "4 numbers w, x, y, z of length 1")
    w, x, y, z = (number / length for number in numbers)
    return w, x, y, z


def _boxes(keep_out: Any) -> tuple[Box, ...] | Refused:
    if keep_out is None:
        return ()
    if not isinstance(keep_out, Sequence) or isinstance(keep_out, str) or len(keep_out) > MOST_BOXES:
        return refusals.bad_numbers("keep_out", keep_out, f"a list of at most {MOST_BOXES} boxes")
    boxes = []
    for number, box in enumerate(keep_out):
        named = box if isinstance(box, Mapping) else {}
        center, size = _numbers(named.get("center"), 3), _numbers(named.get("size"), 3)
        if center is None or size is None or min(size) <= 0 or set(named) > {"center", "size"}:
            return refusals.bad_box(number, box)
        boxes.append(Box((center[0], center[1], center[2]), (size[0], size[1], size[2])))
    return tuple(boxes)


def _numbers(values: Any, count: int) -> tuple[float, ...] | None:
    """Return the finite numbers of a sequence of this length; None for anything else."""
    values = values.tolist() if hasattr(values, "tolist") else values
    if not isinstance(values, Sequence) or isinstance(values, str) or len(values) != count:
        return None
    numbers = [finite(as_python(value)) for value in values]
    return None if None in numbers else tuple(number for number in numbers if number is not None)


__all__ = ["Box", "PoseRequest", "quat_of", "read_request", "rpy_of"]
