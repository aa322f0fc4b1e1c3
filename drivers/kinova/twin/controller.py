"""Simulate the controller in the base of a Gen3: its state, its modes and its arm.

This module has no sockets, and takes the time from a function that its creator passes. It simulates the worst
case: commanded velocities never expire, and the end of a connection or of a session does not stop the arm.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from functools import cached_property
from typing import Any

import numpy as np

from strands_actors.drivers.common.codecs import protobuf as pb
from strands_actors.drivers.common.physics.hand_motion import Fingers, HandMotion
from strands_actors.drivers.common.physics.physics import Plant
from strands_actors.drivers.common.twin import Fault
from strands_actors.drivers.kinova import protocol as p
from strands_actors.drivers.kinova.protocol import ArmState, ServoingMode, SubError
from strands_actors.drivers.kinova.robots import INTERFACE_M, LAST_LINK

from . import messages as m
from .actions import AT_ONCE, Actions
from .arm import Arm, ControlMode
from .commands import decode_speeds, decode_twist
from .devices import Devices
from .errors import CallFailed
from .feedback import FRAMES_HZ, Readings
from .functions import ActionKind, Function
from .gripper import Gripper
from .kinematics import Kinematics, Pose
from .paths import Planner
from .sequences import Sequences
from .sessions import Second, Sessions
from .stores import Store
from .topics import Topics, timestamp
from .users import User, Users
from .waypoints import WaypointPlanner
from .zones import Zone

SUBSTEP_S = 0.004
LONGEST_S = 0.25
"""Longest pause of this process for which the simulation catches up. The rest of a longer pause is dropped."""

GRIPPER_M = 0.12
"""The distance from the interface to the point between the fingers, as in the vendor's URDF."""

UNKNOWN_FAULT, JOINT_FAULT, EMERGENCY_STOP_ACTIVATED = 0x1, 0x10, 0x800000
"""Bits of the base's fault bank A (``SafetyIdentifier``). The first one is set for faults of the control lines."""

ZONE_FIELD = 10
"""Field of a zone's handle in ``ConfigurationChangeNotification``."""

IN_FAULT_TEXT = "Command failed arm is in fault state"


