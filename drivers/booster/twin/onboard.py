"""Simulate the robot's own computer: modes, falls, service, battery, and control of the body.

It has no network and no clock: every call brings the time, and between calls nothing happens.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Sequence
from typing import Any

from strands_actors.contract.rotations import roll_pitch_yaw
from strands_actors.drivers.booster import rpc
from strands_actors.drivers.booster.protocol import Battery, Command, Fall, Odometer, State
from strands_actors.drivers.booster.robots import BASE, FIRST_ARM, HEAD, LAST_ARM, Model
from strands_actors.drivers.booster.rpc import STANDS, WALKS, Api, Mode, Request, Response
from strands_actors.drivers.common.codecs.malformed import MalformedFrame

from .body import body_of
from .devices import device_info
from .frames import transform_between
from .requests import REQUESTS

STAND_KP, STAND_KD = 500.0, 10.0
"""Gains of the onboard controller for the legs. It only stands."""
SWAY_KP, SWAY_KD = 60.0, 3.0
"""Gains for arms and head, which it turns gently."""
TURN_RAD_S = 1.5
"""Speed at which it turns them."""
DAMPING = 2.0
ROOM_C = 30
FALLING_S, GETTING_UP_S = 1.2, 1.5
PUSH_M_S = 1.2
NAME = "T1 twin"

ARMS = range(FIRST_ARM, LAST_ARM + 1)
Row = tuple[float, ...]


class Onboard:
    """The simulated onboard computer of the robot.

    Args:
        model: The robot type.
        note: Called with a kind and a text when one of these changes: ``mode``, ``fall``, ``twist``,
            ``upper_body``.
        mode: The mode after a boot.
    """

    def __init__(self, model: Model, note: Callable[[str, str], None], mode: Mode = Mode.WALKING) -> None:
        self.model = model
        self.body = body_of(model)
        self.percent = 80.0
        self._note = note
        self._first_mode = mode
        self._home = self.body.position_rad
        self._head = [motor.key for motor in model.motors].index(HEAD["pitch"]), 0
        self.reset()

    def reset(self) -> None:
        """Restart as after a boot, with the robot on its feet."""
        self.body.stand_up()
        self.mode = self._first_mode
        self.fall = Fall.IS_READY
        self.host_has_arms = False  # True while the host commands the upper body
        self.simulated = False  # True while a local simulation moves the upper body
        self.twist: Row = (0.0, 0.0, 0.0)
        self.odometer = Odometer(0.0, 0.0, 0.0)
        self._command: Command | None = None
        self._goal = list(self._home)  # goal of arms and head
        self._target = list(self._home)  # setpoint on the way to the goal
        self._since_s = self._now_s = 0.0

    # -- commands

    def command(self, command: Command) -> None:
        """Store a LowCmd if the host may command motors in this mode. The newest command stays in
        force."""
        if self.host_has_arms or self.mode is Mode.CUSTOM:
            self._command = command

    def set_arm_targets(self, arms: Sequence[float]) -> None:
        """Set the goal of the arms for a local simulation, which acts in the place of a client."""
        self._goal[FIRST_ARM : LAST_ARM + 1] = arms

    def set_mode(self, mode: Mode) -> None:
        if self.mode not in STANDS and mode in STANDS:
            # Put the robot on its feet, as a person would do before this change of the mode.
            self.body.stand_up()
        self.mode = mode
        self.take_back()
        self._stand()
        self._note("mode", mode.name.lower())

    def take_back(self) -> None:
        """End the host's control of the upper body, and move the arms to the home pose."""
        if self.host_has_arms:
            self._note("upper_body", "back")
        self.host_has_arms, self._command = False, None
        self._goal, self._target = list(self._home), list(self.body.position_rad)

    def fall_over(self) -> None:
        if self.fall is not Fall.IS_READY:
            return
        self.body.data.qvel[0] += PUSH_M_S
        self.set_mode(Mode.DAMPING)
        self._set_fall(Fall.IS_FALLING)

    def get_up(self) -> None:
        if self.fall is Fall.HAS_FALLEN:
            self._set_fall(Fall.IS_GETTING_UP)

    def _set_fall(self, fall: Fall) -> None:
        self.fall, self._since_s = fall, self._now_s
        self._note("fall", fall.name)

    def _stand(self) -> None:
        if any(self.twist):
            self._note("twist", "0 0 0")
        self.twist = (0.0, 0.0, 0.0)

    # -- time

    def advance(self, now_s: float) -> None:
        passed_s = min(now_s - self._now_s, 0.25) if self._now_s else 0.0
        self._now_s = now_s
        self._control(passed_s)
        self.body.catch_up(now_s)
        self._watch(now_s)

    def step(self, seconds: float) -> None:
        """Let the onboard controller command the motors, and advance the physics by one time step."""
        self._control(seconds)
        self.body.step(1)

    def _control(self, passed_s: float) -> None:
        most = TURN_RAD_S * passed_s
        for slot in range(LAST_ARM + 1):
            self._target[slot] += max(-most, min(most, self._goal[slot] - self._target[slot]))
        if any(self.twist):
            vx, vy, vyaw = self.twist
            self.body.carry(vx, vy, vyaw, passed_s)
            x, y, heading = self.odometer
            ahead, aside = vx * passed_s, vy * passed_s
            self.odometer = Odometer(
                x + math.cos(heading) * ahead - math.sin(heading) * aside,
                y + math.sin(heading) * ahead + math.cos(heading) * aside,
                heading + vyaw * passed_s,
            )
        self.body.drive(*self._drives())

    def _drives(self) -> tuple[Row, Row, Row, Row, Row]:
        """Return the commands that act on the motors now, the host's or else the onboard controller's, as one row
        each of q, dq, tau, kp and kd."""
        rows = [self._own(slot) for slot in range(len(self.model.motors))]
        command = self._command
        if command is not None:
            for slot in range(min(len(rows), len(command.motors))):
                if self.mode is Mode.CUSTOM or slot in ARMS:
                    motor = command.motors[slot]
                    row = motor.q, motor.dq, motor.tau, motor.kp, motor.kd
                    # A motor whose command has a number that is not finite gets no torque [assumed].
                    rows[slot] = row if all(map(math.isfinite, row)) else (0.0,) * len(row)
        q, dq, tau, kp, kd = zip(*rows, strict=True)
        return q, dq, tau, kp, kd

    def _own(self, slot: int) -> Row:
        """Return the command that the onboard controller gives to one motor: q, dq, tau, kp, kd."""
        if self.mode not in (*STANDS, Mode.CUSTOM) or self.fall is not Fall.IS_READY:
            return 0.0, 0.0, 0.0, 0.0, DAMPING
        if slot <= LAST_ARM:
            return self._target[slot], 0.0, 0.0, SWAY_KP, SWAY_KD
        return self._home[slot], 0.0, 0.0, STAND_KP, STAND_KD

    def _watch(self, now_s: float) -> None:
        """Advance the simulated fall by one step: falling, lying on the ground, getting up."""
        match self.fall:
            case Fall.IS_READY if self.body.fallen and self.mode is not Mode.DAMPING:
                self.set_mode(Mode.DAMPING)
                self._set_fall(Fall.IS_FALLING)
            case Fall.IS_FALLING if now_s - self._since_s > FALLING_S:
                self._set_fall(Fall.HAS_FALLEN)
            case Fall.IS_GETTING_UP if now_s - self._since_s > GETTING_UP_S:
                self.set_mode(Mode.WALKING)
                self._set_fall(Fall.IS_READY)

    # -- reports

    def state(self) -> State:
        body = self.body
        return State(
            roll_pitch_yaw(body.orientation_wxyz),
            body.gyro_rad_s,
            body.acceleration_m_s2,
            body.position_rad,
            body.velocity_rad_s,
            body.effort_nm,
            (ROOM_C,) * len(self.model.motors),
        )

    @property
    def battery(self) -> Battery:
        return Battery(50.0, -2.0, self.percent, 50.0)

    # -- the service

    def serve(self, request: Request) -> Response:
        try:
            status, result = self._serve(request.api, rpc.parsed(request.body))
        except MalformedFrame:
            status, result = rpc.BAD_REQUEST, None
        return Response(request.id, status, "" if result is None else json.dumps(result))

    def _serve(self, api: int, body: dict[str, Any]) -> tuple[int, Any]:
        if api not in REQUESTS:
            return rpc.REFUSED, None
        match api:
            case Api.GET_MODE:
                return rpc.OK, {"mode": int(self.mode)}
            case Api.GET_STATUS:
                return rpc.OK, {"current_mode": int(self.mode), "current_body_control": 0, "current_actions": []}
            case Api.GET_ROBOT_INFO:
                fields = ("nickname", "version", "model", "serial_number", "edition", "region")
                return rpc.OK, {"name": NAME, **dict.fromkeys(fields, "")}
            case Api.CHANGE_MODE:
                mode = rpc.mode_of(json.dumps(body))
                if mode is Mode.UNKNOWN:
                    return rpc.BAD_REQUEST, None
                if self.fall is not Fall.IS_READY and mode is not Mode.DAMPING:
                    return rpc.TRANSITION_FAILED, None
                self.set_mode(mode)
                return rpc.OK, None
            case Api.MOVE:
                return self._move(tuple(rpc.number_in(body, name) for name in BASE))
            case Api.ROTATE_HEAD:
                return self._rotate_head(rpc.number_in(body, "pitch"), rpc.number_in(body, "yaw"))
            case Api.UPPER_BODY:
                return self._hand_over(body.get("start"))
            case Api.GET_UP:
                if self.fall is not Fall.HAS_FALLEN:
                    return rpc.CONFLICT, None
                self.get_up()
                return rpc.OK, None
            case Api.RESET_ODOMETRY:
                # The vendor's client has two calls: without a body, and with a pose.
                pose = tuple(rpc.number_in(body, name) for name in ("x", "y", "theta")) if body else (0.0, 0.0, 0.0)
                self.odometer = Odometer(*pose)
                return rpc.OK, None
            case Api.GET_FRAME_TRANSFORM:
                transform = transform_between(self.body, body.get("src"), body.get("dst"))
                return (rpc.BAD_REQUEST, None) if transform is None else (rpc.OK, transform)
            case Api.GET_SENSORS | Api.GET_HANDS | Api.GET_ROBOT_MODEL:
                return rpc.OK, device_info(self.model, self.body, api)
        return rpc.REFUSED, None

    def _move(self, twist: Row) -> tuple[int, Any]:
        if self.mode not in WALKS or self.fall is not Fall.IS_READY:
            return rpc.TRANSITION_FAILED, None
        self.twist = twist
        return rpc.OK, None

    def _rotate_head(self, pitch_rad: float, yaw_rad: float) -> tuple[int, Any]:
        if self.mode not in STANDS:
            return rpc.TRANSITION_FAILED, None
        pitch, yaw = self._head
        self._goal[pitch], self._goal[yaw] = pitch_rad, yaw_rad
        return rpc.OK, None

    def _hand_over(self, start: object) -> tuple[int, Any]:
        if not isinstance(start, bool):
            return rpc.BAD_REQUEST, None
        if not start:
            self.take_back()
        elif self.mode not in STANDS or self.fall is not Fall.IS_READY:
            return rpc.TRANSITION_FAILED, None
        else:
            self.host_has_arms, self.simulated = True, False
            self._note("upper_body", "host")
        return rpc.OK, None
