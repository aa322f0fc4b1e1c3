"""Motions that compute joint positions from poses of links."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from strands_actors.drivers.common.codecs import protobuf as pb
from strands_actors.drivers.common.physics.poses import between

from .kinematics import Task, error_of, manipulability, step_towards
from .motions import Impossible, Joints, Motion, check_spring, shortest_s, tracking
from .parts import CartesianMove, Optimum, Reach

_STEPS = 2
"""So many steps towards a pose in each control cycle."""
_JUMP = 0.05
"""Largest error of an optimum that one control cycle works on, in metres or rad."""
_SLOW_S = 0.02
"""An optimum counts as reached when its cost hardly changes for ``patience`` times this time [assumed]."""


class Reaching(Motion):
    """Base class of these motions."""

    def __init__(self, part: CartesianMove | Optimum, now_s: float, world: Joints) -> None:
        super().__init__(part, part.joints, now_s, world)
        self._own = list(part.joints)
        self._low, self._high = world.low[self._own].copy(), world.high[self._own].copy()
        for reach in part.reaches:
            if not (world.kinematics.knows(reach.reference) and world.kinematics.knows(reach.link)):
                raise Impossible(f"no link {reach.reference[:64]!r} or {reach.link[:64]!r}")
        self._aims = [(self._own_index(aim.joint), aim) for aim in part.aims]
        for number, aim in self._aims:
            if not self._low[number] <= aim.rad <= self._high[number]:
                raise Impossible(f"{aim.joint} beyond its range")
        self.manipulability = 1.0

    def _own_index(self, name: str) -> int:
        joint = self._world.number_of(name)
        if joint not in self._own:
            raise Impossible(f"{name} is not a joint of this part")
        return self._own.index(joint)

    def _aim_task(self, number: int, rad: float, here: Any, weight: float) -> Task:
        row = np.zeros((1, len(self._own)))
        row[0, number] = 1.0
        return Task(np.array([rad - here[number]]), row, np.array([weight]))

    def _step(self, tasks: Sequence[Task], target: list[float], most_rad: Any) -> None:
        here = np.array([target[joint] for joint in self._own])
        step = step_towards(tasks, here, self._low, self._high, most_rad)
        for joint, rad in zip(self._own, here + step, strict=True):
            target[joint] = float(rad)

    def _jacobian(self, reach: Reach) -> Any:
        return self._world.kinematics.jacobian(reach.reference, reach.link)[:, self._own]


class CartesianMotion(Reaching):
    """Links to poses, on straight ways."""

    def __init__(self, part: CartesianMove, now_s: float, target: Sequence[float], world: Joints) -> None:
        super().__init__(part, now_s, world)
        self._move = part
        check_spring(part.spring)
        for name, low, high in part.limits:
            number = self._own_index(name)
            self._low[number], self._high[number] = max(self._low[number], low), min(self._high[number], high)
            if not self._low[number] < self._high[number]:
                raise Impossible(f"{name} has no range")
        world.kinematics.place(target)
        self._begins = [world.kinematics.relative(reach.reference, reach.link) for reach in part.reaches]
        self._aims_begin = [target[self._own[number]] for number, _ in self._aims]
        self.arrive_s = now_s + max([part.minimum_s, *self._shortest_s()])
        if not math.isfinite(self.arrive_s):
            raise Impossible("a limit of zero")
        self.errors: list[tuple[float, float]] = []
        self._aim_errors: list[float] = []
        self._set_position: list[float] = []
        self._judge(target)

    def start(self, target: list[float]) -> None:
        if self._move.spring is None:
            self.release(target)
        else:
            self._soften(self._move.spring)

    def _shortest_s(self) -> Iterator[float]:
        """Yield the shortest time of each way."""
        number, fastest = self._world.parameters.number, self._world.fastest
        for reach, begin in zip(self._move.reaches, self._begins, strict=True):
            missing = error_of(reach.pose, begin)
            scale = reach.acceleration_scale * number("default.acceleration_limit_scaling")
            linear = min(reach.linear_m_s2, number("default.linear_acceleration_limit") * scale)
            angular = min(reach.angular_rad_s2, number("default.angular_acceleration_limit") * scale)
            yield shortest_s(float(np.linalg.norm(missing[:3])), reach.linear_m_s, linear)
            yield shortest_s(float(np.linalg.norm(missing[3:])), reach.angular_rad_s, angular)
        for (index, aim), begin_rad in zip(self._aims, self._aims_begin, strict=True):
            speed = min(aim.rad_s, float(fastest[self._own[index]]))
            yield shortest_s(abs(aim.rad - begin_rad), speed, math.inf)

    def advance(self, now_s: float, elapsed_s: float, target: list[float]) -> None:
        world, share = self._world, self._share(now_s)
        most_rad = world.fastest[self._own] * max(elapsed_s, 1e-6) / _STEPS
        for _ in range(_STEPS):
            world.kinematics.place(target)
            tasks = []
            for reach, begin in zip(self._move.reaches, self._begins, strict=True):
                goal = between(begin, reach.pose, share)
                missing = error_of(goal, world.kinematics.relative(reach.reference, reach.link))
                tasks.append(Task(missing, self._jacobian(reach), np.ones(6)))
            here = [target[joint] for joint in self._own]
            for (number, aim), begin_rad in zip(self._aims, self._aims_begin, strict=True):
                tasks.append(self._aim_task(number, begin_rad + share * (aim.rad - begin_rad), here, 1.0))
            if tasks:
                self._step(tasks, target, most_rad)
        self._judge(target)
        if self.manipulability > world.parameters.number("manipulability_threshold"):
            self.failed = True
        if now_s >= self.arrive_s and self._is_near():
            self._arrive(now_s)
        if self._move.spring is not None:
            self._compensate_gravity()

    def _judge(self, target: Sequence[float]) -> None:
        """Measure the errors at the commanded position of the joints [assumed]."""
        kinematics = self._world.kinematics
        kinematics.place(target)
        self.errors, self.manipulability = [], 1.0
        for reach in self._move.reaches:
            missing = error_of(reach.pose, kinematics.relative(reach.reference, reach.link))
            self.errors.append((float(np.linalg.norm(missing[:3])), float(np.linalg.norm(missing[3:]))))
            self.manipulability = max(self.manipulability, manipulability(self._jacobian(reach)))
        self._set_position = [target[joint] for joint in self._own]
        self._aim_errors = [abs(aim.rad - self._set_position[number]) for number, aim in self._aims]

    def _is_near(self) -> bool:
        kind = "cartesian_command" if self._move.spring is None else "cartesian_impedance_control_command"
        names = ("position", "orientation", "joint_position")
        limits = [
            self._world.parameters.number(f"default.{kind}.stop_{name}_tracking_error") if given is None else given
            for name, given in zip(names, self._move.stop_errors, strict=True)
        ]
        return all(metres <= limits[0] and rad <= limits[1] for metres, rad in self.errors) and all(
            rad <= limits[2] for rad in self._aim_errors
        )

    def report(self, now_s: float) -> bytes:
        remaining = pb.double_field(4 if self._move.spring is None else 3, max(0.0, self.arrive_s - now_s))
        if self._move.spring is not None:
            row = pb.double_fields(2, self._set_position, packed=True)
            return row + remaining + pb.double_field(4, self.manipulability)
        errors = b"".join(pb.bytes_field(2, tracking(*error)) for error in self.errors)
        aims = pb.double_fields(3, self._aim_errors, packed=True)
        return errors + aims + remaining + pb.double_field(5, self.manipulability)


class OptimumMotion(Reaching):
    """The joints to the least cost, as fast as they can."""

    def __init__(self, part: Optimum, now_s: float, target: Sequence[float], world: Joints) -> None:
        super().__init__(part, now_s, world)
        if part.mass is not None and not world.kinematics.knows(part.mass[0]):
            raise Impossible(f"no link {part.mass[0][:64]!r}")
        if not 0.0 < part.speed_scale <= 1.0:
            raise Impossible("a speed beyond the joints' own")
        self._optimum = part
        self._best, self._best_s = math.inf, now_s
        self.costs: tuple[list[float], float, list[float]] = ([], 0.0, [])

    def advance(self, now_s: float, elapsed_s: float, target: list[float]) -> None:
        world, part = self._world, self._optimum
        most_rad = world.fastest[self._own] * part.speed_scale * max(elapsed_s, 1e-6)
        world.kinematics.place(target)
        tasks, reach_costs, mass_cost, aim_costs = [], [], 0.0, []
        for reach in part.reaches:
            missing = error_of(reach.pose, world.kinematics.relative(reach.reference, reach.link))
            weight = np.repeat(reach.weights, 3)
            reach_costs.append(float(weight @ missing**2))
            tasks.append(Task(_shortened(missing), self._jacobian(reach), weight))
        if part.mass is not None:
            reference, goal, weight_of_mass = part.mass
            center, jacobian = world.kinematics.mass_center(reference)
            mass_cost = weight_of_mass * float(np.sum((goal - center) ** 2))
            tasks.append(Task(_shortened(goal - center), jacobian[:, self._own], np.full(3, weight_of_mass)))
        here = [target[joint] for joint in self._own]
        for number, aim in self._aims:
            aim_costs.append(aim.weight * (aim.rad - here[number]) ** 2)
            task = self._aim_task(number, aim.rad, here, aim.weight)
            tasks.append(Task(_shortened(task.error), task.jacobian, task.weight))
        self.costs = (reach_costs, mass_cost, aim_costs)
        if tasks:
            self._step(tasks, target, most_rad)
        self._settle(now_s, sum(reach_costs) + mass_cost + sum(aim_costs))

    def _settle(self, now_s: float, cost: float) -> None:
        """Arrive at a small cost, or when the cost no longer falls."""
        part = self._optimum
        stop = part.stop_cost
        if stop is None:
            stop = self._world.parameters.number("default.optimal_control_command.stop_cost")
        if cost < self._best - part.least_change:
            self._best, self._best_s = cost, now_s
        waits_s = part.patience * _SLOW_S
        if cost < stop or (part.patience and now_s - self._best_s > waits_s):
            self._arrive(now_s)

    def report(self, now_s: float) -> bytes:
        reaches, mass, aims = self.costs
        return (
            pb.double_field(2, sum(reaches) + mass + sum(aims))
            + pb.double_fields(3, reaches, packed=True)
            + pb.double_field(4, mass)
            + pb.double_fields(5, aims, packed=True)
        )


def _shortened(error: Any) -> Any:
    longest = float(np.max(np.abs(error), initial=0.0))
    return error * min(1.0, _JUMP / longest) if longest > 0.0 else error
