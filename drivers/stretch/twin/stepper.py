"""Simulate one stepper board: the modes of its firmware, and the motor that follows.

The simulation knows where a motor really is. The board knows only its encoder, which counts from a zero that is
set by homing. After a restart the encoder knows its angle within one turn, and the board reports that the joint is
not homed. Goals then lead elsewhere, and the motor may push against an end of its travel.
"""

from __future__ import annotations

import math

from strands_actors.drivers.common.physics.body import Commander
from strands_actors.drivers.stretch import protocol as p

from .calls import STEPPER_MODES, WRITE_GAINS_TO_FLASH
from .effort import MOVES_RAD_S, TICKS_PER_A, Effort
from .trajectory import Segment, Trajectory

PROTOCOL = 5
FIRMWARE = "Stepper.v0.7.2p5"
VARIANT = "Stepper.3"

BRAKE_RAD_S2 = 400.0
"""Deceleration of a motor that is stopped at once, and acceleration without a profile [assumed]."""
ROLL_RAD_S2 = 30.0
"""Deceleration of a free motor [assumed]."""
FULL_RAD_S = 25.0
"""Speed of a motor without a speed in its command [assumed]."""
ANYWHERE = (-math.inf, math.inf)
_POSITION_MODES = (p.Mode.POSITION, p.Mode.POSITION_PROFILE, p.Mode.STEP_PROFILE)
_NEAR_DEG = p.GAINS_ORDER.index("pos_near_setpoint_d")


