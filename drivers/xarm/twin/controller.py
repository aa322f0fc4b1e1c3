"""Simulate an xArm's controller: its registers, its state and its arm. No sockets.

The given clock is read in ticks. Between ticks only requests change the state. Behaviour that was never seen on a
real controller is marked [assumed].
"""

from __future__ import annotations

import math
import struct
import time
from collections import deque
from collections.abc import Callable, Sequence

from strands_actors.drivers.common.codecs.malformed import MalformedFrame
from strands_actors.drivers.common.physics.physics import Plant
from strands_actors.drivers.common.physics.poses import Pose
from strands_actors.drivers.xarm import protocol as p
from strands_actors.drivers.xarm import reports as r
from strands_actors.drivers.xarm.arms import ArmType, arm_of
from strands_actors.drivers.xarm.protocol import ERROR, INVALID, NOT_READY, WARNING, Mode, Register, State

from .devices import Devices
from .grippers import hand_of, plant_of
from .kinematics import Kinematics
from .limits import Limits
from .motions import Act, ErrorCode, Joints, Motion, MotionFault
from .planner import Order, Planned, Planner, Target, Velocity
from .poses import numbers_of, pose_of
from .registers import (
    ANSWER_SIZE,
    COLLISION_SENSITIVITY,
    DEVICES,
    LIMITS,
    MODES,
    REGISTERS,
    SETTINGS,
    TOOL_OFFSET,
    Other,
)
from .safety import DEFAULT_SENSITIVITY, CollisionWatch, StepLimit

TICK_HZ = 250.0
"""Control rate of these controllers."""

AT_REST_RAD_S = 0.01

BRAKING_S = 0.05
"""A simulated servo lags behind its target by this time, in seconds. So a joint that halts gets the target that it
reaches in this time, and does not turn back."""

_HALF_TURN_RAD = math.pi + 1e-3

_RUNNING = (State.MOVING, State.READY)


