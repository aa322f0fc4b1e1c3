"""Simulate the robot without its network: power supplies, servos, control manager and commands.

Simulated time passes only in calls of ``tick``, by the given clock. Behaviour that was never seen on a real robot
is marked [assumed].
"""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Protocol

import msgspec

from strands_actors.drivers.common.physics.physics import Plant
from strands_actors.drivers.rby1.commands import PARTS, Command, Finish, JointPosition
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

from .urdf import WHEELS, urdf_of

SUPPLIES = ("5v", "12v", "24v", MOTOR_SUPPLY)
ROOM_C, BATTERY_PCT, BATTERY_V = 30.0, 80.0, 50.0

BRAKING_S = 0.02
"""A servo of the twin lags its target by this time, so this is where it halts from any speed without
turning back."""

LONGEST_S = 0.1
"""Longest time to catch up after a stall of the twin itself. The rest of a longer one is dropped."""

_ROUNDING = 1e-6


class Owner(Protocol):
    """The client that sent a command, and receives the command's result."""

    def finished(self, reason: Finish) -> None: ...


class Motion(msgspec.Struct, frozen=True):
    """The planned motion of one body part."""

    begin: tuple[float, ...]
    goal: tuple[float, ...]
    begin_s: float
    arrive_s: float
    until_s: float  # end of the hold time, at which the command ends

    def target_at(self, now_s: float) -> list[float]:
        span_s = self.arrive_s - self.begin_s
        share = 1.0 if span_s <= 0.0 else min(1.0, (now_s - self.begin_s) / span_s)
        return [
            start_rad + share * (goal_rad - start_rad)
            for start_rad, goal_rad in zip(self.begin, self.goal, strict=True)
        ]


