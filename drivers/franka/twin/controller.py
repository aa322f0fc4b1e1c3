"""Simulate a Franka controller: robot mode, running motion, checks of each command, and the arm. No sockets.

Time passes in ticks of a millisecond, one per call of ``tick``.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Sequence

import numpy as np

from strands_actors.drivers.common.twin import Fault
from strands_actors.drivers.franka import protocol as p
from strands_actors.drivers.franka.arms import JOINTS, Arm, model_table

from . import kinematics
from . import path as paths
from .hand import hand_of, plant_with_hand
from .motion import AFTER_IK, CARTESIAN, COMMANDED, JOINT, SLACK, Motion, move_joints
from .path import CartesianPath
from .plant import Plant
from .requests import INVALID_ARGUMENT, NOT_POSSIBLE, SETTINGS, SUCCESS, numbers_of

TICK_S = paths.TICK_S
START_RAD = 1e-3
"""Largest difference between the first command of a motion by positions and the commanded position [assumed]."""
BRAKING_S = 0.04
"""Time by which a simulated servo lags its target. A joint that moves this long at its present speed reaches the
point where it can halt without turning back."""
WRONG_BY_RAD = 0.5
RATE_OVER = 100
"""Number of commands over which the success rate is computed."""
TORQUE_RATE = 1000.0
"""Largest change of a commanded torque, in Nm/s, from libfranka's rate_limiting.h."""
SOFTEST_NM_RAD = 10.0
"""Least stiffness of a joint under Cartesian impedance: the elbow has none by the end effector's [assumed]."""

SEVEN = range(JOINTS)
HAND_TICKS = 4
"""The hand moves once in so many ticks."""


