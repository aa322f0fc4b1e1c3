"""Commands to the joints, to the base and to links of the robot, as ``requests`` decodes them."""

from __future__ import annotations

import math

import msgspec

from strands_actors.drivers.common.physics.poses import Pose, Vector
from strands_actors.drivers.rby1.commands import PARTS

JOINTS: dict[str, tuple[int, ...]] = {}
"""The joints of each component, by their index in the driven joints."""
for _name, _count in PARTS.items():
    _start = sum(map(len, JOINTS.values()))
    JOINTS[_name] = tuple(range(_start, _start + _count))
BODY = JOINTS["torso"] + JOINTS["right_arm"] + JOINTS["left_arm"]
BASE = (-2, -1)
"""The wheels, which stand before the driven joints. They stand for the mobile base."""


class Reach(msgspec.Struct, frozen=True, kw_only=True):
    """A pose that a link should reach. Missing limits are infinite."""

    reference: str
    link: str
    pose: Pose
    linear_m_s: float = math.inf
    angular_rad_s: float = math.inf
    linear_m_s2: float = math.inf
    angular_rad_s2: float = math.inf
    acceleration_scale: float = 1.0
    weights: tuple[float, float] = (1.0, 1.0)  # of position and rotation


class Aim(msgspec.Struct, frozen=True):
    """A position that one joint should reach."""

    joint: str
    rad: float
    rad_s: float = math.inf
    weight: float = 1.0


class Spring(msgspec.Struct, frozen=True):
    """Joint stiffness in Nm/rad, damping ratio, and the largest torque of each spring in Nm. A missing row leaves
    the joint's own value."""

    stiffness: tuple[float, ...] = ()
    damping: float = 1.0
    torque: tuple[float, ...] = ()


class Part(msgspec.Struct, frozen=True, kw_only=True):
    """The command to some joints."""

    path: tuple[int, ...]
    joints: tuple[int, ...]
    minimum_s: float = 0.0
    hold_s: float = 0.0


class JointMove(Part, frozen=True, kw_only=True):
    """Move joints to positions, as stiff servos or as springs."""

    position: tuple[float, ...]
    speed: tuple[float, ...] = ()
    acceleration: tuple[float, ...] = ()
    spring: Spring | None = None
    names: tuple[str, ...] = ()  # the joints that move, if they are given by name


class CartesianMove(Part, frozen=True, kw_only=True):
    """Move links to poses."""

    reaches: tuple[Reach, ...]
    aims: tuple[Aim, ...] = ()
    stop_errors: tuple[float | None, float | None, float | None] = (None, None, None)  # metres, rad, joint rad
    limits: tuple[tuple[str, float, float], ...] = ()
    spring: Spring | None = None


class Optimum(Part, frozen=True, kw_only=True):
    """Move the joints to the least cost."""

    reaches: tuple[Reach, ...]
    aims: tuple[Aim, ...] = ()
    mass: tuple[str, Vector, float] | None = None  # reference, position of the centre of mass, weight
    speed_scale: float = 1.0
    stop_cost: float | None = None
    least_change: float = 0.0
    patience: int = 0


class LinkSpring(Part, frozen=True, kw_only=True):
    """Pull a link to a pose with a spring."""

    reach: Reach
    translation: tuple[float, ...]  # N/m
    rotation: tuple[float, ...]  # Nm/rad
    damping: float


class Weightless(Part, frozen=True, kw_only=True):
    """Compensate gravity, and give way to any force."""

    on: bool


class BaseMove(Part, frozen=True, kw_only=True):
    """Move the base."""

    velocity: tuple[float, float]  # forwards in m/s, to the left in rad/s
    acceleration: tuple[float, float] | None = None
    wheels: tuple[float, ...] = ()  # rad/s of each wheel, instead of ``velocity``


class Jog(Part, frozen=True, kw_only=True):
    """Move one joint by a step."""

    name: str
    kind: str  # absolute, relative or one_step
    value: float
    rad_s: float
