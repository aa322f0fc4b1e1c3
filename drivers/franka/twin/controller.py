"""Simulate a Franka controller: robot mode, running motion, checks of each command, and the arm. No sockets.

Time passes in ticks of a millisecond, one per call of ``tick``.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Sequence

import msgspec

from strands_actors.drivers.common.physics.physics import Plant
from strands_actors.drivers.common.twin import Fault
from strands_actors.drivers.franka import protocol as p
from strands_actors.drivers.franka.arms import JOINTS, Arm, model_table

from .requests import SETTINGS, numbers_of

TICK_S = 1.0 / p.STATE_HZ
START_RAD = 1e-3
"""Largest difference between the first command of a motion by positions and the commanded position [assumed]."""
SLACK = 1.001
"""Tolerance on the limits, since commands are sums of floats."""
BRAKING_S = 0.04
"""Time by which a simulated servo lags its target. A joint that moves this long at its present speed reaches the
point where it can halt without turning back."""
WRONG_BY_RAD = 0.5
RATE_OVER = 100
"""Number of commands over which the success rate is computed."""

JOINT_GENERATORS = (p.Generator.JOINT_POSITION, p.Generator.JOINT_VELOCITY)
SEVEN = range(JOINTS)


class Motion(msgspec.Struct):
    """A running motion, begun by a ``move`` request with the number ``id``."""

    id: int
    controller: int
    generator: int
    command: p.Command | None = None  # The command that was received since the last tick.
    begun: bool = False  # True once the first command of the motion was received.
    missed: int = 0  # Number of consecutive ticks without a command.
    speed: tuple[float, ...] = (0.0,) * JOINTS
    acceleration: tuple[float, ...] = (0.0,) * JOINTS


class Controller:
    """The simulated controller. It reports each event that no client requested, such as a reflex, to
    ``on_event``."""

    def __init__(self, arm: Arm, fci: int, on_event: Callable[[str], None] = lambda kind: None) -> None:
        self.arm = arm
        self.dialect = p.DIALECTS[fci]
        self.plant = Plant.from_table(model_table(arm))
        self.fault = Fault.OK
        self.ticks = 0
        self._on_event = on_event
        self.reset()

    def reset(self) -> None:
        """Reset to the state after a boot: joints unlocked, FCI activated. The arm stays where it is."""
        self.mode = p.RobotMode.IDLE
        self.motion: Motion | None = None
        self.simulation_moves = False  # True while a simulation, not an FCI client, sets the arm's targets.
        self._booted = self.ticks
        self.reasons: set[str] = set()
        self.success_rate: float | None = None  # A rate that a test has set. None: report the measured rate.
        self._answered: deque[bool] = deque(maxlen=RATE_OVER)
        self._tau = (0.0,) * JOINTS
        self._shown = b""
        self.settings: dict[str, tuple[float, ...]] = {}
        self._data = bytearray(self.dialect.state_bytes)
        identity = [float(row == column) for column in range(4) for row in range(4)]
        for name in ("F_T_EE", "EE_T_K", "F_T_NE", "NE_T_EE"):
            self.dialect.put(self._data, name, *identity)
        self._halt()

    # -- requests of a client

    def start(self, request_id: int, controller: int, generator: int) -> str:
        """Begin the motion that a ``move`` request asks for, if it is possible. Return the status for the reply to
        the client."""
        reported = generator + 1
        torque = controller == p.Controller.EXTERNAL
        if not (reported in JOINT_GENERATORS or (torque and reported == p.Generator.NONE)):
            return "invalid_argument"
        if self.mode != p.RobotMode.IDLE:
            return "not_possible"
        self.motion = Motion(request_id, controller, reported)
        self.simulation_moves = False
        self.mode = p.RobotMode.MOVE
        self._answered.clear()
        self.reasons.clear()
        self._goal = self.q_d
        for joint in SEVEN:
            self.plant.set_torque(joint, not torque)
        return "motion_started"

    def take(self, command: p.Command) -> bool:
        """Keep a command for the next tick. Return False if no motion runs: the command is then ignored."""
        if self.motion is None:
            return False
        self.motion.command = command
        return True

    def stop(self, status: str, mode: p.RobotMode = p.RobotMode.IDLE) -> tuple[int, str] | None:
        """End the running motion.

        Returns:
            The number of the request that began the motion, and the status to reply. None if no motion ran.
        """
        motion, self.motion = self.motion, None
        if motion is None:
            return None
        self.mode = mode
        self._halt(self._goal if status == "success" else None)
        return motion.id, status

    def recover(self) -> bool:
        if self.mode == p.RobotMode.REFLEX:
            self.mode = p.RobotMode.IDLE
            self.reasons.clear()
        return self.mode == p.RobotMode.IDLE

    def store(self, name: str, payload: bytes) -> bool:
        """Store a setting, such as the payload. Return False if the request is invalid."""
        numbers = numbers_of(name, payload)
        if numbers is None or not all(map(math.isfinite, numbers)):
            return False
        self.settings[name] = numbers
        for field, count in SETTINGS[name].items():
            if field:
                self.dialect.put(self._data, field, *numbers[:count])
            numbers = numbers[count:]
        if name == "ne_to_ee":
            self.dialect.put(self._data, "F_T_EE", *self.settings[name])  # The nominal frame is the flange.
        return True

    # -- reflexes, modes, and motion without a client

    def reflex(self, reason: str) -> tuple[int, str] | None:
        ended = self.stop("reflex_aborted")
        self.mode = p.RobotMode.REFLEX
        self.reasons = {reason}
        self._on_event("reflex")
        return ended

    def set_mode(self, mode: p.RobotMode) -> tuple[int, str] | None:
        ended = self.stop("emergency_aborted")
        self.mode = mode
        self._halt()
        return ended

    def _halt(self, goal: tuple[float, ...] | None = None) -> None:
        """Stop the arm and hold it: at ``goal`` if given, else as soon as its speed allows."""
        pairs = zip(self.plant.position_rad, self.plant.velocity_rad_s, strict=True)
        self._goal = goal or tuple(
            min(high, max(low, rad + rad_s * BRAKING_S))
            for (rad, rad_s), low, high in zip(pairs, self.arm.low, self.arm.high, strict=True)
        )
        self.plant.push((0.0,) * JOINTS)
        self._tau = (0.0,) * JOINTS
        for joint in SEVEN:
            self.plant.set_torque(joint, True)
            self.plant.set_target(joint, self._goal[joint])

    def set_targets(self, goal: Sequence[float]) -> None:
        """Move the joints to a target (rad) that the simulation, another program on this computer, has set."""
        self._goal = tuple(goal)
        for joint in SEVEN:
            self.plant.set_target(joint, self._goal[joint])

    @property
    def q_d(self) -> tuple[float, ...]:
        """The joint positions that the controller commands at present, in rad."""
        return self._goal

    # -- the passing of time

    def tick(self) -> tuple[int, str] | None:
        """Advance by a millisecond. If the motion ends in this tick, return the same as ``stop``, else None."""
        self.ticks += 1
        ended = None
        if self.motion is not None:
            ended = self._advance(self.motion)
        self.plant.catch_up(self.ticks * TICK_S)
        return ended

    def _advance(self, motion: Motion) -> tuple[int, str] | None:
        command, motion.command = motion.command, None
        if not motion.begun and command is None:
            return None
        first, motion.begun = not motion.begun, True
        self._answered.append(command is not None)
        if command is None:
            motion.missed += 1
            if motion.missed > p.MISSED_TICKS:
                return self.reflex("communication_constraints_violation")
            self._go_on(motion)
            return None
        motion.missed = 0
        if not all(map(math.isfinite, (*command.q, *command.dq, *command.tau))):
            return self.stop("input_error_aborted")
        if motion.controller == p.Controller.EXTERNAL:
            self._tau = tuple(
                min(most, max(-most, nm)) for nm, most in zip(command.tau, self.arm.effort, strict=True)
            )
            self.plant.push(self._tau)
            self._goal = self.plant.position_rad
        else:
            refused = self._follow(motion, command, first)
            if refused:
                return self.reflex(refused)
        return self.stop("success") if command.finished else None

    def _go_on(self, motion: Motion) -> None:
        """Continue the motion in a tick without a command, as a real controller does.

        The acceleration stays constant (libfranka's rate_limiting.h), and the joints stay within their ranges.
        """
        if motion.controller == p.Controller.EXTERNAL:
            return
        speed = [v + a * TICK_S for v, a in zip(motion.speed, motion.acceleration, strict=True)]
        arm = self.arm
        goal = tuple(
            min(high, max(low, rad + rad_s * TICK_S))
            for rad, rad_s, low, high in zip(self._goal, speed, arm.low, arm.high, strict=True)
        )
        motion.speed = tuple(speed)
        self._set_goal(goal)

    def _follow(self, motion: Motion, command: p.Command, first: bool) -> str:
        """Check a command, and move as it requests. Return the name of the violated limit; empty if it is valid."""
        arm = self.arm
        if motion.generator == p.Generator.JOINT_VELOCITY:
            goal = tuple(rad + rad_s * TICK_S for rad, rad_s in zip(self._goal, command.dq, strict=True))
        else:
            goal = command.q
        steps = tuple(goal_rad - last_rad for goal_rad, last_rad in zip(goal, self._goal, strict=True))
        if first and max(map(abs, steps)) > START_RAD:
            return "joint_position_motion_generator_start_pose_invalid"
        speed = tuple(step / TICK_S for step in steps)
        acceleration = tuple((now - then) / TICK_S for now, then in zip(speed, motion.speed, strict=True))
        before = motion.acceleration
        for joint in SEVEN:
            slowest, fastest = arm.speed_at(joint, goal[joint])
            if not arm.low[joint] - 1e-6 <= goal[joint] <= arm.high[joint] + 1e-6:
                return "joint_motion_generator_position_limits_violation"
            if not slowest * SLACK - 1e-4 <= speed[joint] <= fastest * SLACK + 1e-4:
                return "joint_motion_generator_velocity_limits_violation"
            if abs(acceleration[joint]) > arm.acceleration[joint] * SLACK + 0.01:
                return "joint_motion_generator_velocity_discontinuity"
            if abs(acceleration[joint] - before[joint]) > arm.jerk[joint] * TICK_S * SLACK + 0.01:
                return "joint_motion_generator_acceleration_discontinuity"
        motion.speed, motion.acceleration = speed, acceleration
        self._set_goal(goal)
        return ""

    def _set_goal(self, goal: tuple[float, ...]) -> None:
        self._goal = goal
        for joint in SEVEN:
            self.plant.set_target(joint, goal[joint])

    # -- the state that clients receive

    @property
    def message_id(self) -> int:
        """The controller's time in this tick: milliseconds since the boot."""
        return self.ticks - self._booted

    def state(self) -> bytes:
        """Return the encoded state of this tick. An injected fault repeats the last state, or falsifies this
        one."""
        if self.fault is Fault.STUCK and self._shown:
            return self._shown
        put, data, motion = self.dialect.put, self._data, self.motion
        q, dq = self.plant.position_rad, self.plant.velocity_rad_s
        if self.fault is Fault.WRONG:
            q = tuple(rad + WRONG_BY_RAD for rad in q)
        put(data, "message_id", self.message_id)
        put(data, "q", *q)
        put(data, "theta", *q)
        put(data, "q_d", *self._goal)
        put(data, "dq", *dq)
        put(data, "dtheta", *dq)
        put(data, "dq_d", *(motion.speed if motion else (0.0,) * JOINTS))
        put(data, "ddq_d", *(motion.acceleration if motion else (0.0,) * JOINTS))
        put(data, "tau_J", *self._tau)
        put(data, "tau_J_d", *self._tau)
        put(data, "generator", motion.generator if motion else p.Generator.IDLE)
        put(data, "controller", motion.controller if motion else p.Controller.OTHER)
        put(data, "robot_mode", self.mode)
        put(data, "success_rate", self._rate())
        flags = [name in self.reasons for name in p.ERRORS]
        put(data, "errors", *(flags if self.mode == p.RobotMode.REFLEX else [False] * len(flags)))
        put(data, "reflex_reason", *flags)
        if self.ticks % 10 == 0:  # Compute the pose rarely: it takes as long as the rest of the state.
            pose = self.pose()
            for name in ("O_T_EE", "O_T_EE_d", "O_T_EE_c"):
                put(data, name, *pose)
        self._shown = bytes(data)
        return self._shown

    def pose(self) -> tuple[float, ...]:
        """Return O_T_EE: the pose of the flange in the base, column-major."""
        return self.plant.pose_of("link7", (0.0, 0.0, 0.107))

    def _rate(self) -> float:
        if self.motion is None:
            return 0.0
        if self.success_rate is not None:
            return self.success_rate
        return sum(self._answered) / len(self._answered) if self._answered else 1.0
