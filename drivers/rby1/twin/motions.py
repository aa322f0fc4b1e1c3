"""Motions of joints and of the base: each carries out one command, and reports its progress.

A motion sets the targets of its joints, from its start until it has ended. All times are on the controller's
timeline.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from strands_actors.drivers.common.codecs import protobuf as pb

from .base import WHEEL_RAD_S, Base
from .kinematics import Kinematics, error_of
from .parameters import Parameters
from .parts import BaseMove, Jog, JointMove, LinkSpring, Part, Spring, Weightless
from .plant import RBY1Plant

_ROUNDING = 1e-6


class Impossible(Exception):
    """The robot does not begin a command, which ends with the finish code INITIALIZED_FAILED."""


class Joints(NamedTuple):
    """Joints, base, model and parameters, as a motion uses them."""

    names: tuple[str, ...]
    low: Any
    high: Any
    speed: Any
    plant: RBY1Plant
    kinematics: Kinematics
    parameters: Parameters
    base: Base

    def number_of(self, name: str) -> int:
        """Return the index of a joint. Raise ``Impossible`` for an unknown name."""
        if name not in self.names:
            raise Impossible(f"no joint {name[:64]!r}")
        return self.names.index(name)

    @property
    def fastest(self) -> Any:
        """Return the joints' speeds in force, in rad/s."""
        return self.speed * self.parameters.number("default.velocity_limit_scaling")


def shortest_s(way: float, speed: float, acceleration: float) -> float:
    """Return the shortest time of a motion from rest to rest."""
    if way <= 0.0:
        return 0.0
    if not acceleration > 0.0 or not speed > 0.0:
        return math.inf
    ramp_s = speed / acceleration
    if math.isinf(speed) or speed * ramp_s >= way:
        return 2.0 * math.sqrt(way / acceleration)
    return way / speed + ramp_s


class Motion:
    """Base class. ``joints`` are those that the motion sets. A command that cannot begin raises ``Impossible`` from
    the constructor, which changes nothing."""

    failed = False
    """True if the motion cannot go on."""

    def __init__(self, part: Part, joints: tuple[int, ...], now_s: float, world: Joints) -> None:
        self.joints = joints
        self.begin_s = self.arrive_s = now_s
        self.torques: Mapping[int, float] = {}  # in addition to those of the servos, in Nm
        self._part = part
        self._world = world
        self._until_s: float | None = None  # end of the hold time; None while the motion has not arrived

    def start(self, target: list[float]) -> None:
        """Take over the joints, which may be springs."""
        self.release(target)

    def advance(self, now_s: float, elapsed_s: float, target: list[float]) -> None:
        """Set the joints' targets for the present time."""

    def release(self, target: list[float]) -> None:
        """Make springs stiff joints again, where they are."""
        plant = self._world.plant
        position = plant.position_rad
        for joint in self.joints:
            if plant.is_spring(joint):
                target[joint] = position[joint]
                plant.make_stiff(joint)

    def has_ended(self, now_s: float) -> bool:
        return self._until_s is not None and now_s >= self._until_s

    def report(self, now_s: float) -> bytes:
        """Encode the feedback, without the messages around it."""
        return b""

    def feedback(self, now_s: float) -> bytes:
        """Encode the feedback, with the messages around it."""
        data = pb.bytes_field(1, pb.varint_field(1, int(self.has_ended(now_s)))) + self.report(now_s)
        for number in reversed(self._part.path):
            data = pb.bytes_field(number, data)
        return data

    def _share(self, now_s: float) -> float:
        span_s = self.arrive_s - self.begin_s
        return 1.0 if span_s <= 0.0 else max(0.0, min(1.0, (now_s - self.begin_s) / span_s))

    def _arrive(self, now_s: float) -> None:
        """Note that the motion has arrived. Its hold time begins."""
        if self._until_s is None:
            self._until_s = now_s + self._part.hold_s

    def _soften(self, spring: Spring) -> None:
        """Make the joints springs."""
        world = self._world
        world.kinematics.place(world.plant.position_rad)
        inertia = np.diagonal(world.kinematics.inertia())
        for number, joint in enumerate(self.joints):
            stiffness = spring.stiffness[number]
            damping = 2.0 * spring.damping * math.sqrt(stiffness * float(inertia[joint]))
            world.plant.make_spring(joint, stiffness, damping, spring.torque[number] if spring.torque else None)

    def _let_go(self) -> None:
        """Make the joints springs without stiffness."""
        for joint in self.joints:
            self._world.plant.make_spring(joint, 0.0, 0.0)

    def _compensate_gravity(self) -> None:
        """Hold the weight of the springs. The limit of a spring's torque does not count this torque [assumed]."""
        plant = self._world.plant
        self.torques = {joint: plant.weight_nm(joint) for joint in self.joints if plant.is_spring(joint)}


