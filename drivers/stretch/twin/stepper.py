"""Simulate one stepper board: the modes of its firmware, and the motor that follows."""

from __future__ import annotations

import math

from strands_actors.drivers.common.physics.body import Commander
from strands_actors.drivers.stretch import protocol as p

from .calls import STEPPER_MODES, WRITE_GAINS_TO_FLASH

PROTOCOL = 5
FIRMWARE = "Stepper.v0.7.2p5"
VARIANT = "Stepper.3"

BRAKE_RAD_S2 = 400.0
"""Deceleration of a motor that is stopped at once, and acceleration without a profile [assumed]."""
ROLL_RAD_S2 = 30.0
"""Deceleration of a free motor [assumed]."""
CONTACT_S = 0.05
"""How long a guarded motor pushes before its firmware reports a contact."""
NEAR_RAD = 0.02
MOVES_RAD_S = 0.05


class StepperMotor:
    """One stepper board and its motor, with positions in motor radians. If its gains switch the watchdog on, a
    velocity that is not repeated within ``watchdog_s`` leads to the safety mode."""

    def __init__(self, name: str, number: int, gains: p.Gains, position: float, watchdog_s: float) -> None:
        self.name = name
        self.number = number
        self.flash = gains
        self.position = position
        self.watchdog_s = watchdog_s
        self.homed = True
        self.stuck = False
        self.is_stopped = False  # True while the runstop is on
        self.wall: float | None = None  # position of an obstacle
        self.power_cycle()
        self.homed = True

    def power_cycle(self) -> None:
        """Restart the board. Only the values in flash memory stay, and the motor has no torque."""
        self.gains = self.flash
        self.command = p.Command(p.Mode.SAFETY)
        self.waiting: p.Command | None = None
        self.limits: tuple[float, float] | None = None
        self.velocity = 0.0
        self.time_s = 0.0
        self.homed = False
        self.is_dirty = False
        """True if it got a setpoint since the last stop."""
        self.commander = Commander.NONE
        self._goal = self.position
        self._commanded_s = 0.0
        self._steps = 0
        self.contacts = 0
        self._is_in_contact = False
        self._pushed_s = 0.0

    def has(self, bit: p.Config) -> bool:
        return bool(self.gains.config & bit)

    @property
    def mode(self) -> int:
        return p.Mode.SAFETY if self.is_stopped else self.command.mode

    # -- commands

    def take(self, command: p.Command) -> None:
        """Store a command, and carry it out at once or at the next sync pulse of the power board."""
        if command.mode not in STEPPER_MODES:
            return
        self.is_dirty = command.kind == "setpoint" and not self.is_stopped
        if self.has(p.Config.SYNC):
            self.waiting = command
        else:
            self._begin(command)

    def sync(self) -> None:
        if self.waiting is not None:
            command, self.waiting = self.waiting, None
            self._begin(command)

    def _begin(self, command: p.Command) -> None:
        if self.is_stopped:
            # While the runstop is on, the board ignores commands.
            return
        self._commanded_s = self.time_s
        self._is_in_contact = False
        if command.mode == p.Mode.STEP_PROFILE:
            if command.step != self._steps:
                self._goal = self._within(self.position + command.position)
            self._steps = command.step
        elif command.mode in (p.Mode.POSITION, p.Mode.POSITION_PROFILE):
            self._goal = self._within(command.position)
        elif command.mode != self.command.mode:
            self._goal = self.position
        self.command = command
        is_free = command.mode == p.Mode.FREEWHEEL or (command.mode == p.Mode.SAFETY and not self._safety_holds)
        self.commander = Commander.NONE if is_free else Commander.WIRE

    def runstop(self, on: bool) -> None:
        if on == self.is_stopped or not self.has(p.Config.RUNSTOP):
            return
        self.is_stopped = on
        self.is_dirty = False
        self.waiting = None
        self._fall_safe()

    def _fall_safe(self) -> None:
        """Enter the safety mode until the next command. The gains decide whether the motor holds or has no
        torque."""
        self.command = p.Command(p.Mode.SAFETY)
        self._goal = self.position
        self.commander = Commander.WIRE if self._safety_holds else Commander.NONE

    def trigger(self, bits: int, value: float) -> None:
        if bits & p.RESET_HOMED:
            self.homed = False
        if bits & p.SET_HOMED:
            self.homed = True
        if bits & p.MARK_POSITION:
            self.position = self._goal = value
        if bits & WRITE_GAINS_TO_FLASH:
            self.flash = self.gains
        if bits & p.BOARD_RESET:
            self.power_cycle()

    def _within(self, goal: float) -> float:
        if self.limits is None or not self.homed:
            return goal
        low, high = self.limits
        return min(max(goal, low), high)

    @property
    def _safety_holds(self) -> bool:
        return self.has(p.Config.SAFETY_HOLD)

    # -- the simulation

    def aim(self, position: float, velocity: float, acceleration: float) -> None:
        self._goal = position
        self.command = p.Command(p.Mode.POSITION_PROFILE, position, velocity, acceleration)
        self.commander = Commander.SIM

    def spin(self, velocity: float, acceleration: float) -> None:
        self.command = p.Command(p.Mode.VELOCITY_PROFILE, 0.0, velocity, acceleration)
        # The firmware's watchdog does not apply to a local simulation.
        self._commanded_s = math.inf
        self.commander = Commander.SIM

    def release(self) -> None:
        self.command = p.Command(p.Mode.SAFETY)
        self._goal = self.position
        self.commander = Commander.NONE

    # -- time

    def step(self, step_s: float) -> None:
        self.time_s += step_s
        if self.stuck:
            self.velocity = 0.0
            return
        if self._is_overdue:
            self._fall_safe()
        goal, change = self._goal_velocity()
        before = self.velocity
        self.velocity += max(-change * step_s, min(change * step_s, goal - before))
        self.position += (before + self.velocity) / 2 * step_s
        self._feel(step_s)

    def _feel(self, step_s: float) -> None:
        """Stop the motor at the obstacle. In a guarded motion it enters the safety mode after a short push,
        until the next command."""
        if self.wall is None or self.position <= self.wall:
            self._pushed_s = 0.0
            return
        self.position, self.velocity = self.wall, 0.0
        self._pushed_s += step_s
        if self._pushed_s > CONTACT_S and self.has(p.Config.GUARDED) and self.mode not in p.AT_REST:
            self.contacts += 1
            self._is_in_contact = True
            self._fall_safe()

    @property
    def _is_overdue(self) -> bool:
        runs = self.mode in (p.Mode.VELOCITY, p.Mode.VELOCITY_PROFILE) and self.has(p.Config.VELOCITY_WATCHDOG)
        return runs and self.time_s - self._commanded_s > self.watchdog_s

    def _goal_velocity(self) -> tuple[float, float]:
        """Return the velocity that the motor has to reach, and the acceleration for that."""
        command = self.command
        match self.mode:
            case p.Mode.VELOCITY | p.Mode.VELOCITY_PROFILE:
                has_profile = command.mode == p.Mode.VELOCITY_PROFILE
                return command.velocity, command.acceleration or BRAKE_RAD_S2 if has_profile else BRAKE_RAD_S2
            case p.Mode.POSITION_PROFILE | p.Mode.STEP_PROFILE | p.Mode.POSITION:
                gain = command.acceleration or BRAKE_RAD_S2
                self._goal = self._within(self._goal)  # The limits may have become narrower.
                return self._towards(abs(command.velocity) or 25.0, gain), max(gain, BRAKE_RAD_S2)
            case p.Mode.HOLD:
                return 0.0, BRAKE_RAD_S2
            case p.Mode.SAFETY if self._safety_holds:
                return 0.0, BRAKE_RAD_S2
        return 0.0, ROLL_RAD_S2

    def _towards(self, fastest: float, slowing: float) -> float:
        distance = self._goal - self.position
        if abs(distance) < 1e-4:
            return 0.0
        # Limit the speed so that the motor can still stop at the goal, and does not pass it in one step of the
        # simulation.
        speed = min(fastest, math.sqrt(2 * slowing * abs(distance)), abs(distance) / 0.01)
        return math.copysign(speed, distance)

    # -- reports

    def status(self) -> p.StepperStatus:
        runs = self.mode in (p.Mode.POSITION, p.Mode.POSITION_PROFILE, p.Mode.STEP_PROFILE)
        bits = {
            p.Diag.HOMED: self.homed,
            p.Diag.RUNSTOP: self.is_stopped,
            p.Diag.NEAR_POSITION: runs and abs(self._goal - self.position) < NEAR_RAD,
            p.Diag.MOVING: abs(self.velocity) > MOVES_RAD_S,
            p.Diag.PROFILE_MOVING: runs and abs(self.velocity) > MOVES_RAD_S,
            p.Diag.CALIBRATED: True,
            p.Diag.CONTACT: self._is_in_contact,
            p.Diag.SAFETY_EVENT: self.is_stopped,
            p.Diag.WAITS_FOR_SYNC: self.waiting is not None,
            p.Diag.IN_SYNC_MODE: self.has(p.Config.SYNC),
        }
        return p.StepperStatus(
            mode=self.mode,
            effort=0.0,
            position=self.position,
            velocity=self.velocity,
            error=self._goal - self.position if runs else 0.0,
            diag=int(sum(bit for bit, is_set in bits.items() if is_set)),
            timestamp_us=round(self.time_s * 1e6),
            debug=0.0,
            contacts=self.contacts,
            trajectory=0.0,
            waypoint=0,
            voltage=630.0,  # raw value for 12 V
        )