class Controller:
    def __init__(
        self,
        table: Mapping[str, Any],
        *,
        username: str = "admin",
        password: str = "admin",
        second: Second = Second.ACCEPTED,
        has_gripper: bool = True,
        now_s: Callable[[], float] = time.monotonic,
        plant: Plant | None = None,
        fingers: Fingers | None = None,
    ) -> None:
        """Build the controller.

        Args:
            table: The robot's table in ``robots.toml``.
            username: The first user.
            password: The first user's password.
            second: The reaction to a second session.
            has_gripper: True for a Robotiq 2F-85 on the interface.
            now_s: Returns the present time.
            plant: The body of the arm; None for the one of the table.
            fingers: The fingers of the gripper in the body of the arm; None for fingers without physics.
        """
        self.plant = plant or Plant.from_table(table)
        self.now_s = now_s
        self._table = table
        self.fastest_rad_s = [float(joint["speed_rad_s"]) for joint in table["joints"]]
        self.topics = Topics()
        self.users = Users(User(username, password), self._report_change)
        self.sessions = Sessions(self.users, second, now_s, self.topics.forget)
        self.gripper = Gripper(HandMotion(fingers)) if has_gripper else None
        self.devices = Devices(has_gripper)
        self.zones: Store[Zone] = Store(ZONE_FIELD, self._report_change)
        self.arm = Arm(self.plant, table, lambda: self.kinematics, self._is_free)
        self.readings = Readings(self.arm, self.gripper, lambda: self.kinematics)
        at_once: Mapping[int, Callable[[], None]] = {
            ActionKind.APPLY_EMERGENCY_STOP: self.stop_in_emergency,
            ActionKind.CLEAR_FAULTS: self.clear_faults,
            ActionKind.STOP_ACTION: self.arm.hold,
        }
        self.actions = Actions(
            self.arm,
            lambda: (self.planner, self.waypoints),
            self.gripper,
            self.topics,
            at_once,
            now_s,
            self._report_change,
        )
        self.sequences = Sequences(
            self.actions, self.topics, self._set_playing, lambda: self._refusal(True) is None, self._report_change
        )
        self.wake_up()

    def wake_up(self) -> None:
        """Reset to the state after power-on: ready for commands. The arm stays where it is. Users are kept; zones,
        actions and sequences of clients are not [assumed]."""
        self.state = ArmState.SERVOING_READY
        self.mode = ServoingMode.SINGLE_LEVEL
        self.fault = Fault.OK
        self.fault_bank = 0
        self.driven = False  # True once a client has moved the arm since the last stop.
        self.simulation_moves = False  # True while a simulation, not a Kortex client, sets the arm's targets.
        self.sessions.open.clear()
        self.topics.clear()
        self.zones.reset({})
        self.actions.reset()
        self.sequences.reset()
        self._woken_s = self._advanced_s = self.now_s()
        self.arm.reset()
        self.halt()
        self.readings.freeze(None)

    # -- the arm

    @property
    def arm_state(self) -> ArmState:
        """The state that clients see."""
        low_level = self.mode is ServoingMode.LOW_LEVEL and self.state is ArmState.SERVOING_READY
        return ArmState.LOW_LEVEL_SERVOING if low_level else self.state

    def set_state(self, state: ArmState, fault_bank: int = UNKNOWN_FAULT) -> None:
        """Set the state of the base. Every state except ``SERVOING_READY`` halts the arm."""
        before = self.arm_state
        self.state = state
        in_fault = state is ArmState.IN_FAULT
        self.fault_bank = fault_bank if in_fault else 0
        if in_fault:
            self.actions.abort(SubError.ROBOT_IN_FAULT)
        if state is not ArmState.SERVOING_READY:
            self.halt()
            self.arm.hold_all()
        self._report_state(before)

    def set_mode(self, mode: ServoingMode) -> None:
        """Set the servoing mode, and stop the arm."""
        before = self.arm_state
        self.mode = mode
        self.halt()
        self.arm.hold_all()
        payload = pb.varint_field(1, mode) + pb.bytes_field(2, timestamp())
        self.topics.publish(Function.SERVOING_MODE_TOPIC, payload)
        self._report_state(before)

    def set_fault(self, fault: Fault) -> None:
        """Inject a fault. With ``STUCK``, the worst case, the feedback repeats while the arm still moves."""
        self.readings.freeze(self.feedback() if fault is Fault.STUCK else None)
        self.fault = fault
        for joint in range(p.JOINTS):
            self.plant.set_stuck(joint, fault is Fault.OFF)

    def halt(self) -> None:
        """Abort an action, decelerate and hold the position."""
        self.actions.abort(SubError.MANUAL_STOP)
        self.arm.hold()
        if self.gripper is not None:
            self.gripper.stop()
        self.driven = False

    def set_targets(self, rad: list[float]) -> None:
        """Move the joints to a target (rad) that a simulation has set."""
        self.arm.set_targets(rad)

    def advance(self) -> None:
        """Simulate the arm up to the present time. It keeps turning at the commanded speeds until a stop."""
        now_s = self.now_s()
        self._advanced_s = max(self._advanced_s, now_s - LONGEST_S)
        if self.gripper is not None:
            self.gripper.pass_time(now_s - self._advanced_s)
        while (remaining_s := now_s - self._advanced_s) > 0 and self.arm.is_busy:
            step_s = min(SUBSTEP_S, remaining_s)
            self.arm.turn(step_s)
            self._advanced_s += step_s
            self.plant.catch_up(self._advanced_s)
        self._advanced_s = now_s
        self.plant.catch_up(now_s)
        self.actions.pass_time()

    def feedback(self) -> p.Feedback:
        """Return the measurements of the arm. An injected fault repeats or falsifies them."""
        frame = round((self.now_s() - self._woken_s) * FRAMES_HZ) & 0xFFFF_FFFF
        return self.readings.measure(self.arm_state, self.fault_bank, frame, self.fault is Fault.WRONG)

    def encoded_feedback(self) -> bytes:
        return self.readings.encode(self.feedback())

    @cached_property
    def kinematics(self) -> Kinematics:
        reach_m = INTERFACE_M + (GRIPPER_M if self.gripper is not None else 0.0)
        # The tool points along the negative axis z of the last link.
        tool = Pose(np.array((0.0, 0.0, -reach_m)), np.array((0.0, 1.0, 0.0, 0.0)))
        return Kinematics(self._table, LAST_LINK, tool)

    @cached_property
    def planner(self) -> Planner:
        return Planner(self.kinematics, self._table)

    @cached_property
    def waypoints(self) -> WaypointPlanner:
        return WaypointPlanner(self.planner)

    def _is_free(self, rad: Sequence[float]) -> bool:
        enabled = [zone for _, zone in self.zones.items() if zone.enabled]
        return not enabled or not any(zone.contains(self.kinematics.pose(rad).m) for zone in enabled)

    # -- states and modes

    def choose_mode(self, mode: int) -> None:
        if mode not in tuple(ServoingMode):
            raise CallFailed(SubError.INVALID_PARAM, f"servoing mode {mode}")
        if self.state is ArmState.IN_FAULT:
            raise CallFailed(SubError.ROBOT_IN_FAULT, IN_FAULT_TEXT)
        self.set_mode(ServoingMode(mode))

    def stop_in_emergency(self) -> None:
        self.set_state(ArmState.IN_FAULT, EMERGENCY_STOP_ACTIVATED)

    def clear_faults(self) -> None:
        """End the state of a fault, in single-level servoing [assumed]."""
        if self.state is ArmState.IN_FAULT:
            self.arm.faults = [0] * p.JOINTS
            self.mode = ServoingMode.SINGLE_LEVEL
            self.set_state(ArmState.SERVOING_READY)

    def _refusal(self, playing: bool = False) -> CallFailed | None:
        """Return the error of a command that moves the arm; None if the arm may move.

        Args:
            playing: True for a command of a sequence that plays.
        """
        if self.state is ArmState.IN_FAULT:
            return CallFailed(SubError.ROBOT_IN_FAULT, IN_FAULT_TEXT)
        if self.mode is not ServoingMode.SINGLE_LEVEL:
            return CallFailed(SubError.WRONG_MODE, "Wrong servoing mode, must be single level servoing mode")
        if self.state is ArmState.MAINTENANCE:
            return CallFailed(SubError.ROBOT_IN_MAINTENANCE)
        if self.state is ArmState.PLAYING_SEQUENCE:
            return None if playing else CallFailed(SubError.ROBOT_MOVEMENT_IN_PROGRESS, "a sequence plays")
        return None if self.state is ArmState.SERVOING_READY else CallFailed(SubError.ROBOT_NOT_READY)

    def _require_ready(self) -> None:
        refusal = self._refusal()
        if refusal is not None:
            raise refusal

    def _begin_control(self) -> None:
        """Let a client move the arm, which may have been moved by a simulation."""
        if not self.driven:
            if self.simulation_moves:
                self.arm.take_over()
            self.driven, self.simulation_moves = True, False

    def _set_playing(self, playing: bool) -> None:
        before = self.arm_state
        if playing:
            self.state = ArmState.PLAYING_SEQUENCE
        elif self.state is ArmState.PLAYING_SEQUENCE:
            self.state = ArmState.SERVOING_READY
        self._report_state(before)

    def _report_state(self, before: ArmState) -> None:
        if self.arm_state is not before:
            payload = pb.varint_field(1, self.arm_state) + pb.bytes_field(2, timestamp())
            self.topics.publish(Function.ARM_STATE_TOPIC, payload)

    def _report_change(self, event: int, handle_field: int, number: int) -> None:
        """Report that a client has created or deleted an entity."""
        handle = pb.varint_field(1, number)
        payload = pb.varint_field(1, event) + pb.bytes_field(2, timestamp()) + pb.bytes_field(handle_field, handle)
        self.topics.publish(Function.CONFIGURATION_CHANGE_TOPIC, payload)

    # -- motion

    def drive(self, payload: bytes) -> None:
        """Turn the joints at the speeds of ``JointSpeeds``."""
        self._require_ready()
        speeds = decode_speeds(payload, self.fastest_rad_s)
        self._begin_control()
        self.actions.abort(SubError.MANUAL_STOP)
        self.arm.set_speeds(speeds)

    def move_tool(self, payload: bytes) -> None:
        """Move the tool at the velocity of ``TwistCommand``."""
        self._require_ready()
        twist = decode_twist(payload)
        self._begin_control()
        self.actions.abort(SubError.MANUAL_STOP)
        self.arm.set_twist(twist.values, twist.in_tool)

    def grip(self, payload: bytes) -> None:
        self._require_ready()
        if self.gripper is None or self.gripper.lost:
            raise CallFailed(SubError.DEVICE_DISCONNECTED, "the arm has no gripper")
        self.gripper.obey(payload)

    def execute(self, payload: bytes) -> None:
        """Carry out an ``Action``. One that stops the arm or clears faults is carried out in each state."""
        action = m.decode_action(payload)
        if action.kind not in AT_ONCE:
            self._require_ready()
            self._begin_control()
        self.actions.execute(action)

    def execute_as(self, kind: ActionKind, parameters: bytes) -> None:
        """Carry out an action with these parameters."""
        self._require_ready()
        self._begin_control()
        self.actions.execute(m.Action(kind, parameters))

    def stop_action(self) -> None:
        if not self.actions.runs:
            raise CallFailed(SubError.NO_ACTION, "no action runs")
        self.actions.abort(SubError.MANUAL_STOP)

    def play_sequence(self, payload: bytes) -> None:
        self._require_ready()
        self._begin_control()
        self.sequences.play(payload)

    # -- low-level servoing

    def refresh(self, payload: bytes) -> bytes:
        """Set the goals of ``BaseCyclic.Command``. Return an empty message."""
        if self.state is ArmState.IN_FAULT:
            raise CallFailed(SubError.ROBOT_IN_FAULT, IN_FAULT_TEXT)
        self._require_low_level()
        fields = pb.message(payload)
        actuators = m.sub_messages(fields, 2)
        if len(actuators) != p.JOINTS:
            raise CallFailed(SubError.ACTUATOR_COUNT_MISMATCH, f"{len(actuators)} actuators, not {p.JOINTS}")
        commands = [(m.finite(actuator, 3), m.finite(actuator, 5)) for actuator in actuators]
        self._begin_control()
        for joint, (degrees, torque_nm) in enumerate(commands):
            self.arm.command(joint, degrees, torque_nm)
        if self.gripper is not None:
            self.gripper.command(m.sub_message(m.sub_message(fields, 3), 3))
        if any(self.arm.faults):
            self.set_state(ArmState.IN_FAULT, JOINT_FAULT)
        return b""

    def set_control_mode(self, joint: int, mode: int) -> None:
        if mode not in tuple(ControlMode):
            raise CallFailed(SubError.INVALID_PARAM, f"control mode {mode}")
        self._require_low_level()
        self.arm.set_mode(joint, ControlMode(mode))

    def _require_low_level(self) -> None:
        if self.mode is not ServoingMode.LOW_LEVEL:
            raise CallFailed(SubError.WRONG_MODE, "Wrong servoing mode, must be low level servoing mode")