class Controller:
    def __init__(self, table: Mapping[str, Any], now_s: Callable[[], float] = time.monotonic) -> None:
        """Build the robot from its table in ``robots.toml``."""
        joints = table["joints"]
        self.plant = Plant.from_table(table)
        self.now_s = now_s
        self.urdf = urdf_of(table)
        self._ranges: list[tuple[float, float]] = [tuple(joint["range_rad"]) for joint in joints]
        self._speeds: list[float] = [joint["speed_rad_s"] for joint in joints]
        self._slices: dict[str, slice] = {}
        start = 0
        for name, count in PARTS.items():
            self._slices[name] = slice(start, start + count)
            start += count
        self.info = RobotInfo(
            "A",
            "1.2",
            (*WHEELS, *(joint["key"] for joint in joints)),
            SUPPLIES,
            ("EMO",),
            (
                ("mobility", (0, 1)),
                ("body", tuple(range(FIRST_JOINT, FIRST_JOINT + 20))),
                *((name, tuple(range(part.start + 2, part.stop + 2))) for name, part in self._slices.items()),
            ),
        )
        self.wake_up()

    def wake_up(self) -> None:
        """Reset to the state after switch-on: the arms stay where they are, the brakes hold."""
        self.supplies = dict.fromkeys(SUPPLIES, False)
        self.servos = [False] * len(self.info.joints)
        self.manager: int = Manager.IDLE
        self.pressed = False
        # True while a client drives the joints: from an enable or a command until a cancel.
        self.driven = False
        self.simulation_moves = False  # True while a local simulation moves the robot
        self.time_scale = 1.0
        self._motions: dict[str, Motion] = {}
        self._owner: Owner | None = None
        self._priority = 0
        # True until a motor is energised. Until then brakes hold the arms, too [assumed].
        self._rested = True
        self._ticked_s = self.now_s()
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

    def state(self) -> RobotState:
        plant, count = self.plant, len(self.servos)
        wheels = (0.0,) * FIRST_JOINT
        return RobotState(
            position=wheels + plant.position_rad,
            velocity=wheels + plant.velocity_rad_s,
            torque=wheels + plant.effort_nm,
            target=wheels + tuple(self._target),
            current=(0.0,) * count,
            temperature=(ROOM_C,) * count,
            ready=tuple(self.servos),
            powers=tuple(Power.ON if on else Power.OFF for on in self.supplies.values()),
            emergency_stops=(int(self.pressed),),
            battery_pct=BATTERY_PCT,
            battery_v=BATTERY_V,
            manager=self.manager_state,
            time_ns=time.time_ns(),
        )

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

    # -- orders

    def power(self, names: str, on: bool) -> bool:
        """Switch the power supplies that match ``names`` on or off. Return True if that succeeded."""
        indices = _matching(names, SUPPLIES)
        if not indices or (on and self.pressed):
            return False
        for index in indices:
            self.supplies[SUPPLIES[index]] = on
        if not self.supplies[MOTOR_SUPPLY]:
            self._servos_off(range(len(self.servos)))
        return True

    def servo(self, names: str, order: int) -> bool:
        """Switch the servos that match ``names`` on or off. Return True if that succeeded."""
        indices = _matching(names, self.info.joints)
        if not indices or order not in (JointOrder.SERVO_ON, JointOrder.BRAKE_ENGAGE):
            return False
        if order == JointOrder.SERVO_ON:
            if not self.supplies[MOTOR_SUPPLY]:
                return False
            if not self.runs:
                self._halt()
            for index in indices:
                self.servos[index] = True
            self._rested = False
            self._set_brakes()
        else:
            self._servos_off(indices)
        return True

    def servo_off(self, names: str) -> bool:
        indices = _matching(names, self.info.joints)
        if indices:
            self._servos_off(indices)
        return bool(indices)

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

    def command(self, owner: Owner, command: Command) -> Finish | None:
        """Start a command. It replaces a running command of the same or a lower priority [assumed].

        Returns:
            Why the command has already ended; None if it runs.
        """
        self.tick()
        if self.manager != Manager.ENABLED:
            faulty = self.manager in (Manager.MINOR_FAULT, Manager.MAJOR_FAULT)
            return Finish.CONTROL_MANAGER_FAULT if faulty else Finish.CONTROL_MANAGER_IDLE
        if command.has_others:
            return Finish.INITIALIZED_FAILED
        if command.stops:
            self._end(Finish.CANCELED)
            return Finish.OK
        if not command.parts or not all(self._within(name, part) for name, part in command.parts.items()):
            return Finish.INITIALIZED_FAILED
        if self._motions and self._owner is not owner:
            if command.priority < self._priority:
                return Finish.PREEMPTED
            self._end(Finish.PREEMPTED)
        self._drive()
        self._owner, self._priority = owner, command.priority
        for name, part in command.parts.items():
            self._motions[name] = self._motion(name, part)
        return None

    def leave(self, owner: Owner) -> None:
        """End the command of a client whose stream has ended."""
        if self._owner is owner:
            self._owner = None
            self._end(Finish.CANCELED)

    def _within(self, name: str, part: JointPosition) -> bool:
        rows = zip(part.position, self._ranges[self._slices[name]], strict=True)
        return all(low - _ROUNDING <= rad <= high + _ROUNDING for rad, (low, high) in rows)

    def _motion(self, name: str, part: JointPosition) -> Motion:
        """Plan a motion in the commanded time, but no faster than the joints can turn."""
        now_s, joints = self.now_s(), self._slices[name]
        begin = tuple(self._target[joints])
        rows = zip(begin, part.position, self._speeds[joints], strict=True)
        needed_s = max(abs(goal_rad - start_rad) / speed for start_rad, goal_rad, speed in rows)
        arrive_s = now_s + max(part.minimum_s, needed_s)
        return Motion(begin, part.position, now_s, arrive_s, arrive_s + part.hold_s)

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
            self._motions.clear()
            self._halt()
            if owner is not None:
                owner.finished(reason)

    def _halt(self) -> None:
        columns = zip(self.plant.position_rad, self.plant.velocity_rad_s, strict=True)
        self._target = [rad + rad_s * BRAKING_S for rad, rad_s in columns]

    def _servos_off(self, joints: Sequence[int]) -> None:
        for joint in joints:
            self.servos[joint] = False
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
            self.plant.set_stuck(joint, not on and (joint < torso or self._rested))
            self.plant.set_torque(joint, on)

    # -- time

    def tick(self) -> None:
        now_s = self.now_s()
        elapsed_s, self._ticked_s = min(now_s - self._ticked_s, LONGEST_S), now_s
        self.advance(elapsed_s)
        self.plant.catch_up(now_s)

    def advance(self, elapsed_s: float) -> None:
        """Set the joints' targets for the present time, and end commands whose hold time has
        passed."""
        now_s = self.now_s()
        for name, motion in self._motions.items():
            self._target[self._slices[name]] = motion.target_at(now_s)
        if self._motions and all(now_s >= motion.until_s for motion in self._motions.values()):
            owner, self._owner = self._owner, None
            self._motions.clear()
            if owner is not None:
                owner.finished(Finish.OK)
        for joint, rad in enumerate(self._target):
            self.plant.set_target(joint, rad)


def _matching(pattern: str, names: Sequence[str]) -> list[int]:
    """Return the indices of the names that a regular expression matches completely. An expression that is invalid
    or too long matches no name."""
    if len(pattern) > 64:
        return []
    try:
        return [index for index, name in enumerate(names) if re.fullmatch(pattern, name)]
    except re.error:
        return []