class StepperMotor:
    """One stepper board and its motor, with positions in motor radians.

    Args:
        name: Name of the joint or wheel.
        number: Unit number of the board.
        gains: The gains in flash memory.
        position: Where the motor is at the start.
        watchdog_s: If the gains switch the watchdog on, a velocity that is not repeated within this time leads to
            the safety mode.
        stops: The mechanical ends of the travel.
        load_a: Current that carries the load of the joint, A.
    """

    def __init__(
        self,
        name: str,
        number: int,
        gains: p.Gains,
        position: float,
        watchdog_s: float,
        stops: tuple[float, float] = ANYWHERE,
        load_a: float = 0.0,
    ) -> None:
        self.name = name
        self.number = number
        self.flash = gains
        self.position = position
        """Where the motor is. The board reports its distance from ``zero``."""
        self.zero = 0.0
        self.watchdog_s = watchdog_s
        self.stops = stops
        self.effort = Effort(load_a)
        self.stuck = False
        self.is_stopped = False  # True while the runstop is on
        self.wall: float | None = None  # position of an obstacle above
        self.power_cycle()
        self.home()

    def power_cycle(self) -> None:
        """Restart the board. Only the values in flash memory stay, and the motor has no torque."""
        self.gains = self.flash
        self.command = p.Command(p.Mode.SAFETY)
        self.waiting: p.Command | None = None
        self.limits: tuple[float, float] | None = None
        self.velocity = 0.0
        self.time_s = 0.0
        self.is_dirty = False
        """True if it got a setpoint since the last stop."""
        self.commander = Commander.NONE
        self.effort.reset()
        self.trajectory = Trajectory()
        self._commanded_s = 0.0
        self._steps = 0
        self.contacts = 0
        self._is_in_contact = False
        self.forget_home()

    def home(self) -> None:
        """Set the zero of the encoder as a homing routine does."""
        self._mark(self.position)
        self.homed = True

    def forget_home(self) -> None:
        """Lose the count of the encoder's turns, as in a restart. The angle within a turn stays. An encoder with
        reversed polarity counts it downwards."""
        turned = -(-self.position % math.tau) if self.has(p.Config.FLIP_ENCODER) else self.position % math.tau
        self._mark(turned)
        self.homed = False

    def _mark(self, reported: float) -> None:
        """Set the zero so that the board reports this position. The motor stays where it is."""
        self.zero = self.position - reported
        self._goal = self.position

    def has(self, bit: p.Config) -> bool:
        return bool(self.gains.config & bit)

    @property
    def mode(self) -> int:
        return p.Mode.SAFETY if self.is_stopped else self.command.mode

    # -- commands

    def take(self, command: p.Command) -> None:
        """Store a command, and carry it out at once or at the next sync pulse of the power board. The safety mode
        never waits for a pulse."""
        if command.mode not in STEPPER_MODES:
            return
        self.is_dirty = command.kind == "setpoint" and not self.is_stopped
        if self.has(p.Config.SYNC) and command.mode != p.Mode.SAFETY:
            self.waiting = command
        else:
            self.waiting = None
            self._begin(command)

    def sync(self) -> None:
        if self.waiting is not None:
            command, self.waiting = self.waiting, None
            self._begin(command)
            self.trajectory.waits = False

    def _begin(self, command: p.Command) -> None:
        if self.is_stopped:
            # While the runstop is on, the board ignores commands.
            return
        self._commanded_s = self.time_s
        self._is_in_contact = False
        if command.mode == p.Mode.STEP_PROFILE:
            if command.step != self._steps:
                self._goal = self._within(self.position + command.position, command.mode)
        elif command.mode in _POSITION_MODES:
            self._goal = self._within(self.zero + command.position, command.mode)
        elif command.mode != self.command.mode:
            self._goal = self.position
        self._steps = command.step
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
        self.command = self.command._replace(mode=p.Mode.SAFETY)
        self._goal = self.position
        self.commander = Commander.WIRE if self._safety_holds else Commander.NONE

    def trigger(self, bits: int, value: float) -> None:
        if bits & p.RESET_HOMED:
            self.homed = False
        if bits & p.SET_HOMED:
            self.homed = True
        if bits & p.MARK_POSITION:
            self._mark(value)
        if bits & WRITE_GAINS_TO_FLASH:
            self.flash = self.gains
        if bits & p.BOARD_RESET:
            self.power_cycle()

    def start_trajectory(self, segment: Segment | None) -> bool:
        """Begin a trajectory, in sync mode at the next pulse. Return False if the board refuses it."""
        return self.trajectory.start(segment, waits=self.has(p.Config.SYNC))

    def _within(self, goal: float, mode: int) -> float:
        """Return a goal within the limits of motion. Two modes use them for a motor that is not homed, too."""
        always = mode in (p.Mode.POSITION_PROFILE, p.Mode.WAYPOINTS)
        if self.limits is None or not (self.homed or always):
            return goal
        low, high = self.limits
        return min(max(goal, self.zero + low), self.zero + high)

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
        self.trajectory.step(step_s)
        goal, change = self._goal_velocity(step_s)
        before = self.velocity
        self.velocity += max(-change * step_s, min(change * step_s, goal - before))
        self.position += (before + self.velocity) / 2 * step_s
        self._feel(step_s)

    def _feel(self, step_s: float) -> None:
        """Stop the motor at the ends of its travel and at an obstacle, and compute its current. If the current
        exceeds a threshold of the command, a guarded board enters the safety mode until the next command."""
        low, high = self.stops
        high = high if self.wall is None else min(high, self.wall)
        blocked = (self.position > high) - (self.position < low)
        if blocked:
            self.position, self.velocity = min(max(self.position, low), high), 0.0
        if self.commander is Commander.NONE:
            self.effort.coast(step_s, self.gains)
        else:
            self.effort.step(step_s, self.gains, self.velocity, blocked, self._falls_behind)
        self._guard(step_s)

    @property
    def _falls_behind(self) -> float:
        """Return how fast a blocked motor falls behind its command, rad/s."""
        has_profile = self.mode not in (p.Mode.POSITION, p.Mode.VELOCITY)
        return abs(self.command.velocity) or FULL_RAD_S if has_profile else math.inf

    def _guard(self, step_s: float) -> None:
        """Count each millisecond in which the effort is past a threshold of the last command. The first one ends a
        motion. The board does so to no motor that a local simulation moves."""
        if not self.has(p.Config.GUARDED) or self.commander is Commander.SIM:
            self.contacts, self._is_in_contact = 0, False
            return
        low_a, high_a = -abs(self.command.contact_neg_a), abs(self.command.contact_pos_a)
        if low_a <= self.effort.filtered_a <= high_a:
            return
        self.contacts += max(1, round(step_s * 1e3))
        if self.mode not in p.AT_REST:
            self._is_in_contact = True
            self.trajectory.reset()
            self._fall_safe()

    @property
    def _is_overdue(self) -> bool:
        runs = self.mode in (p.Mode.VELOCITY, p.Mode.VELOCITY_PROFILE) and self.has(p.Config.VELOCITY_WATCHDOG)
        return runs and self.time_s - self._commanded_s > self.watchdog_s

    def _goal_velocity(self, step_s: float) -> tuple[float, float]:
        """Return the velocity that the motor has to reach, and the acceleration for that."""
        command = self.command
        match self.mode:
            case p.Mode.WAYPOINTS if self.trajectory.is_active:
                goal = self._within(self.zero + self.trajectory.goal, command.mode)
                fastest = abs(command.velocity) or FULL_RAD_S
                return max(-fastest, min(fastest, (goal - self.position) / step_s)), math.inf
            case p.Mode.WAYPOINTS:
                return 0.0, BRAKE_RAD_S2
            case p.Mode.VELOCITY | p.Mode.VELOCITY_PROFILE:
                has_profile = command.mode == p.Mode.VELOCITY_PROFILE
                return command.velocity, command.acceleration or BRAKE_RAD_S2 if has_profile else BRAKE_RAD_S2
            case p.Mode.POSITION_PROFILE | p.Mode.STEP_PROFILE | p.Mode.POSITION:
                gain = command.acceleration or BRAKE_RAD_S2
                self._goal = self._within(self._goal, self.mode)  # The limits may have become narrower.
                return self._towards(abs(command.velocity) or FULL_RAD_S, gain), max(gain, BRAKE_RAD_S2)
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
        runs = self.mode in _POSITION_MODES
        holds = self.mode == p.Mode.HOLD or (self.mode == p.Mode.SAFETY and self._safety_holds)
        off = abs(self._goal - self.position)
        bits = {
            p.Diag.HOMED: self.homed,
            p.Diag.RUNSTOP: self.is_stopped,
            p.Diag.NEAR_POSITION: (runs or holds) and off < math.radians(self.gains.values[_NEAR_DEG]),
            p.Diag.MOVING: abs(self.velocity) > MOVES_RAD_S,
            p.Diag.CURRENT_LIMIT: self.effort.is_at_limit,
            p.Diag.PROFILE_MOVING: runs and abs(self.velocity) > MOVES_RAD_S,
            p.Diag.CALIBRATED: True,
            p.Diag.CONTACT: self._is_in_contact,
            p.Diag.SAFETY_EVENT: self.is_stopped,
            p.Diag.TRAJECTORY_ACTIVE: self.trajectory.is_active,
            p.Diag.TRAJECTORY_WAITS: self.trajectory.waits,
            p.Diag.WAITS_FOR_SYNC: self.waiting is not None or self.trajectory.waits,
            p.Diag.IN_SYNC_MODE: self.has(p.Config.SYNC),
        }
        return p.StepperStatus(
            mode=self.mode,
            effort=self.effort.filtered_a * TICKS_PER_A,
            position=self.position - self.zero,
            velocity=self.velocity,
            error=self._goal - self.position if runs else 0.0,
            diag=int(sum(bit for bit, is_set in bits.items() if is_set)),
            timestamp_us=round(self.time_s * 1e6),
            debug=0.0,
            contacts=self.contacts,
            trajectory=self.trajectory.goal,
            waypoint=self.trajectory.number,
            voltage=630.0,  # raw value for 12 V
        )