class Controller:
    def __init__(
        self,
        robot: str,
        arm_type: ArmType,
        version: str,
        *,
        speed_limit_rad_s: float,
        now_s: Callable[[], float] = time.monotonic,
        plant: Plant | None = None,
        gripper: str = "",
    ) -> None:
        """Args:
        robot: Name of the robot.
        arm_type: The type of its arm.
        version: The controller's version text.
        speed_limit_rad_s: The joint speed limit that the controller reports and enforces. The speed in the
            robot's table is enforced too, if it is lower.
        now_s: The clock.
        plant: The physics of the arm; None for the arm in the robot's table.
        gripper: The gripper with physics on its flange; empty for none. The tool's bus has one all the same.
        """
        self.plant = plant or plant_of(robot, arm_type, gripper)
        self._hand = hand_of(gripper, self.plant)
        self.version_text = version
        self.version = p.parse_version(version.encode())
        self.speed_limit_rad_s = speed_limit_rad_s
        self._arm_type = arm_type
        top_rad_s = arm_of(robot).speed_rad_s
        self._limits = Limits(arm_type, min(top_rad_s, speed_limit_rad_s) if speed_limit_rad_s > 0.0 else top_rad_s)
        self._now_s = now_s
        self._kinematics = Kinematics(robot, arm_type)
        self._planner = Planner(self._kinematics, self._limits)
        self._steps = StepLimit(lambda: self._limits.top_rad_s)
        self._watch = CollisionWatch(self.plant.effort_limit_nm)
        # Joints that a fault has seized, one bit per joint.
        self._jammed = 0
        self.wake_up()

    def wake_up(self) -> None:
        """Reset to the state after switching on. The arm stays where it is, with its brakes on."""
        self.state: int = State.STOPPED
        self.mode: int = Mode.POSITION
        self.error = self.warning = 0
        self.enabled = 0  # enabled motors, one bit per joint
        self._released = 0  # joints without power and without brake, one bit per joint
        self.count = 0  # counter that clients reset and increase
        self.devices = Devices(self._defer, self._hand)
        self.devices.gripper.motion.halt()
        self._limits.reset()
        self._kinematics.set_tool(None)
        self._kinematics.set_world(None)
        self.settings: dict[int, bytes] = {}  # what clients wrote into the registers of settings
        # True while the simulation moves the arm, until a client of the real protocol enables a motor.
        self.simulation_moves = False
        self._queue: deque[Motion] = deque()
        self._goal: Joints | None = None  # target of servo mode
        # The velocity of the velocity modes, and the time at which it ends.
        self._velocity: tuple[Velocity, float] | None = None
        self._steps.reset()
        self._watch.reset()
        self._ticked_s = self._now_s()
        self._set_brakes()
        self._halt()
        self.plant.catch_up(self._ticked_s)

    # -- values for replies and reports

    @property
    def runs(self) -> bool:
        """Return True while a client of the real protocol can move the arm."""
        return bool(self.enabled) and self.state in (*_RUNNING, State.PAUSED)

    @property
    def flags(self) -> int:
        """Return the present state byte, which every reply contains."""
        ready = self.enabled and self.state in _RUNNING and not self.error
        return ERROR * bool(self.error) | WARNING * bool(self.warning) | NOT_READY * (not ready)

    def report(self) -> r.Report:
        plant = self.plant
        return r.Report(
            self.state, self.mode, len(self._queue), plant.position_rad, self.pose(), tuple(plant.effort_nm)
        )

    @property
    def details(self) -> r.Details:
        return r.Details(self.enabled, self.error, self.warning)

    def pose(self, *, axis_angle: bool = False) -> tuple[float, ...]:
        """Return the pose of the tool: x, y, z in millimetres, then the rotation in rad."""
        return numbers_of(self._kinematics.pose(self.plant.position_rad), axis_angle=axis_angle)

    # -- events: an error, or a new state or mode

    def fail(self, error: int) -> None:
        """Set an error. The arm stops, and its motors are off until a client enables them again [assumed]. The code
        0 removes the error."""
        self.error = error
        if error:
            self.enabled = 0
            self._stop()

    def set_state(self, state: int) -> None:
        match state:
            case State.GO if self.enabled and not self.error:
                self.state = State.READY
            case State.PAUSED if self.state in _RUNNING:
                self.state = State.PAUSED
                self._halt()
            case State.STOPPED:
                self._stop()
        self._set_brakes()

    def set_mode(self, mode: int) -> None:
        self.mode = mode
        self._stop()

    def jam(self, joint: int, on: bool) -> None:
        """Seize the gearbox of a joint, or free it."""
        self._jammed = self._jammed | 1 << joint if on else self._jammed & ~(1 << joint)
        self._set_brakes()

    # -- requests of clients, by register

    def obey(self, register: int, data: bytes) -> tuple[int, bytes]:
        """Carry out a request. Return the state byte and the data of the reply."""
        try:
            if register not in REGISTERS:
                raise MalformedFrame(f"no register {register}")
            answer = self._obey(register, data)
        except (MalformedFrame, IndexError):
            return self.flags | INVALID, bytes(ANSWER_SIZE)
        return self.flags, answer

    def _obey(self, register: int, data: bytes) -> bytes:
        """Carry out a request to a register of the table. Return the data of the reply. Raise ``MalformedFrame`` or
        ``IndexError`` if the request is invalid."""
        plant = self.plant
        match register:
            case Register.VERSION:
                return self.version_text.encode().ljust(p.TEXT_SIZE, b"\0")
            case Register.SERIAL:
                return self.version.serial.encode().ljust(14, b"\0").ljust(p.TEXT_SIZE, b"\0")
            case Register.MOTION_ENABLE if 1 <= data[0] <= p.ALL_JOINTS:
                self._enable(data[0], bool(data[1]))
            case Other.SET_BRAKE if 1 <= data[0] <= p.ALL_JOINTS:
                self._release(data[0], bool(data[1]))
            case Register.SET_STATE if data[0] in (State.GO, State.PAUSED, State.STOPPED):
                self.set_state(data[0])
            case Register.GET_STATE:
                return bytes((self.state,))
            case Register.QUEUE:
                return struct.pack(">H", len(self._queue))
            case Register.ERRORS:
                return bytes((self.error, self.warning))
            case Register.CLEAR_ERROR:
                self.error = 0
            case Register.CLEAR_WARNING:
                self.warning = 0
            case Register.SET_MODE if data[0] in MODES:
                self.set_mode(data[0])
            case _ if register in p.MOTIONS:
                return self._move(register, data)
            case Register.TCP_POSE:
                return p.floats(self.pose())
            case Other.TCP_POSE_AXIS_ANGLE:
                return p.floats(self.pose(axis_angle=True))
            case Register.JOINT_STATES:
                rows = (plant.position_rad, plant.velocity_rad_s, plant.effort_nm)
                return b"".join(p.floats(row) for row in rows[: data[0] & 0x0F if data else 1])
            case Register.JOINT_TORQUE:
                return p.floats(plant.effort_nm)
            case Other.INVERSE_KINEMATICS:
                return p.floats(self._solved(data))
            case Other.FORWARD_KINEMATICS:
                return p.floats(numbers_of(self._kinematics.pose(_finite(p.unpack_floats(data, p.JOINTS)))))
            case Other.CHECK_JOINTS:
                return bytes((not self._limits.accepts(_finite(p.unpack_floats(data, p.JOINTS))),))
            case Other.CHECK_POSE:
                return bytes((self._is_out_of_reach(_pose(data)),))
            case Other.POSE_OFFSET:
                first, second = _pose(data, axis_angle=bool(data[48])), _pose(data, 24, axis_angle=bool(data[48]))
                return p.floats(numbers_of(first.inverse @ second, axis_angle=bool(data[49])))
            case Other.REPORT_CURRENTS if data[0] == 0:
                pass
            case Other.COUNTER_RESET:
                self.count = 0
            case Other.COUNTER_PLUS:
                self.count += 1
            case _ if register in LIMITS:
                return self._limits.obey(register, data)
            case _ if register in DEVICES:
                return self.devices.obey(register, data)
            case _ if register in SETTINGS and len(data) == SETTINGS[register].size:
                self._set(register, data)
            case _:
                raise MalformedFrame(f"register {register} with {data.hex()}")
        return b""

    def _enable(self, joint: int, on: bool) -> None:
        bits = _bits(joint)
        self.enabled = self.enabled | bits if on else self.enabled & ~bits
        self._released &= ~bits
        if on:
            self.simulation_moves = False
        else:
            self._stop()
        self._set_brakes()

    def _release(self, joint: int, on: bool) -> None:
        """Take the power from a joint, with its brake released or not."""
        bits = _bits(joint)
        self.enabled &= ~bits
        self._released = self._released | bits if on else self._released & ~bits
        self._stop()

    def _set(self, register: int, data: bytes) -> None:
        """Store a setting."""
        if register in (TOOL_OFFSET, Other.WORLD_OFFSET):
            offset = _pose(data)
            if register == TOOL_OFFSET:
                self._kinematics.set_tool(offset)
            else:
                self._kinematics.set_world(offset)
        self.settings[register] = data

    def _is_out_of_reach(self, pose: Pose) -> bool:
        joints = self._kinematics.solve(pose, self._target)
        return joints is None or not self._limits.accepts(joints.tolist()) or not self._limits.contains(pose.place)

    def _solved(self, data: bytes) -> Sequence[float]:
        """Return joint positions for a pose. Newer clients append a limit of 180 degrees, on or off, and then the
        joint positions to which the solution should be near."""
        near = _finite(p.unpack_floats(data, p.JOINTS, 25)) if len(data) >= 53 else self._target
        limited = len(data) < 25 or data[24]
        solution = self._kinematics.solve(_pose(data), near, _HALF_TURN_RAD if limited else math.inf)
        if solution is None:
            raise MalformedFrame("this pose cannot be reached")
        joints: Sequence[float] = solution.tolist()
        return joints

    # -- requests that move the arm

    def _move(self, register: int, data: bytes) -> bytes:
        """Accept a motion if its register fits the mode. A paused arm stores the target and moves there later. The
        flags of the reply say whether the arm is not ready. Return the data of the reply."""
        order = self._planner.decode(register, data)
        if not self.runs or self.error:
            return b""
        if self.mode not in order.modes:
            raise MalformedFrame(f"register {register} in mode {self.mode}")
        if isinstance(order, Planned) and order.only_check:
            return bytes((0, 0, self._check(order)))
        try:
            self._accept(order)
        except MotionFault as fault:
            self.fail(fault.code)
        return b""

    def _check(self, order: Planned) -> int:
        """Return the error that a motion would cause from here, 0 for no error."""
        try:
            order.goal_of(self._target)
        except MotionFault as fault:
            return fault.code
        return 0

    def _accept(self, order: Order) -> None:
        """Store a motion. Raise ``MotionFault`` if it is impossible."""
        if isinstance(order, Target):
            here = self._goal or self._target
            goal = order.goal_of(here)
            if not self._steps.accepts(goal, here, self._now_s()):
                raise MotionFault(ErrorCode.TOO_FAST)
            self._goal = goal
        elif isinstance(order, Velocity):
            self._velocity = order, self._now_s() + order.duration_s
        elif self.mode == Mode.POSITION:
            if not self._queue:
                order.goal_of(self._target)
            self._queue.append(order.motion)
        else:
            # The online modes plan anew from where the arm is.
            order.goal_of(self._target)
            self._queue.clear()
            self._queue.append(order.motion)

    def _defer(self, act: Callable[[], None]) -> None:
        """Run a function when the queued motions have ended, at once if there are none."""
        if self._queue:
            self._queue.append(Act(act))
        else:
            act()

    # -- stop, hold and target of the arm

    def _stop(self) -> None:
        self.state = State.STOPPED
        self._queue.clear()
        self._goal = self._velocity = None
        self._steps.reset()
        self._watch.reset()
        self._halt()
        self._set_brakes()

    def _halt(self) -> None:
        columns = zip(self.plant.position_rad, self.plant.velocity_rad_s, strict=True)
        self._target = [rad + rad_s * BRAKING_S for rad, rad_s in columns]

    def set_targets(self, goal: Sequence[float]) -> None:
        """Set the target that the simulation, another program on this computer, commands."""
        self._target = list(goal)

    def hold(self) -> None:
        self._halt()

    def let_simulation_move(self, on: bool) -> None:
        """Let the simulation, another program on this computer, move the arm (``on``), or let the clients of the
        real protocol move it again."""
        self.simulation_moves = on
        self.devices.gripper.speed = self.devices.gripper.FASTEST
        self._halt()
        self._set_brakes()

    @property
    def _is_taught(self) -> bool:
        """Return True while a hand can move the arm, in the mode for teaching."""
        return self.mode == Mode.TEACH and self.state in _RUNNING and not self.simulation_moves

    def _set_brakes(self) -> None:
        for joint in range(p.JOINTS):
            powered = self.simulation_moves or bool(self.enabled >> joint & 1)
            released = powered or bool(self._released >> joint & 1)
            self.plant.set_stuck(joint, not released or bool(self._jammed >> joint & 1))
            self.plant.set_torque(joint, powered and not self._is_taught)

    # -- the passing of time

    def tick(self) -> None:
        now_s = self._now_s()
        elapsed_s, self._ticked_s = min(now_s - self._ticked_s, 0.1), now_s
        self.advance(elapsed_s)
        self.plant.catch_up(now_s)
        if self.state in _RUNNING:
            moves = max(map(abs, self.plant.velocity_rad_s)) > AT_REST_RAD_S
            self.state = State.MOVING if self._queue or moves else State.READY
            self._look_for_collision(elapsed_s)

    def advance(self, elapsed_s: float) -> None:
        """Advance the motion by ``elapsed_s`` seconds, and set the targets of the joints."""
        if self.state in _RUNNING and not self.simulation_moves:
            try:
                self._follow(elapsed_s)
                self._check_boundary()
            except MotionFault as fault:
                self.fail(fault.code)
        for joint, rad in enumerate(self._target):
            self.plant.set_target(joint, rad)
        self.devices.tick(elapsed_s)

    def _follow(self, elapsed_s: float) -> None:
        """Advance the setpoint of the joints. Raise ``MotionFault`` if that is impossible."""
        if self._is_taught:
            self._target = list(self.plant.position_rad)
        elif self._goal is not None:
            # The arm moves there at full speed, even if targets come rarely.
            self._target = list(self._goal)
        elif self._queue:
            motion = self._queue[0]
            self._target = list(motion.advance(self._target, elapsed_s))
            if motion.is_done(self.plant.position_rad):
                self._queue.popleft()
        elif self._velocity is not None:
            self._follow_velocity(*self._velocity, elapsed_s)

    def _check_boundary(self) -> None:
        """Raise ``MotionFault`` if the arm is on its way out of the safety boundary."""
        if self._limits.fence and not self._limits.contains(self._kinematics.pose(self._target).place):
            raise MotionFault(ErrorCode.BOUNDARY)

    def _follow_velocity(self, velocity: Velocity, until_s: float, elapsed_s: float) -> None:
        if self._now_s() >= until_s:
            self._velocity = None
            self._halt()
            return
        rates = velocity.rates_of(self._target)
        target = [position + rate * elapsed_s for position, rate in zip(self._target, rates, strict=True)]
        if not self._limits.accepts(target):
            raise MotionFault(ErrorCode.PAST_LIMIT)
        self._target = target

    def _look_for_collision(self, elapsed_s: float) -> None:
        if self.simulation_moves or self._is_taught:
            return
        stored = self.settings.get(COLLISION_SENSITIVITY)
        sensitivity = stored[0] if stored else DEFAULT_SENSITIVITY
        plant = self.plant
        readings = plant.position_rad, plant.velocity_rad_s, plant.effort_nm
        if self._watch.is_blocked(elapsed_s, sensitivity, self._target, *readings):
            self.fail(ErrorCode.COLLISION)


def _bits(joint: int) -> int:
    """Return a bit for a joint, 1 to 7, or for all joints, 8."""
    return (1 << p.JOINTS) - 1 if joint == p.ALL_JOINTS else 1 << joint - 1


def _pose(data: bytes, offset: int = 0, *, axis_angle: bool = False) -> Pose:
    return pose_of(_finite(p.unpack_floats(data, 6, offset)), axis_angle=axis_angle)


def _finite(numbers: tuple[float, ...]) -> tuple[float, ...]:
    if not all(abs(number) < 1e6 for number in numbers):
        raise MalformedFrame(f"not finite, or too large: {numbers}")
    return numbers
