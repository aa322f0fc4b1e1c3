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
from strands_actors.drivers.xarm import protocol as p
from strands_actors.drivers.xarm import reports as r
from strands_actors.drivers.xarm.arms import ArmType, arm_of, model_table
from strands_actors.drivers.xarm.protocol import ERROR, INVALID, NOT_READY, WARNING, Mode, Register, State

from .registers import ANSWER_SIZE, CHECK_JOINTS, MODES, REGISTERS, REPORT_CURRENTS, SETTINGS

TICK_HZ = 250.0
"""Control rate of these controllers."""

STEP_RAD = 0.5
"""A servo target that differs from the last one by more than this causes error 24 [assumed]."""

AT_REST_RAD_S = 0.01
ARRIVED_RAD = 2e-3

BRAKING_S = 0.05
"""A simulated servo lags behind its target by this time, in seconds. So a joint that halts gets the target that it
reaches in this time, and does not turn back."""

SLOWEST_RAD_S = 0.01
SPEED_EXCEEDED, JOINT_PAST_LIMIT = 24, 23

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
    ) -> None:
        """Args:
        robot: Name of the robot.
        arm_type: The type of its arm.
        version: The controller's version text.
        speed_limit_rad_s: The joint speed limit that the controller reports. The simulated arm itself moves at
            the speed in the robot's table.
        now_s: The clock.
        plant: The physics of the arm; None for the arm in the robot's table.
        """
        self.plant = plant or Plant.from_table(model_table(robot, arm_type))
        self.version_text = version
        self.version = p.parse_version(version.encode())
        self.speed_limit_rad_s = speed_limit_rad_s
        self._arm_type = arm_type
        self._top_rad_s = arm_of(robot).speed_rad_s
        self._now_s = now_s
        self.wake_up()

    def wake_up(self) -> None:
        """Reset to the state after switching on. The arm stays where it is, with its brakes on."""
        self.state: int = State.STOPPED
        self.mode: int = Mode.POSITION
        self.error = self.warning = 0
        self.enabled = 0  # enabled motors, one bit per joint
        self.settings: dict[int, bytes] = {}  # what clients wrote into the registers of settings
        # True while the simulation moves the arm, until a client of the real protocol enables a motor.
        self.simulation_moves = False
        self._queue: deque[tuple[Sequence[float], float]] = deque()
        self._goal: Sequence[float] | None = None  # target of servo mode
        # Joint speeds of velocity mode, and the time at which they end.
        self._rates: tuple[Sequence[float], float] | None = None
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
            self.state, self.mode, len(self._queue), plant.position_rad, self._pose(), tuple(plant.effort_nm)
        )

    @property
    def details(self) -> r.Details:
        return r.Details(self.enabled, self.error, self.warning)

    # -- events: an error, or a new state or mode

    def fail(self, error: int) -> None:
        """Set an error. The arm stops, and its motors are off until a client enables them again [assumed]. The code
        0 removes the error."""
        self.error = error
        if error:
            self.enabled = 0
            self._stop()
            self._set_brakes()

    def set_state(self, state: int) -> None:
        match state:
            case State.GO if self.enabled and not self.error:
                self.state = State.READY
            case State.PAUSED if self.state in _RUNNING:
                self.state = State.PAUSED
                self._halt()
            case State.STOPPED:
                self._stop()

    def set_mode(self, mode: int) -> None:
        self.mode = mode
        self._stop()

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
            case Register.MOVE_JOINT | Register.SERVO_JOINT | Register.JOINT_VELOCITY | Register.MOVE_HOME:
                self._move(register, data)
            case Register.TCP_POSE:
                return p.floats(self._pose())
            case Register.JOINT_STATES:
                rows = (plant.position_rad, plant.velocity_rad_s, plant.effort_nm)
                return b"".join(p.floats(row) for row in rows[: data[0] & 0x0F if data else 1])
            case Register.JOINT_TORQUE:
                return p.floats(plant.effort_nm)
            case _ if register == CHECK_JOINTS:
                return bytes((not self._in_range(_finite(p.unpack_floats(data, p.JOINTS))),))
            case _ if register == REPORT_CURRENTS and data[0] == 0:
                pass
            case _ if register in SETTINGS and len(data) == SETTINGS[register].size:
                self.settings[register] = data
            case _:
                raise MalformedFrame(f"register {register} with {data.hex()}")
        return b""

    def _enable(self, joint: int, on: bool) -> None:
        bits = (1 << p.JOINTS) - 1 if joint == p.ALL_JOINTS else 1 << joint - 1
        self.enabled = self.enabled | bits if on else self.enabled & ~bits
        if on:
            self.simulation_moves = False
        else:
            self._stop()
        self._set_brakes()

    def _move(self, register: int, data: bytes) -> None:
        """Accept a target if its register fits the mode. A paused arm stores the target and moves there later. The
        flags of the reply say whether the arm is not ready."""
        home = register == Register.MOVE_HOME
        numbers = _finite((0.0,) * p.JOINTS if home else p.unpack_floats(data, p.JOINTS))
        mode = {Register.SERVO_JOINT: Mode.SERVO, Register.JOINT_VELOCITY: Mode.VELOCITY}.get(
            Register(register), Mode.POSITION
        )
        if not self.runs or self.error:
            return
        if self.mode != mode:
            raise MalformedFrame(f"register {register} in mode {self.mode}")
        if mode == Mode.SERVO:
            self._servo(numbers)
        elif mode == Mode.VELOCITY:
            duration_s = p.unpack_floats(data, 1, 4 * p.JOINTS + 1)[0] if len(data) > 4 * p.JOINTS + 1 else -1.0
            until_s = self._now_s() + duration_s if duration_s >= 0 else math.inf
            self._rates = numbers, until_s
        elif self._in_range(numbers):
            (speed,) = _finite(p.unpack_floats(data, 1, 0 if home else 4 * p.JOINTS))
            self._queue.append((numbers, max(SLOWEST_RAD_S, min(self._top_rad_s, speed))))
        else:
            self.fail(JOINT_PAST_LIMIT)

    def _in_range(self, goal: Sequence[float]) -> bool:
        ranges = self._arm_type.range_rad
        return all(low - 1e-3 <= rad <= high + 1e-3 for rad, (low, high) in zip(goal, ranges, strict=True))

    def _servo(self, goal: Sequence[float]) -> None:
        before = self._goal or self._target
        if not self._in_range(goal):
            self.fail(JOINT_PAST_LIMIT)
        elif max(abs(rad - was) for rad, was in zip(goal, before, strict=True)) > STEP_RAD:
            self.fail(SPEED_EXCEEDED)
        else:
            self._goal = goal

    # -- stop, hold and target of the arm

    def _stop(self) -> None:
        self.state = State.STOPPED
        self._queue.clear()
        self._goal = self._rates = None
        self._halt()

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
        self._halt()
        self._set_brakes()

    def _set_brakes(self) -> None:
        for joint in range(p.JOINTS):
            released = self.simulation_moves or bool(self.enabled >> joint & 1)
            self.plant.set_stuck(joint, not released)
            self.plant.set_torque(joint, released)

    # -- the passing of time

    def tick(self) -> None:
        now_s = self._now_s()
        elapsed_s, self._ticked_s = min(now_s - self._ticked_s, 0.1), now_s
        self.advance(elapsed_s)
        self.plant.catch_up(now_s)
        if self.state in _RUNNING:
            moves = max(map(abs, self.plant.velocity_rad_s)) > AT_REST_RAD_S
            self.state = State.MOVING if self._queue or moves else State.READY

    def advance(self, elapsed_s: float) -> None:
        """Advance the motion by ``elapsed_s`` seconds, and set the targets of the joints."""
        if self.state in _RUNNING and not self.simulation_moves:
            if self.mode == Mode.SERVO and self._goal is not None:
                # The arm moves there at full speed, even if targets come rarely.
                self._target = list(self._goal)
            elif self.mode == Mode.POSITION and self._queue:
                self._follow_queue(elapsed_s)
            elif self.mode == Mode.VELOCITY and self._rates is not None:
                self._follow_rates(elapsed_s)
        for joint, rad in enumerate(self._target):
            self.plant.set_target(joint, rad)

    def _follow_queue(self, elapsed_s: float) -> None:
        goal, speed = self._queue[0]
        step = speed * elapsed_s
        self._target = [
            position + max(-step, min(step, rad - position))
            for position, rad in zip(self._target, goal, strict=True)
        ]
        if (
            max(abs(position - rad) for position, rad in zip(self.plant.position_rad, goal, strict=True))
            < ARRIVED_RAD
        ):
            self._queue.popleft()

    def _follow_rates(self, elapsed_s: float) -> None:
        assert self._rates is not None
        rates, until_s = self._rates
        if self._now_s() >= until_s:
            self._rates = None
            self._halt()
        else:
            self._target = [position + rate * elapsed_s for position, rate in zip(self._target, rates, strict=True)]

    def _pose(self) -> tuple[float, ...]:
        """Return the pose of the flange in the frame of the base: x, y, z in millimetres, then roll, pitch and yaw
        in rad."""
        flange = self.plant.data.body("link7")
        m = flange.xmat
        roll, pitch = math.atan2(m[7], m[8]), math.asin(max(-1.0, min(1.0, -m[6])))
        return (*(1e3 * metres for metres in flange.xpos.tolist()), roll, pitch, math.atan2(m[3], m[0]))


def _finite(numbers: tuple[float, ...]) -> tuple[float, ...]:
    if not all(map(math.isfinite, numbers)):
        raise MalformedFrame(f"not finite: {numbers}")
    return numbers