def check_spring(spring: Spring | None) -> None:
    """Raise ``Impossible`` for a spring without a stiffness."""
    if spring is not None and not spring.stiffness:
        raise Impossible("no stiffness")


class JointMotion(Motion):
    """Joints to positions. It takes the given time, but the joints turn no faster than they can."""

    def __init__(self, part: JointMove, now_s: float, target: Sequence[float], world: Joints) -> None:
        joints = tuple(map(world.number_of, part.names)) if part.names else part.joints
        if not set(joints) <= set(part.joints) or len(set(joints)) != len(joints):
            raise Impossible(f"{', '.join(part.names)} are not joints of this part")
        super().__init__(part, joints, now_s, world)
        self._goal = part.position
        self._named = bool(part.names)
        self._spring = part.spring
        check_spring(part.spring)
        low, high, fastest = world.low, world.high, world.fastest
        self._begin = [target[joint] for joint in joints]
        needed_s = 0.0
        for number, joint in enumerate(joints):
            goal = self._goal[number]
            if not low[joint] - _ROUNDING <= goal <= high[joint] + _ROUNDING:
                raise Impossible(f"{world.names[joint]} beyond its range")
            speed = min(float(fastest[joint]), part.speed[number] if part.speed else math.inf)
            # Without a limit in the command, joints reach their speed at once.
            acceleration = part.acceleration[number] if part.acceleration else math.inf
            needed_s = max(needed_s, shortest_s(abs(goal - self._begin[number]), speed, acceleration))
        if not math.isfinite(needed_s):
            raise Impossible("a limit of zero")
        self.arrive_s = now_s + max(part.minimum_s, needed_s)
        self._until_s = self.arrive_s + part.hold_s

    def start(self, target: list[float]) -> None:
        if self._spring is None:
            self.release(target)
        else:
            self._soften(self._spring)

    def advance(self, now_s: float, elapsed_s: float, target: list[float]) -> None:
        share = self._share(now_s)
        for joint, begin, goal in zip(self.joints, self._begin, self._goal, strict=True):
            target[joint] = begin + share * (goal - begin)
        if self._spring is not None:
            self._compensate_gravity()

    def report(self, now_s: float) -> bytes:
        position = self._world.plant.position_rad
        here = [position[joint] for joint in self.joints]
        if self._spring is not None:
            share = self._share(now_s)
            set_position = [
                begin + share * (goal - begin) for begin, goal in zip(self._begin, self._goal, strict=True)
            ]
            errors = [goal - rad for goal, rad in zip(set_position, here, strict=True)]
            return pb.double_fields(2, set_position, packed=True) + pb.double_fields(3, errors, packed=True)
        way = math.dist(self._begin, self._goal)
        position_share = 1.0 - math.dist(here, self._goal) / way if way > _ROUNDING else 1.0
        first = 3 if self._named else 2
        indices = b"".join(pb.varint_field(2, joint + 2) for joint in self.joints) if self._named else b""
        return indices + pb.double_field(first, self._share(now_s)) + pb.double_field(first + 1, position_share)


def jogged(part: Jog, target: Sequence[float], world: Joints) -> JointMove:
    """Return the motion of a jog."""
    joint = world.number_of(part.name)
    match part.kind:
        case "absolute":
            goal = part.value
        case "relative":
            goal = target[joint] + part.value
        case _:
            step = world.parameters.number("jog_command.one_step_size")
            goal = target[joint] + (step if part.value else -step)
    return JointMove(
        path=part.path,
        joints=(joint,),
        hold_s=part.hold_s,
        position=(goal,),
        speed=() if math.isinf(part.rad_s) else (part.rad_s,),
    )


