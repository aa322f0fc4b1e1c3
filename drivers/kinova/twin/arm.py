"""Simulate the controller of the joints: it turns them by speeds, by a velocity of the tool, or along a plan.

All commands end in targets of the joints' servos. Speeds approach their commanded values with the joints'
acceleration. A joint stops at the end of its range, and reports no fault, as in the vendor's own simulator. No
motion enters a protection zone.

In low-level servoing the client gives the targets itself. A joint whose target is too far away then has a following
error, and a target out of range is a fault, too. Both are faults of the joint [assumed: their limits].
"""

from __future__ import annotations

import enum
import math
from collections import deque
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from strands_actors.drivers.common.physics.physics import Plant
from strands_actors.drivers.kinova import protocol as p
from strands_actors.drivers.kinova.protocol import SubError

from .kinematics import Kinematics, Matrix
from .paths import Leg

ALL = range(p.JOINTS)

ARRIVED_RAD, ARRIVES_S = 0.01, 2.0
"""A planned motion has arrived if each joint is this near to its target. A joint that does not arrive in time after
the end of the plan aborts the motion."""

MISSING = 0.1
"""A velocity of the tool may miss this share of its command, if a joint is at its limit."""

FRICTION_NM_S = 1.0
"""Viscous friction of an actuator in torque control, in Nm at 1 rad/s [assumed]."""

FOLLOWING_RAD = math.radians(5.0)
FOLLOWING_ERROR, JOINT_LIMIT_HIGH, JOINT_LIMIT_LOW = 1, 4, 8
"""Bits of an actuator's fault bank A."""

Ended = Callable[[SubError], None]
"""Called at the end of a planned motion, with ``NONE`` if the arm has arrived."""


class ControlMode(enum.IntEnum):
    """Control modes of an actuator that the simulated arm has."""

    POSITION = 1
    TORQUE = 3