class Controller:
    """The simulated controller. It reports each event that no client requested, such as a reflex, to
    ``on_event``."""

    _is_soft = False  # True while the servos have a stiffness that a client has chosen.

    def __init__(
        self, arm: Arm, fci: int, on_event: Callable[[str], None] = lambda kind: None, gripper: str = ""
    ) -> None:
        self.arm = arm
        self.dialect = p.DIALECTS[fci]
        self.plant = plant_with_hand(arm, gripper) if gripper else Plant.from_table(model_table(arm))
        self.hand = hand_of(self.plant) if gripper else None
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
        self._tool = np.eye(4)  # Pose of the end effector in the flange.
        self._data = bytearray(self.dialect.state_bytes)
        for name in ("F_T_EE", "EE_T_K", "F_T_NE", "NE_T_EE"):
            self.dialect.put(self._data, name, *kinematics.numbers(self._tool))
        self._halt()
        if self.hand is not None:
            self.hand.wake_up()

    # -- requests of a client

    def start(self, request_id: int, controller: int, generator: int) -> str:
        """Begin the motion that a ``move`` request asks for, if it is possible. Return the status for the reply to
        the client."""
        reported = generator + 1
        torque = controller == p.Controller.EXTERNAL
        if controller > p.Controller.EXTERNAL or not (
            reported in (*JOINT, *CARTESIAN) or (torque and reported == p.Generator.NONE)
        ):
            return "invalid_argument"
        if self.mode != p.RobotMode.IDLE:
            return "not_possible"
        path = None
        if reported in CARTESIAN:
            if kinematics.is_singular(self.q_d):
                return "start_at_singular_pose"
            path = CartesianPath(self.arm, self._tool, self.q_d, reported == p.Generator.CARTESIAN_VELOCITY)
        # A client that commands torques alone selects joint velocities, too, and sends zeros.
        leads = not torque or reported not in (p.Generator.NONE, p.Generator.JOINT_VELOCITY)
        self.motion = Motion(request_id, controller, reported, path, leads=leads)
        self.simulation_moves = False
        self.mode = p.RobotMode.MOVE
        self._answered.clear()
        self.reasons.clear()
        self._goal = self.q_d
        for joint in SEVEN:
            self.plant.set_torque(joint, not torque)
        self._set_stiffness(controller)
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
        at_goal = self.plant.position_rad if motion.controller == p.Controller.EXTERNAL else self._goal
        self._halt(at_goal if status == "success" else None)
        return motion.id, status

    def recover(self) -> bool:
        if self.mode == p.RobotMode.REFLEX:
            self.mode = p.RobotMode.IDLE
            self.reasons.clear()
        return self.mode == p.RobotMode.IDLE

    def store(self, name: str, payload: bytes) -> bytes:
        """Store a setting, such as the payload. Return the status for the reply: settings cannot change during a
        motion."""
        numbers = numbers_of(name, payload)
        if numbers is None:
            return INVALID_ARGUMENT
        if self.mode == p.RobotMode.MOVE:
            return NOT_POSSIBLE
        self.settings[name] = numbers
        if name == "ne_to_ee":
            self._tool = kinematics.matrix(numbers)  # The nominal end effector is the flange.
            self.dialect.put(self._data, "F_T_EE", *numbers)
        for field, count in SETTINGS[name].items():
            if field:
                self.dialect.put(self._data, field, *numbers[:count])
            numbers = numbers[count:]
        return SUCCESS

    def _set_stiffness(self, controller: int) -> None:
        """Make the servos as stiff as the client has requested for motions under this controller."""
        stiffness: Sequence[float] | None = None
        if controller == p.Controller.JOINT_IMPEDANCE:
            stiffness = self.settings.get("joint_impedance")
        elif controller == p.Controller.CARTESIAN_IMPEDANCE and "cartesian_impedance" in self.settings:
            # The diagonal of the joints' stiffness that belongs to the end effector's.
            row = np.array(self.settings["cartesian_impedance"]) @ kinematics.jacobian(self.q_d) ** 2
            stiffness = np.maximum(row, SOFTEST_NM_RAD).tolist()
        if stiffness is not None or self._is_soft:
            self.plant.set_stiffness(stiffness)
        self._is_soft = stiffness is not None

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
        self._set_stiffness(p.Controller.OTHER)

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
        if self.hand is not None and self.ticks % HAND_TICKS == 0:
            self.hand.advance(HAND_TICKS * TICK_S)
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
            if motion.missed >= p.MISSED_TICKS:
                return self.reflex("communication_constraints_violation")
            refused = self._go_on(motion)
            return self.reflex(refused) if refused else None
        motion.missed = 0
        if not all(map(math.isfinite, command.numbers)):
            return self.stop("input_error_aborted")
        motion.leads = motion.leads or (motion.generator == p.Generator.JOINT_VELOCITY and any(command.dq))
        refused = self._follow(motion, command, first) if motion.leads else ""
        if not refused and motion.controller == p.Controller.EXTERNAL:
            refused = self._push(command.tau)
        if refused:
            return self.reflex(refused)
        if not motion.leads:
            self._goal = self.plant.position_rad
        return self.stop("success") if command.finished else None

    def _go_on(self, motion: Motion) -> str:
        """Continue the motion in a tick without a command, as a real controller does.

        The acceleration, or the torque, stays constant, and the joints stay within their ranges. Return the name of
        the violated limit; empty if the motion goes on.
        """
        if not motion.leads:
            return ""
        if motion.path is not None:
            motion.path.go_on()
            return self._follow_path(motion, motion.path)
        speed = [v + a * TICK_S for v, a in zip(motion.speed, motion.acceleration, strict=True)]
        arm = self.arm
        goal = tuple(
            min(high, max(low, rad + rad_s * TICK_S))
            for rad, rad_s, low, high in zip(self._goal, speed, arm.low, arm.high, strict=True)
        )
        motion.speed = tuple(speed)
        self._set_goal(goal)
        return ""

    def _follow(self, motion: Motion, command: p.Command, first: bool) -> str:
        """Check a command, and move as it requests. Return the name of the violated limit; empty if it is valid."""
        if motion.path is not None:
            return motion.path.follow(command, first) or self._follow_path(motion, motion.path)
        goal = command.q
        if motion.generator == p.Generator.JOINT_VELOCITY:
            goal = tuple(rad + rad_s * TICK_S for rad, rad_s in zip(self._goal, command.dq, strict=True))
        elif first and max(abs(rad - last) for rad, last in zip(goal, self._goal, strict=True)) > START_RAD:
            return "joint_position_motion_generator_start_pose_invalid"
        refused = move_joints(motion, self.arm, self._goal, goal, COMMANDED)
        if not refused:
            self._set_goal(goal)
        return refused

    def _follow_path(self, motion: Motion, path: CartesianPath) -> str:
        """Move the joints to the present pose of the path. Return the name of the violated limit, or empty."""
        goal = path.joints(self._goal)
        if goal is None:  # Close to a singular pose, the joints would have to be too fast.
            return AFTER_IK.speed
        refused = move_joints(motion, self.arm, self._goal, goal, AFTER_IK)
        if not refused:
            self._set_goal(goal)
        return refused

    def _push(self, torque_nm: Sequence[float]) -> str:
        """Apply torques, at most those of the joints. Return the name of the violated limit; empty if they are
        valid."""
        tau = tuple(min(most, max(-most, nm)) for nm, most in zip(torque_nm, self.arm.effort, strict=True))
        most = TORQUE_RATE * TICK_S * SLACK
        if any(abs(nm - before) > most for nm, before in zip(tau, self._tau, strict=True)):
            return "controller_torque_discontinuity"
        self._tau = tau
        self.plant.push(tau)
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
        if self.ticks % 10 == 0:  # Compute the poses rarely: it takes as long as the rest of the state.
            put(data, "O_T_EE", *self.pose())
            put(data, "elbow", *_elbow_of(self.plant.position_rad))
        if motion is not None and motion.path is not None:
            self._put_path(motion.path)
        elif self.ticks % 10 == 0:
            self._put_path(CartesianPath(self.arm, self._tool, self._goal, False))
        self._shown = bytes(data)
        return self._shown

    def _put_path(self, path: CartesianPath) -> None:
        """Write the commanded and the desired motion of the end effector, which are the same in this simulation."""
        put, data = self.dialect.put, self._data
        pose, twist, elbow = kinematics.numbers(path.pose), path.twist.tolist(), (path.elbow, path.sign)
        for end in "cd":
            put(data, f"O_T_EE_{end}", *pose)
            put(data, f"O_dP_EE_{end}", *twist)
            put(data, f"elbow_{end}", *elbow)
        put(data, "O_ddP_EE_c", *path.acceleration.tolist())
        put(data, "delbow_c", path.elbow_speed, path.sign)
        put(data, "ddelbow_c", path.elbow_acceleration, path.sign)

    def pose(self) -> tuple[float, ...]:
        """Return O_T_EE: the measured pose of the end effector in the base, column-major."""
        return tuple(kinematics.numbers(kinematics.pose(self.plant.position_rad) @ self._tool))

    def _rate(self) -> float:
        if self.motion is None:
            return 0.0
        if self.success_rate is not None:
            return self.success_rate
        return sum(self._answered) / len(self._answered) if self._answered else 1.0


def _elbow_of(joints: Sequence[float]) -> tuple[float, float]:
    """Return the configuration of the elbow: the position of joint 3 (rad), and the sign of joint 4."""
    return joints[kinematics.ELBOW], math.copysign(1.0, joints[kinematics.ELBOW + 1])
