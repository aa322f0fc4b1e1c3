"""Simulate the robot without its network: power supplies, servos, control manager and commands.

Simulated time passes only in calls of ``tick``, by the given clock. Behaviour that was never seen on a real robot
is marked [assumed].
"""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Protocol

import numpy as np

from strands_actors.drivers.common.physics.physics import Plant
from strands_actors.drivers.rby1.commands import PARTS, Finish
from strands_actors.drivers.rby1.protocol import (
    MOTOR_SUPPLY,
    Control,
    JointOrder,
    Manager,
    ManagerOrder,
    ManagerState,
    Power,
    RobotInfo,
)
from strands_actors.drivers.rby1.robots import FIRST_JOINT
from strands_actors.drivers.rby1.states import RobotState

from .base import Base
from .collisions import nearest
from .devices import BATTERY_V, Devices
from .journal import Level
from .kinematics import Kinematics
from .motions import (
    BaseMotion,
    Impossible,
    JointMotion,
    Joints,
    Motion,
    SpringMotion,
    WeightlessMotion,
    base_acceleration,
    jogged,
)
from .parts import BASE, BaseMove, CartesianMove, Jog, JointMove, LinkSpring, Optimum, Part, Weightless
from .plant import RBY1Plant
from .reaching import CartesianMotion, OptimumMotion
from .requests import Request
from .urdf import WHEELS, urdf_of

SUPPLIES = ("5v", "12v", "24v", MOTOR_SUPPLY)
ROOM_C = 30.0

BRAKING_S = 0.02
"""A servo of the twin lags its target by this time, so this is where it halts from any speed without
turning back."""

NEAR_S = 0.05
"""The distances of links are computed once in this time, because they take longer than the rest of a state."""

LONGEST_S = 0.1
"""Longest time to catch up after a stall of the twin itself. The rest of a longer one is dropped."""

UNBRAKED = (*WHEELS, "right_arm_6", "left_arm_6", "head_0", "head_1")
"""Joints without a brake, from the vendor's description of model A."""


class Owner(Protocol):
    """The client that sent a command, and receives the command's result."""

    def finished(self, reason: Finish) -> None: ...