class Arm:
    def __init__(
        self,
        plant: Plant,
        table: Mapping[str, Any],
        kinematics: Callable[[], Kinematics],
        is_free: Callable[[Sequence[float]], bool],
    ) -> None:
        """Args:
        plant: The body.
        table: The robot's table in ``robots.toml``.
        kinematics: Returns the kinematics, which are made when they are first used.
        is_free: Returns True if the tool may be where it is at these joint positions.
        """
        self.plant = plant
        self._kinematics = kinematics
        self._is_free = is_free
        self._acceleration = float(table["acceleration_rad_s2"])
        self._fastest = np.array([float(joint["speed_rad_s"]) for joint in table["joints"]])
        endless = (-math.inf, math.inf)
        self._ranges: list[tuple[float, float]] = [
            tuple(joint.get("range_rad", endless)) for joint in table["joints"]
        ]
        self._keys = [joint["key"] for joint in table["joints"]]
        self.modes = [ControlMode.POSITION] * p.JOINTS
        self._torques = [0.0] * p.JOINTS
        self._target = list(plant.position_rad)
        self.reset()

    def reset(self) -> None:
        """Hold the present position, with all actuators in position control."""
        self._rates = [0.0] * p.JOINTS  # Present speeds of the targets in rad/s.
        self._legs: deque[Leg] = deque()
        self.faults = [0] * p.JOINTS
        """Fault bank A of each actuator."""
        self.hold_all()
        for joint in ALL:
            self.plant.set_torque(joint, True)
        self.hold()
        self._target = list(self.plant.position_rad)

    @property
    def target(self) -> list[float]:
        return list(self._target)

    @property
    def effort_nm(self) -> list[float]:
        """The torque of each actuator: that of its servo, or the commanded one in torque control."""
        rows = zip(self.plant.effort_nm, self._torques, strict=True)
        return [servo + torque for servo, torque in rows]

    @property
    def is_busy(self) -> bool:
        """True while targets move, or a plan waits for the body."""
        return any(self._rates) or any(self._speeds) or self._twist is not None or self._ended is not None

    # -- commands

    def hold(self) -> None:
        """Brake, and forget all commands. The end of a planned motion is not reported."""
        self._speeds = [0.0] * p.JOINTS  # Commanded speeds in rad/s.
        self._twist: Matrix | None = None
        self._twist_in_tool = False, False
        self._legs.clear()
        self._leg_s = -1.0  # Time since the start of the first leg; negative before it.
        self._late_s = 0.0
        self._ended: Ended | None = None

    def set_speeds(self, rad_s: Mapping[int, float]) -> None:
        """Turn these joints at these speeds until the next command. The others keep their speeds."""
        speeds = self._speeds
        self.hold()
        self._speeds = [rad_s.get(joint, speeds[joint]) for joint in ALL]

    def set_twist(self, twist: Matrix, in_tool: tuple[bool, bool]) -> None:
        """Move the tool at a velocity until the next command.

        Args:
            twist: The velocity in m/s, then the angular velocity in rad/s.
            in_tool: True if the velocity is along the axes of the tool; the same for the angular velocity.
                Otherwise they are along the axes of the base.
        """
        self.hold()
        self._twist, self._twist_in_tool = twist, in_tool

    def play(self, legs: Iterable[Leg], ended: Ended) -> None:
        """Brake, and then move along these legs. They begin where the targets are at rest."""
        self.hold()
        self._legs.extend(legs)
        self._ended = ended

    def rest(self) -> list[float]:
        """Return the targets at which the arm comes to rest if it brakes now, in rad."""
        return [
            self._clip(joint, rad + rate * abs(rate) / (2.0 * self._acceleration))
            for joint, (rad, rate) in enumerate(zip(self._target, self._rates, strict=True))
        ]

    def set_targets(self, rad: Sequence[float]) -> None:
        """Set the targets at once, for a simulation."""
        self._target = list(rad)
        for joint, value in enumerate(rad):
            self.plant.set_target(joint, value)

    def take_over(self) -> None:
        """Begin at the body's position, after a simulation has moved it."""
        self._target = list(self.plant.position_rad)

    # -- low-level servoing

    def command(self, joint: int, degrees: float, torque_nm: float) -> None:
        """Set the target of one actuator, or its torque in torque control."""
        if self.modes[joint] is ControlMode.TORQUE:
            self._torques[joint] = torque_nm
            self.plant.push(self._torques)
            self._target[joint] = self.plant.position_rad[joint]
            return
        here = self._target[joint]
        rad = here + math.remainder(math.radians(degrees) - here, math.tau)
        low, high = self._ranges[joint]
        if not low <= rad <= high:
            self.faults[joint] |= JOINT_LIMIT_HIGH if rad > high else JOINT_LIMIT_LOW
        elif abs(rad - self.plant.position_rad[joint]) > FOLLOWING_RAD:
            self.faults[joint] |= FOLLOWING_ERROR
        else:
            self._target[joint] = rad
            self.plant.set_target(joint, rad)

    def set_mode(self, joint: int, mode: ControlMode) -> None:
        """Set the control mode of an actuator. It starts at the joint's position, without torque."""
        self.modes[joint] = mode
        self._torques[joint] = 0.0
        self.plant.push(self._torques)
        model = self.plant.model
        model.dof_damping[model.joint(self._keys[joint]).dofadr] = FRICTION_NM_S * (mode is ControlMode.TORQUE)
        self.plant.set_torque(joint, mode is ControlMode.POSITION)
        self._target[joint] = self.plant.position_rad[joint]
        self.plant.set_target(joint, self._target[joint])

    def hold_all(self) -> None:
        """Put all actuators into position control."""
        for joint in ALL:
            if self.modes[joint] is not ControlMode.POSITION:
                self.set_mode(joint, ControlMode.POSITION)

    # -- time

    def turn(self, seconds: float) -> None:
        """Move the targets for a short time."""
        if self._ended is not None and (self._leg_s >= 0.0 or not any(self._rates)):
            self._follow(seconds, self._ended)
        else:
            self._approach(self._commanded_rates(), seconds)

    def _commanded_rates(self) -> Sequence[float]:
        if self._twist is None:
            return self._speeds
        kinematics = self._kinematics()
        pose, jacobian = kinematics.jacobian(self._target)
        parts = zip(self._twist.reshape(2, 3), self._twist_in_tool, strict=True)
        twist = np.concatenate([pose.rotation @ part if in_tool else part for part, in_tool in parts])
        rates = kinematics.search.least_rates(jacobian, twist)
        at_limit = self._leaving(rates)
        if at_limit.any():
            # The other joints move the tool alone. If they cannot, the tool stops [assumed].
            jacobian[:, at_limit] = 0.0
            rates = kinematics.search.least_rates(jacobian, twist)
            missing = np.linalg.norm(jacobian @ rates - twist)
            if self._leaving(rates).any() or missing > MISSING * np.linalg.norm(twist):
                return [0.0] * p.JOINTS
        # Near singular positions the tool becomes slower.
        slower: list[float] = (rates / max(1.0, float((np.abs(rates) / self._fastest).max()))).tolist()
        return slower

    def _leaving(self, rates: Matrix) -> Matrix:
        """Return which joints would leave their ranges at these speeds."""
        rows = zip(self._target, self._ranges, strict=True)
        rooms = np.array([(low - rad, high - rad) for rad, (low, high) in rows])
        result: Matrix = ((rates > 0.0) & (rooms[:, 1] <= 0.0)) | ((rates < 0.0) & (rooms[:, 0] >= 0.0))
        return result

    def _approach(self, goal: Sequence[float], seconds: float) -> None:
        most = self._acceleration * seconds
        before, target = self._target, list(self._target)
        for joint in ALL:
            rate = self._rates[joint]
            rate += max(-most, min(most, goal[joint] - rate))
            rad = before[joint] + rate * seconds
            target[joint] = self._clip(joint, rad)
            self._rates[joint] = rate if target[joint] == rad else 0.0
        if not self._may_move(before, target):
            self._rates = [0.0] * p.JOINTS
            return
        self.set_targets(target)

    def _follow(self, seconds: float, ended: Ended) -> None:
        if not self._legs:
            self._late_s += seconds
            far = max(abs(a - b) for a, b in zip(self._target, self.plant.position_rad, strict=True))
            if far < ARRIVED_RAD or self._late_s > ARRIVES_S:
                self.hold()
                ended(SubError.NONE if far < ARRIVED_RAD else SubError.METHOD_FAILED)
            return
        leg = self._legs[0]
        self._leg_s = max(self._leg_s, 0.0) + seconds
        target = leg.position(self._leg_s)
        if not self._may_move(self._target, target):
            self.hold()
            ended(SubError.SAFETY_THRESHOLD_REACHED)
            return
        self._rates = [(rad - here) / seconds for rad, here in zip(target, self._target, strict=True)]
        self.set_targets(target)
        if self._leg_s >= leg.duration_s:
            self._legs.popleft()
            self._leg_s = 0.0
            self._rates = [0.0] * p.JOINTS

    def _clip(self, joint: int, rad: float) -> float:
        low, high = self._ranges[joint]
        # A joint that was pushed out of its range may come back.
        here = self._target[joint]
        return max(min(low, here), min(max(high, here), rad))

    def _may_move(self, before: Sequence[float], after: Sequence[float]) -> bool:
        """Return False if the tool would enter a protection zone. It may leave one."""
        return self._is_free(after) or not self._is_free(before)
