"""Plan motions through waypoints, and report what is wrong with them.

The arm stops at each waypoint. The blending radius of a waypoint is checked, but corners are not rounded [assumed:
the real arm passes by such a waypoint].
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from strands_actors.drivers.common.codecs import protobuf as pb
from strands_actors.drivers.kinova.protocol import SubError

from . import messages as m
from .errors import CallFailed
from .kinematics import pose_of
from .paths import Leg, Planner

ERROR_TYPES = {
    SubError.OUTSIDE_WORKSPACE: 1,
    SubError.ACTUATOR_COUNT_MISMATCH: 2,
    SubError.INVALID_DURATION: 3,
    SubError.INVALID_SPEED: 5,
    SubError.LARGE_SPEED: 5,
    SubError.JOINT_POSITION_LIMIT: 11,
}
"""``TrajectoryErrorType`` for the error of one waypoint."""

INVALID_SIZE, MIXED_TYPES, LAST_BLENDS, INVALID_BLENDING, INVALID_FRAME = 9, 25, 27, 28, 29


class WaypointError(CallFailed):
    """The error of one waypoint, with the vendor's type for the report."""

    def __init__(self, index: int, error_type: int, sub_error: SubError, text: str) -> None:
        super().__init__(sub_error, f"waypoint {index}: {text}")
        self.index = index
        self.error_type = error_type

    def encode(self) -> bytes:
        """Return a ``TrajectoryErrorElement``."""
        return (
            pb.varint_field(1, self.error_type)
            + pb.bytes_field(7, str(self).encode())
            + pb.varint_field(8, self.index)
        )


class WaypointPlanner:
    def __init__(self, planner: Planner) -> None:
        self._planner = planner

    def plan(self, start: Sequence[float], payload: bytes) -> list[Leg]:
        """Plan the motion of a ``WaypointList``, from these joint positions in rad.

        Raises:
            WaypointError: The arm cannot do it.
        """
        fields = pb.message(payload)
        waypoints = m.sub_messages(fields, 1)
        if not waypoints:
            raise WaypointError(0, INVALID_SIZE, SubError.INVALID_PARAM, "the list is empty")
        if len({3 in waypoint for waypoint in waypoints}) > 1:
            raise WaypointError(0, MIXED_TYPES, SubError.INVALID_PARAM, "angular and Cartesian ones in one list")
        legs: list[Leg] = []
        here = list(start)
        for index, waypoint in enumerate(waypoints):
            try:
                if 3 in waypoint:
                    leg = self._cartesian(here, m.sub_message(waypoint, 3), index, len(waypoints))
                else:
                    leg = self._angular(here, m.sub_message(waypoint, 2))
            except WaypointError:
                raise
            except CallFailed as failed:
                error_type = ERROR_TYPES.get(failed.sub_error, 0)
                raise WaypointError(index, error_type, failed.sub_error, str(failed)) from None
            legs.append(leg)
            here = leg.end
        total_s, requested_s = sum(leg.duration_s for leg in legs), m.finite(fields, 2)
        if 0.0 < requested_s < total_s:
            text = f"the motion takes at least {total_s:.2f} s"
            raise WaypointError(
                len(legs) - 1, ERROR_TYPES[SubError.INVALID_DURATION], SubError.INVALID_DURATION, text
            )
        return legs

    def validate(self, start: Sequence[float], payload: bytes) -> bytes:
        """Return the ``WaypointValidationReport``. Raise ``CallFailed`` if optimal blending is requested."""
        if pb.last_int(pb.message(payload), 3):
            raise CallFailed(SubError.UNSUPPORTED_ACTION, "optimal blending radii are not computed")
        try:
            self.plan(start, payload)
        except WaypointError as error:
            return pb.bytes_field(1, pb.bytes_field(1, error.encode()))
        return pb.bytes_field(1, b"")

    def _angular(self, here: Sequence[float], fields: m.Fields) -> Leg:
        angles = m.repeated_floats(fields, 1)
        speeds, duration_s = m.repeated_floats(fields, 2), m.finite(fields, 3)
        if speeds and len(speeds) != len(angles):
            raise CallFailed(SubError.ACTUATOR_COUNT_MISMATCH, f"{len(speeds)} speeds, not {len(angles)}")
        if duration_s < 0.0:
            raise CallFailed(SubError.INVALID_DURATION, f"{duration_s:.2f} s")
        slowest = math.radians(min(speeds)) if speeds else 0.0
        if speeds and slowest <= 0.0:
            raise CallFailed(SubError.INVALID_SPEED, f"a speed of {min(speeds)}")
        return self._planner.joints(here, angles, duration_s, slowest)

    def _cartesian(self, here: Sequence[float], fields: m.Fields, index: int, count: int) -> Leg:
        frame, radius = pb.last_int(fields, 2), m.finite(fields, 5)
        if frame not in (0, m.BASE_FRAME):
            text = f"reference frame {frame}"
            raise WaypointError(index, INVALID_FRAME, SubError.INVALID_PARAM, text)
        if radius < 0.0:
            raise WaypointError(index, INVALID_BLENDING, SubError.INVALID_PARAM, f"blending radius {radius}")
        if radius and index == count - 1:
            raise WaypointError(index, LAST_BLENDS, SubError.INVALID_PARAM, "the last one must not blend")
        pose = pose_of(m.decode_pose(m.sub_message(fields, 1)))
        linear, angular = m.finite(fields, 3), math.radians(m.finite(fields, 4))
        return self._planner.line(here, pose, linear, angular)
