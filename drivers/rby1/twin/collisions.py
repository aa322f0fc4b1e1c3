"""Distances between the robot's links, from the capsules of the vendor's model 1.2."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np

from strands_actors.drivers.common.codecs import protobuf as pb

from .kinematics import Kinematics

NEAREST = 5
"""So many pairs are reported, the nearest first [assumed]."""

_TABLE = """
link_torso_0     -.115,0,0        x .230  .105 1   0
link_torso_1     .01,0,.24        z .220  .115 2   0
link_torso_2     .025,0,.23       z .160  .095 4   0
link_torso_4     -.07,0,.0385     x .200  .105 8   0
link_torso_5     0,0,.0075        z .135  .155 16  0
link_right_arm_0 -.015,.018,-.008  x .070  .075 0   0
link_right_arm_1 0,0,-.1          z .200  .050 32  0
link_right_arm_2 .026,0,-.276     y .080  .050 64  0
link_right_arm_3 -.031,0,-.1075   z .115  .040 128 30
link_right_arm_4 0,-.038,.0175    z .095  .035 256 30
link_right_arm_5 0,0,-.08565      z .2213 .075 512 31
link_left_arm_0  -.015,-.018,-.008 x .070  .075 0   0
link_left_arm_1  0,0,-.1          z .200  .050 0   768
link_left_arm_2  .026,0,-.276     y .080  .050 0   768
link_left_arm_3  -.031,0,-.1075   z .115  .040 0   926
link_left_arm_4  0,.038,.0175     z .095  .035 0   1022
link_left_arm_5  0,0,-.08565      z .2213 .075 0   1023
"""
"""Link, centre, axis, length and radius in metres, and two masks. A pair counts if the first mask of one capsule
meets the second mask of the other."""


class Capsule(NamedTuple):
    link: str
    center: tuple[float, ...]
    axis: str
    length: float
    radius: float
    mask: int
    others: int

    def urdf(self) -> str:
        """Return it as an element of a URDF."""
        turn = {"x": "0 1.5708 0", "y": "1.5708 0 0", "z": "0 0 0"}[self.axis]
        place = " ".join(map(str, self.center))
        return (
            f'<collision><origin xyz="{place}" rpy="{turn}"/><geometry><capsule radius="{self.radius}" '
            f'length="{self.length}" coltype="{self.mask}" colaffinity="{self.others}"/></geometry></collision>'
        )


def _capsules() -> Iterator[Capsule]:
    for line in _TABLE.split("\n"):
        if line:
            link, center, axis, length, radius, mask, others = line.split()
            place = tuple(map(float, center.split(",")))
            yield Capsule(link, place, axis, float(length), float(radius), int(mask), int(others))


CAPSULES = tuple(_capsules())
_PAIRS = [
    (one, other)
    for one, first in enumerate(CAPSULES)
    for other, second in enumerate(CAPSULES[:one])
    if first.mask & second.others or second.mask & first.others
]
_ONE, _OTHER = (np.array(column) for column in zip(*_PAIRS, strict=True))
_RADII = np.array([CAPSULES[one].radius + CAPSULES[other].radius for one, other in _PAIRS])
_ENDS = np.array(
    [
        np.array(capsule.center) + np.eye(3)["xyz".index(capsule.axis)] * side * capsule.length / 2
        for side in (-1.0, 1.0)
        for capsule in CAPSULES
    ]
)
"""First one end of all capsules, then the other end of all, in the frames of their links."""


class Nearness(NamedTuple):
    """A pair of links, the points of their capsules' axes that are nearest to each other, and their distance. It is
    negative where they touch."""

    links: tuple[str, str]
    points: tuple[Any, Any]
    distance_m: float

    def encode(self) -> bytes:
        """Encode ``Collision``."""
        places = (b"".join(pb.double_field(n, float(x)) for n, x in enumerate(point, 1)) for point in self.points)
        return (
            pb.bytes_field(1, self.links[0].encode())
            + pb.bytes_field(2, self.links[1].encode())
            + b"".join(pb.bytes_field(number, place) for number, place in enumerate(places, 3))
            + pb.double_field(5, self.distance_m)
        )


def nearest(kinematics: Kinematics) -> list[Nearness]:
    """Return the nearest pairs at the position of the kinematics."""
    links = [capsule.link for capsule in CAPSULES] * 2
    begins, ends = kinematics.points(links, _ENDS).reshape(2, len(CAPSULES), 3)
    here, there = _nearest_points(begins[_ONE], ends[_ONE], begins[_OTHER], ends[_OTHER])
    distances = np.linalg.norm(here - there, axis=1) - _RADII
    return [
        Nearness(
            (CAPSULES[_ONE[pair]].link, CAPSULES[_OTHER[pair]].link),
            (here[pair], there[pair]),
            float(distances[pair]),
        )
        for pair in np.argsort(distances)[:NEAREST]
    ]


def _nearest_points(a: Any, b: Any, c: Any, d: Any) -> tuple[Any, Any]:
    """Return the nearest points of the lines from a to b and from c to d, for many pairs of lines at once."""
    first, second, between = b - a, d - c, a - c
    long, wide = np.sum(first * first, axis=1), np.sum(second * second, axis=1)
    along, across = np.sum(first * second, axis=1), np.sum(second * between, axis=1)
    ahead = np.sum(first * between, axis=1)
    crossing = np.maximum(long * wide - along * along, 1e-12)
    share = np.clip((along * across - ahead * wide) / crossing, 0.0, 1.0)
    other = np.clip((along * share + across) / wide, 0.0, 1.0)
    share = np.clip((along * other - ahead) / long, 0.0, 1.0)
    return a + share[:, None] * first, c + other[:, None] * second