class Controller:
    def __init__(self, table: Mapping[str, Any], now_s: Callable[[], float] = time.monotonic) -> None:
        """Build the robot from its table in ``robots.toml``."""
        joints = table["joints"]
        plant = RBY1Plant.from_table(table)
        self.plant: Plant = plant
        self.now_s = now_s
        self.base = Base()
        self.devices = Devices(urdf_of(table))
        names = tuple(joint["key"] for joint in joints)
        self._joints = Joints(
            names,
            np.array([joint["range_rad"][0] for joint in joints]),
            np.array([joint["range_rad"][1] for joint in joints]),
            np.array([joint["speed_rad_s"] for joint in joints]),
            plant,
            Kinematics(table),
            self.devices.parameters,
            self.base,
        )
        self._slices: dict[str, slice] = {}
        start = 0
        for name, count in PARTS.items():
            self._slices[name] = slice(start, start + count)
            start += count
        self.info = RobotInfo(
            "A",
            "1.2",
            (*WHEELS, *names),
            SUPPLIES,
            ("EMO",),
            (
                ("mobility", (0, 1)),
                ("body", tuple(range(FIRST_JOINT, FIRST_JOINT + 20))),
                *((name, tuple(range(part.start + 2, part.stop + 2))) for name, part in self._slices.items()),
            ),
            UNBRAKED,
        )
        self.wake_up()

    def wake_up(self) -> None:
        """Reset to the state after switch-on: the arms stay where they are, the brakes hold."""
        self.supplies = dict.fromkeys(SUPPLIES, False)
        self.servos = [False] * len(self.info.joints)
        self._released: set[int] = set()  # driven joints with brakes that a client has released
        self.manager: int = Manager.IDLE
        self.pressed = False
        # True while a client drives the joints: from an enable or a command until a cancel.
        self.driven = False
        self.simulation_moves = False  # True while a local simulation moves the robot
        self._scaled_s = self._scaled_at_s = self._ticked_s = self.now_s()
        self.time_scale = 1.0
        for motion in getattr(self, "_motions", ()):
            motion.release(self._target)
        self._motions: list[Motion] = []
        self._ended = b""  # feedback of the newest command that has ended
        self._owner: Owner | None = None
        self._priority = 0
        self._near: tuple[bytes, ...] = ()
        self._near_until_s = self._ticked_s
        self.base.halt()
        self.base.pose = (0.0, 0.0, 0.0)
        self.devices.wake_up()
        self.devices.journal.write(self.time_ns, Level.INFO, "the robot has started")
        # True until a motor is energised. Until then brakes hold the arms, too [assumed].
        self._rested = True
        self._set_brakes()
        self._halt()
        self.plant.catch_up(self._ticked_s)

    # -- observation

    @property
    def control(self) -> Control:
        return Control.EXECUTING if self._motions else Control.IDLE

    @property
    def runs(self) -> bool:
        """Whether the servos of all driven joints are on."""
        return all(self.servos[FIRST_JOINT:])

    @property
    def manager_state(self) -> ManagerState:
        enabled = tuple(range(len(self.servos))) if self.manager == Manager.ENABLED else ()
        return ManagerState(self.manager, self.control, self.time_scale, enabled)

    @property
    def time_ns(self) -> int:
        """The robot's time of day."""
        return time.time_ns() + self.devices.clock.shift_ns

    def set_time(self, time_ns: int, zone: str) -> None:
        """Set the robot's time of day. Raise ``Invalid`` for an unknown time zone."""
        self.devices.clock.set(time.time_ns(), time_ns, zone)

    def set_time_scale(self, scale: float) -> None:
        """Slow all motions down: 1.0 is the normal speed, and 0.0 a stand."""
        self._scaled_s, self._scaled_at_s = self._motion_s, self.now_s()
        self.time_scale = scale

    @property
    def _motion_s(self) -> float:
        """The time of the motions, which the time scale slows down."""
        return self._scaled_s + (self.now_s() - self._scaled_at_s) * self.time_scale

    def feedback(self) -> bytes:
        """Encode the feedback of the running command, or of the one that has ended last."""
        now_s = self._motion_s
        return b"".join(motion.feedback(now_s) for motion in self._motions) or self._ended

    def state(self) -> RobotState:
        plant, count = self.plant, len(self.servos)
        kinematics = self._joints.kinematics
        kinematics.place(plant.position_rad)
        x, y, z = kinematics.center
        still = (0.0,) * FIRST_JOINT
        wheels = tuple(self.base.wheels_rad)
        return RobotState(
            position=wheels + plant.position_rad,
            velocity=self.base.wheels_of(self.base.velocity) + plant.velocity_rad_s,
            torque=still + plant.effort_nm,
            target=wheels + tuple(self._target),
            current=(0.0,) * count,
            temperature=(ROOM_C,) * count,
            ready=tuple(self.servos),
            powers=tuple(Power.ON if on else Power.OFF for on in self.supplies.values()),
            emergency_stops=(int(self.pressed),),
            battery_pct=self.devices.battery.level_pct,
            battery_v=BATTERY_V,
            odometry=self.base.pose,
            center_of_mass=(float(x), float(y), float(z)),
            manager=self.manager_state,
            time_ns=self.time_ns,
            flanges=self.devices.encoded_flanges() if self.supplies[MOTOR_SUPPLY] else (),
            collisions=self._nearest(),
        )

    def _nearest(self) -> tuple[bytes, ...]:
        """Return the nearest pairs of links, encoded. ``state`` has set the position of the kinematics."""
        if self._ticked_s >= self._near_until_s:
            self._near_until_s = self._ticked_s + NEAR_S
            self._near = tuple(pair.encode() for pair in nearest(self._joints.kinematics))
        return self._near

    # -- events

    def press(self, pressed: bool) -> None:
        """Press or release the emergency stop button. A pressed button removes the power of the motors."""
        self.pressed = pressed
        if pressed:
            self.power(MOTOR_SUPPLY, False)

    def fail(self, fault: Manager) -> None:
        """Put the control manager into a fault, which ends any motion."""
        self._end(Finish.CONTROL_MANAGER_FAULT)
        self.driven, self.manager = False, fault
        plant = self.plant
        rows = zip(plant.position_rad, plant.velocity_rad_s, plant.effort_nm, strict=True)
        joints = dict(zip(self._joints.names, rows, strict=True))
        self.devices.journal.keep_fault(self.time_ns, fault.name, joints)
        self.devices.journal.write(self.time_ns, Level.ERROR, f"the control manager reports {fault.name}")

    # -- orders

    def power(self, names: str, on: bool) -> bool:
        """Switch the power supplies that match ``names`` on or off. Return True if that succeeded."""
        indices = _matching(names, SUPPLIES)
        if not indices or (on and self.pressed):
            return False
        for index in indices:
            self.supplies[SUPPLIES[index]] = on
        if not self.supplies[MOTOR_SUPPLY]:
            self._released.clear()
            self.devices.flanges_off()
            self._servos_off(range(len(self.servos)))
        return True

    def servo(self, names: str, order: int) -> bool:
        """Switch the servos that match ``names`` on, or engage or release their brakes. Return True if that
        succeeded."""
        indices = _matching(names, self.info.joints)
        match order:
            case JointOrder.SERVO_ON if indices and self.supplies[MOTOR_SUPPLY]:
                if not self.runs:
                    self._halt()
                for index in indices:
                    self.servos[index] = True
                self._rested = False
                self._set_brakes()
            case JointOrder.BRAKE_ENGAGE if indices:
                self._released -= {index - FIRST_JOINT for index in indices}
                self._servos_off(indices)
            case JointOrder.BRAKE_RELEASE if indices and self._may_release(indices):
                self._released |= {index - FIRST_JOINT for index in indices}
                self._servos_off(indices)
            case _:
                return False
        return True

    def _may_release(self, indices: Sequence[int]) -> bool:
        """Return True if all these joints have a brake and power, and nothing controls them [assumed]."""
        braked = all(self.info.joints[index] not in UNBRAKED for index in indices)
        return braked and self.supplies[MOTOR_SUPPLY] and self.manager != Manager.ENABLED

    def servo_off(self, names: str) -> bool:
        indices = _matching(names, self.info.joints)
        if indices:
            self._servos_off(indices)
        return bool(indices)

    def set_gains(self, name: str, gains: tuple[int | None, int | None, int | None]) -> bool:
        """Set position gains of a joint. Return True if that succeeded. The robot refuses it
        while the control manager is enabled, and without power."""
        if name not in self._joints.names or self.manager == Manager.ENABLED or not self.supplies[MOTOR_SUPPLY]:
            return False
        p_share, d_share = self.devices.set_gains(name, gains)
        self._joints.plant.set_gains(self._joints.names.index(name), p_share, d_share)
        return True

    def order_manager(self, order: int) -> None:
        match order:
            case ManagerOrder.ENABLE if self.manager == Manager.IDLE and any(self.servos):
                self._halt()
                self._drive()
                self.manager = Manager.ENABLED
            case ManagerOrder.DISABLE if self.manager == Manager.ENABLED:
                self._end(Finish.CONTROL_MANAGER_IDLE)
                self.driven, self.manager = False, Manager.IDLE
            case ManagerOrder.RESET_FAULT if self.manager in (Manager.MINOR_FAULT, Manager.MAJOR_FAULT):
                self.manager = Manager.IDLE

    def cancel(self) -> None:
        self._end(Finish.CANCELED)
        self.driven = False

    def command(self, owner: Owner, request: Request) -> Finish | None:
        """Start a command. It replaces a running command of the same or a lower priority [assumed].

        Returns:
            Why the command has already ended; None if it runs.
        """
        self.tick()
        if self.manager != Manager.ENABLED or not self.runs:
            faulty = self.manager in (Manager.MINOR_FAULT, Manager.MAJOR_FAULT)
            return Finish.CONTROL_MANAGER_FAULT if faulty else Finish.CONTROL_MANAGER_IDLE
        if request.others:
            return Finish.INITIALIZED_FAILED
        if request.stops:
            self._end(Finish.CANCELED)
            return Finish.OK
        try:
            motions = [self._begun(part) for part in request.parts.values()]
        except Impossible:
            return Finish.INITIALIZED_FAILED
        joints = [joint for motion in motions for joint in motion.joints]
        if not motions or len(set(joints)) != len(joints):
            return Finish.INITIALIZED_FAILED
        if self._motions and self._owner is not owner:
            if request.priority < self._priority:
                return Finish.PREEMPTED
            self._end(Finish.PREEMPTED)
        self._drive()
        self._owner, self._priority = owner, request.priority
        self._motions = [motion for motion in self._motions if set(motion.joints).isdisjoint(joints)]
        for motion in motions:
            motion.start(self._target)
        self._motions += motions
        return None

    def leave(self, owner: Owner) -> None:
        """End the command of a client after the end of its stream."""
        if self._owner is owner:
            self._owner = None
            self._end(Finish.CANCELED)

    def _begun(self, part: Part) -> Motion:
        """Return the motion of a command. Raise ``Impossible``."""
        now_s, world = self._motion_s, self._joints
        target = self._target
        if getattr(part, "spring", None) is None:
            # A spring need not be where it should be.
            here = self.plant.position_rad
            target = [
                here[joint] if world.plant.is_spring(joint) else rad for joint, rad in enumerate(self._target)
            ]
        match part:
            case Jog():
                return JointMotion(jogged(part, target, world), now_s, target, world)
            case JointMove():
                return JointMotion(part, now_s, target, world)
            case CartesianMove():
                return CartesianMotion(part, now_s, target, world)
            case Optimum():
                return OptimumMotion(part, now_s, target, world)
            case LinkSpring():
                return SpringMotion(part, now_s, world)
            case Weightless():
                return WeightlessMotion(part, now_s, world)
            case BaseMove() if all(self.servos[:FIRST_JOINT]):
                return BaseMotion(part, now_s, world)
        raise Impossible("a command of another kind")

    # -- the joints

    def set_targets(self, goal: Sequence[float]) -> None:
        """Set the joints' target for a local simulation, which acts in the place of a client."""
        self._target = list(goal)

    def hold(self) -> None:
        self._halt()

    def let_simulation_move(self, on: bool) -> None:
        """Let a local simulation move the robot, or end that."""
        self.simulation_moves = on
        self._rested = not on and not any(self.servos)
        self._halt()
        self._set_brakes()

    def _drive(self) -> None:
        """Let the client command the joints from now on, beginning at their present positions."""
        if self.simulation_moves:
            self._halt()
        self.driven, self.simulation_moves = True, False

    def _end(self, reason: Finish) -> None:
        """End any motion. The robot holds its position."""
        owner, self._owner = self._owner, None
        if self._motions:
            self._finish(owner, reason)
            self._halt()

    def _finish(self, owner: Owner | None, reason: Finish) -> None:
        self._ended = self.feedback()
        for motion in self._motions:
            motion.release(self._target)
        self._motions = []
        if owner is not None:
            owner.finished(reason)

    def _halt(self) -> None:
        columns = zip(self.plant.position_rad, self.plant.velocity_rad_s, strict=True)
        self._target = [rad + rad_s * BRAKING_S for rad, rad_s in columns]

    def _servos_off(self, joints: Sequence[int]) -> None:
        for joint in joints:
            self.servos[joint] = False
        if not all(self.servos[:FIRST_JOINT]):
            self.base.halt()
        if not self.runs and self.manager == Manager.ENABLED:
            self._end(Finish.UNEXPECTED_STATE)
            self.driven, self.manager = False, Manager.IDLE
        self._set_brakes()

    def _set_brakes(self) -> None:
        """Set the brakes and torques of all joints. The torso has brakes. Without power, arms and
        head drop if they were energised before [assumed]."""
        torso = self._slices["torso"].stop
        for joint in range(len(self.plant.joints)):
            on = self.simulation_moves or self.servos[FIRST_JOINT + joint]
            braked = joint not in self._released and (joint < torso or self._rested)
            self.plant.set_stuck(joint, not on and braked)
            self.plant.set_torque(joint, on)

    # -- time

    def tick(self) -> None:
        now_s = self.now_s()
        elapsed_s, self._ticked_s = min(now_s - self._ticked_s, LONGEST_S), now_s
        self.advance(elapsed_s)
        self.plant.catch_up(now_s)

    def advance(self, elapsed_s: float) -> None:
        """Set the joints' targets for the present time, and end commands after their hold
        time."""
        now_s = self._motion_s
        scaled_s = elapsed_s * self.time_scale
        for motion in self._motions:
            motion.advance(now_s, scaled_s, self._target)
        if not any(BASE[0] in motion.joints for motion in self._motions):
            self.base.slow_down(elapsed_s, base_acceleration(self.devices.parameters))
        self.base.advance(scaled_s)
        if any(motion.failed for motion in self._motions):
            self._end(Finish.UNEXPECTED_STATE)
        elif self._motions and all(motion.has_ended(now_s) for motion in self._motions):
            owner, self._owner = self._owner, None
            self._finish(owner, Finish.OK)
        for joint, rad in enumerate(self._target):
            self.plant.set_target(joint, rad)
        torques: dict[int, float] = {}
        for motion in self._motions:
            torques |= motion.torques
        self._joints.plant.apply(torques)


def _matching(pattern: str, names: Sequence[str]) -> list[int]:
    """Return the indices of the names that a regular expression matches completely. An expression that is invalid
    or too long matches no name."""
    if len(pattern) > 64:
        return []
    try:
        return [index for index, name in enumerate(names) if re.fullmatch(pattern, name)]
    except re.error:
        return []
