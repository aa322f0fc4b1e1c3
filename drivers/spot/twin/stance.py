"""How the simulated Spot puts its feet to places (``StanceCommand``). Pure: no clock.

The feet move one after the other, each on a straight way. Meanwhile the body moves to the middle of the new places,
and turns as they are turned ("footprint frame: gravity aligned, with yaw computed from the stance feet",
spot/robot_command.proto). How long a step takes, and how far a stance may be away, is [assumed].
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from strands_actors.drivers.spot.protocol import Vector

from .geometry import turned, wrapped
from .limbs import HIPS, leg_to
from .walking import Place

FEET = ("fl", "fr", "hl", "hr")
"""Names of the feet in the message ``Stance``, in the order of the legs."""
STEP_S = 0.4
"""Duration of one step."""
FARTHEST_M = 0.35
"""Longest way of the body. A stance that is farther away needs a walk."""
HIP_RAD = 0.7854
"""Largest angle of the first joint of a hip, either way (the vendor's model)."""

Point = tuple[float, float]
"""A place on the floor: x, y."""


def accuracy_of(stance: Mapping[str, float]) -> float:
    """Return how near a foot must be to its place, metres. The file advises 0.05, and permits 0.02 to 0.10."""
    return min(0.10, max(0.02, float(stance.get("accuracy", 0.0)) or 0.05))


def middle_of(feet: Sequence[Sequence[float]]) -> Point:
    x, y = (sum(foot[axis] for foot in feet) / len(feet) for axis in (0, 1))
    return x, y


def place_of(feet: Sequence[Point], yaw_rad: float, middle: Point) -> Place:
    """Return the place and the angle of the footprint of four feet.

    Args:
        feet: The places of the feet.
        yaw_rad: The present angle, from which the new one goes on without a jump.
        middle: The middle of the feet in the footprint, in the default stance.
    """
    front, hind = ([(a + b) / 2 for a, b in zip(*pair, strict=True)] for pair in (feet[:2], feet[2:]))
    yaw = math.atan2(front[1] - hind[1], front[0] - hind[0])
    (x, y), (ahead, aside) = middle_of(feet), turned(yaw, *middle)
    return x - ahead, y - aside, yaw_rad + wrapped(yaw - yaw_rad)


def under(place: Place, foot: Point, down_m: float) -> Vector:
    """Return where a foot on the floor is in the default pose of the body above a footprint."""
    x, y = turned(-place[2], foot[0] - place[0], foot[1] - place[1])
    return x, y, down_m


class Stance:
    """One stance: the ways of the feet and of the footprint.

    Args:
        begins_s: The time of the first step.
        place: The present place of the footprint.
        feet: The present places of the feet, in the order of the legs.
        goals: Where they shall be.
        accuracy_m: A foot that is nearer to its goal stays.
        middle: As for ``place_of``.
    """

    def __init__(
        self,
        begins_s: float,
        place: Place,
        feet: Sequence[Point],
        goals: Sequence[Point],
        accuracy_m: float,
        middle: Point,
    ) -> None:
        self._begins_s = begins_s
        self._place = place
        self._feet = tuple(feet)
        moving = [math.dist(foot, goal) > accuracy_m for foot, goal in zip(feet, goals, strict=True)]
        self._goals = tuple(goal if moves else foot for foot, goal, moves in zip(feet, goals, moving, strict=True))
        self._order = [leg for leg, moves in enumerate(moving) if moves]
        self._last = place_of(self._goals, place[2], middle) if self._order else place
        self.ends_s = begins_s + STEP_S * len(self._order)

    def is_near(self, down_m: float) -> bool:
        """Return True if the robot reaches this stance without a walk."""
        if math.dist(self._place[:2], self._last[:2]) > FARTHEST_M:
            return False
        for leg in range(len(HIPS)):
            angles = leg_to(leg, under(self._last, self._goals[leg], down_m))
            if angles is None or abs(angles[0]) > HIP_RAD:
                return False
        return True

    def place_at(self, time_s: float) -> Place:
        share = self._share(time_s, self._begins_s, self.ends_s)
        x, y, yaw = (a + (b - a) * share for a, b in zip(self._place, self._last, strict=True))
        return x, y, yaw

    def feet_at(self, time_s: float) -> list[Point]:
        places = []
        for leg, (foot, goal) in enumerate(zip(self._feet, self._goals, strict=True)):
            if leg in self._order:
                begins_s = self._begins_s + STEP_S * self._order.index(leg)
                share = self._share(time_s, begins_s, begins_s + STEP_S)
                foot = foot[0] + (goal[0] - foot[0]) * share, foot[1] + (goal[1] - foot[1]) * share
            places.append(foot)
        return places

    def has_ended(self, time_s: float) -> bool:
        return time_s >= self.ends_s

    @staticmethod
    def _share(time_s: float, begins_s: float, ends_s: float) -> float:
        return 1.0 if time_s >= ends_s else max(0.0, (time_s - begins_s) / (ends_s - begins_s))