class SpringMotion(Motion):
    """A link to a pose, by the force of a spring. The joints themselves are free."""

    def __init__(self, part: LinkSpring, now_s: float, world: Joints) -> None:
        super().__init__(part, part.joints, now_s, world)
        reach = part.reach
        if not (world.kinematics.knows(reach.reference) and world.kinematics.knows(reach.link)):
            raise Impossible(f"no link {reach.reference[:64]!r} or {reach.link[:64]!r}")
        self._spring = part
        self._stiffness = np.array((*part.translation, *part.rotation))
        self.error = (0.0, 0.0)
        self._arrive(now_s)

    def start(self, target: list[float]) -> None:
        self._let_go()

    def advance(self, now_s: float, elapsed_s: float, target: list[float]) -> None:
        world, reach = self._world, self._spring.reach
        world.kinematics.place(world.plant.position_rad)
        missing = error_of(reach.pose, world.kinematics.relative(reach.reference, reach.link))
        whole = world.kinematics.jacobian(reach.reference, reach.link)
        own = whole[:, list(self.joints)]
        inverse = np.linalg.inv(world.kinematics.inertia()[np.ix_(self.joints, self.joints)])
        mass = np.linalg.inv(own @ inverse @ own.T + 1e-4 * np.eye(6))
        root, springs = _root(mass), np.diag(np.sqrt(self._stiffness))
        damping = self._spring.damping * (root @ springs + springs @ root)
        wrench = self._stiffness * missing - damping @ (whole @ np.array(world.plant.velocity_rad_s))
        torques = own.T @ wrench
        self.error = (float(np.linalg.norm(missing[:3])), float(np.linalg.norm(missing[3:])))
        self.torques = {
            joint: float(torque) + world.plant.weight_nm(joint)
            for joint, torque in zip(self.joints, torques, strict=True)
        }
        for joint in self.joints:
            target[joint] = world.plant.position_rad[joint]

    def report(self, now_s: float) -> bytes:
        return pb.bytes_field(2, tracking(*self.error))


class WeightlessMotion(Motion):
    """The joints give way to any force, or hold."""

    def __init__(self, part: Weightless, now_s: float, world: Joints) -> None:
        super().__init__(part, part.joints, now_s, world)
        self._on = part.on
        self._arrive(now_s)

    def start(self, target: list[float]) -> None:
        if self._on:
            self._let_go()
        else:
            self.release(target)

    def advance(self, now_s: float, elapsed_s: float, target: list[float]) -> None:
        if self._on:
            position = self._world.plant.position_rad
            for joint in self.joints:
                target[joint] = position[joint]
            self._compensate_gravity()


class BaseMotion(Motion):
    """The base to a velocity, which it keeps for the hold time."""

    def __init__(self, part: BaseMove, now_s: float, world: Joints) -> None:
        super().__init__(part, part.joints, now_s, world)
        right_left = part.wheels
        self._goal = Base.velocity_of(*right_left) if right_left else part.velocity
        self._begin = world.base.velocity
        if any(abs(wheel) > WHEEL_RAD_S for wheel in Base.wheels_of(self._goal)):
            raise Impossible("a wheel beyond its speed")
        limit = part.acceleration or base_acceleration(world.parameters)
        ways = (abs(goal - begin) for goal, begin in zip(self._goal, self._begin, strict=True))
        needed_s = max(shortest_ramp_s(way, most) for way, most in zip(ways, limit, strict=True))
        if not math.isfinite(needed_s):
            raise Impossible("a limit of zero")
        self.arrive_s = now_s + max(part.minimum_s, needed_s)
        self._until_s = self.arrive_s + part.hold_s

    def advance(self, now_s: float, elapsed_s: float, target: list[float]) -> None:
        share = self._share(now_s)
        forwards, turning = (
            begin + share * (goal - begin) for begin, goal in zip(self._begin, self._goal, strict=True)
        )
        self._world.base.velocity = forwards, turning


def shortest_ramp_s(change: float, acceleration: float) -> float:
    """Return the shortest time in which a speed changes so much."""
    if change <= 0.0:
        return 0.0
    return change / acceleration if acceleration > 0.0 else math.inf


def base_acceleration(parameters: Parameters) -> tuple[float, float]:
    """Return the acceleration of the base in force: forwards in m/s2, turning in rad/s2."""
    angular, forwards, _ = parameters.row("default.se2_velocity_command.acceleration_limit")
    return forwards, angular


def _root(matrix: Any) -> Any:
    """Return the square root of a symmetric matrix."""
    values, vectors = np.linalg.eigh((matrix + matrix.T) / 2)
    return vectors @ np.diag(np.sqrt(np.maximum(values, 0.0))) @ vectors.T


def tracking(metres: float, rad: float) -> bytes:
    return pb.double_field(1, metres) + pb.double_field(2, rad)
