"""Simulate the base (controller) of a Gen3: its sessions, its state and its arm.

This module has no sockets, and takes the time from a function that its creator passes. It simulates the worst
case: commanded joint speeds never expire, and the end of a connection or of a session does not stop the arm.
"""

from __future__ import annotations

import enum
import math
import time
from collections.abc import Callable, Mapping
from typing import Any

from strands_actors.drivers.common.codecs.malformed import MalformedFrame
from strands_actors.drivers.common.physics.physics import Plant
from strands_actors.drivers.common.twin import Fault
from strands_actors.drivers.common.twin.modelled import Modelled

from . import protocol as p
from .protocol import ArmState, Call, Frame, ServoingMode, SubError

SUBSTEP_S = 0.004
LONGEST_S = 0.25
"""Longest pause of this process for which the simulation catches up. The rest of a longer pause is dropped."""

FRAMES_HZ = 1000
"""Control cycles per second. Each cycle has a new measurement and a frame number."""

SUPPLY_V, ROOM_C, AMPERE_PER_NM = 24.0, 30.0, 0.1
"""Values for the simulated measurements of supply, temperature and current [assumed]."""

ALL = range(p.JOINTS)


CALLS: Modelled[int] = Modelled(
    "calls of the base",
    {
        Call.CREATE_SESSION: "opens a session; an error for a wrong user or password",
        Call.CLOSE_SESSION: "closes the session",
        Call.KEEP_ALIVE: "keeps the session",
        Call.STOP: "stops the arm",
        Call.SEND_JOINT_SPEEDS: "turns the joints; an error in a wrong mode or state, or for too fast speeds",
        Call.APPLY_EMERGENCY_STOP: "stops the arm in the state of a fault",
        Call.CLEAR_FAULTS: "ends the state of a fault",
        Call.SET_SERVOING_MODE: "stores the mode and stops the arm",
        Call.GET_SERVOING_MODE: "returns the mode",
        Call.GET_ACTUATOR_COUNT: "returns the number of joints",
        Call.GET_ARM_STATE: "returns the state",
        Call.REFRESH_FEEDBACK: "returns the readings of base and joints",
    },
    "an error of the server, UNSUPPORTED_METHOD",
)


class Second(enum.StrEnum):
    """How the simulated base reacts to a second session. The reaction of a real base is unknown."""

    ACCEPTED = "accepted"
    REFUSED = "refused"
    POWERLESS = "powerless"  # The session is accepted, but it may only read.


class CallFailed(Exception):
    """Raised in the simulated base if it must answer a call with an error."""

    def __init__(self, sub_error: SubError) -> None:
        self.sub_error = sub_error


class BaseSession:
    """One client's session with the simulated base (the arm's controller). The base accepts its calls only on the
    connection that opened the session."""

    def __init__(self, number: int, connection: object, login: p.Login, now_s: float) -> None:
        self.number = number
        self.connection = connection
        self.lifetime_s = min(login.session_ms, login.connection_ms) / 1e3
        self.last_request_s = now_s


class Base:
    def __init__(
        self,
        table: Mapping[str, Any],
        *,
        username: str = "admin",
        password: str = "admin",
        second: Second = Second.ACCEPTED,
        now_s: Callable[[], float] = time.monotonic,
        plant: Plant | None = None,
    ) -> None:
        """Build the base from ``table``, the robot's table in ``robots.toml``. ``plant`` is its arm; None for the
        one of the table."""
        self.plant = plant or Plant.from_table(table)
        self.now_s = now_s
        self._login = username, password
        self._stop_channel = second
        self._acceleration = float(table["acceleration_rad_s2"])
        self._fastest = [float(joint["speed_rad_s"]) for joint in table["joints"]]
        self._sessions: dict[int, BaseSession] = {}
        self._number = 0
        self.wake_up()

    def wake_up(self) -> None:
        """Reset to the state after power-on: ready for commands. The arm stays where it is."""
        self.state = ArmState.SERVOING_READY
        self.mode = ServoingMode.SINGLE_LEVEL
        self.fault = Fault.OK
        self.fault_bank = 0
        self.driven = False  # True once a client has sent joint speeds since the last stop.
        self.simulation_moves = False  # True while a simulation, not a Kortex client, sets the arm's targets.
        self._speeds = [0.0] * p.JOINTS  # Commanded joint speeds in rad/s.
        self._rates = [0.0] * p.JOINTS  # Present joint speeds in rad/s. They approach the commanded speeds.
        self._sessions.clear()
        self._woken_s = self._advanced_s = self.now_s()
        for joint in ALL:
            self.plant.set_torque(joint, True)
        self.halt()
        self._target = list(self.plant.position_rad)
        self.felt = self.feedback()

    # -- the arm

    def set_state(self, state: ArmState) -> None:
        """Set the state of the base. Every state except ``SERVOING_READY`` halts the arm."""
        self.state = state
        self.fault_bank = 1 if state is ArmState.IN_FAULT else 0
        if state is not ArmState.SERVOING_READY:
            self.halt()

    def set_fault(self, fault: Fault) -> None:
        """Inject a fault. With ``STUCK``, the worst case, the feedback repeats while the arm still moves."""
        self.felt = self.feedback()
        self.fault = fault
        for joint in ALL:
            self.plant.set_stuck(joint, fault is Fault.OFF)

    def halt(self) -> None:
        """Decelerate and hold the position."""
        self._speeds = [0.0] * p.JOINTS
        self.driven = False

    def set_targets(self, rad: list[float]) -> None:
        """Move the joints to a target (rad) that a simulation has set."""
        self._target = rad
        for joint, value in enumerate(rad):
            self.plant.set_target(joint, value)

    def advance(self) -> None:
        """Simulate the arm up to the present time. It keeps turning at the commanded speeds until a stop."""
        now_s = self.now_s()
        self._advanced_s = max(self._advanced_s, now_s - LONGEST_S)
        while (remaining_s := now_s - self._advanced_s) > 0 and (any(self._rates) or any(self._speeds)):
            step_s = min(SUBSTEP_S, remaining_s)
            self._turn(step_s)
            self._advanced_s += step_s
            self.plant.catch_up(self._advanced_s)
        self._advanced_s = now_s
        self.plant.catch_up(now_s)

    def _turn(self, seconds: float) -> None:
        most = self._acceleration * seconds
        for joint in ALL:
            rate = self._rates[joint]
            self._rates[joint] = rate = rate + max(-most, min(most, self._speeds[joint] - rate))
            self._target[joint] += rate * seconds
            self.plant.set_target(joint, self._target[joint])

    def feedback(self) -> p.Feedback:
        """Return the measurements of the arm. An injected fault repeats or falsifies them."""
        if self.fault is Fault.STUCK:
            return self.felt
        plant, wrong = self.plant, self.fault is Fault.WRONG
        joints = zip(plant.position_rad, plant.velocity_rad_s, plant.effort_nm, strict=True)
        actuators = tuple(
            p.Actuator(
                math.degrees(rad + 0.5 * wrong) % 360.0,
                math.degrees(rad_s),
                nm,
                nm * AMPERE_PER_NM,
                ROOM_C,
                ROOM_C,
            )
            for rad, rad_s, nm in joints
        )
        x, y, z = self.plant.data.body("bracelet").xpos.tolist()
        frame = round((self.now_s() - self._woken_s) * FRAMES_HZ) & 0xFFFF_FFFF
        return p.Feedback(self.state, actuators, SUPPLY_V, (x, y, z), (self.fault_bank, 0), frame)

    # -- calls

    def answer(self, connection: object, request: Frame) -> Frame:
        """Return the response to a request that arrived on ``connection``."""
        self.advance()
        session = request.session
        try:
            if request.call == Call.CREATE_SESSION:
                session, payload = self._create(connection, p.Login.decode(request.payload)), b""
            else:
                payload = self._call(self._session(connection, request), request)
        except MalformedFrame:
            return self._failed(request, SubError.INVALID_PARAM)
        except CallFailed as failed:
            return self._failed(request, failed.sub_error)
        return Frame(p.Kind.RESPONSE, request.call, request.message, session, payload)

    def kind(self, request: Frame) -> str:
        """Return the kind of a request as the log of received messages (wire log) names it: ``setpoint``,
        ``safe``, ``read``, and so on."""
        match request.call:
            case Call.STOP | Call.APPLY_EMERGENCY_STOP:
                return "safe"
            case Call.SEND_JOINT_SPEEDS:
                return "setpoint" if self.driven or any(_speeds_of(request).values()) else "enable"
            case Call.REFRESH_FEEDBACK | Call.GET_ARM_STATE | Call.GET_SERVOING_MODE | Call.GET_ACTUATOR_COUNT:
                return "read"
            case Call.KEEP_ALIVE:
                return "keepalive"
            case _:
                return "config"

    def _failed(self, request: Frame, sub_error: SubError) -> Frame:
        return Frame(
            p.Kind.RESPONSE, request.call, request.message, request.session, b"", p.ERROR_OF_SERVER, int(sub_error)
        )

    def _create(self, connection: object, login: p.Login) -> int:
        if login.username != self._login[0]:
            raise CallFailed(SubError.USER_NOT_FOUND)
        if login.password != self._login[1]:
            raise CallFailed(SubError.INVALID_PASSWORD)
        self._forget_silent()
        if self._sessions and self._stop_channel is Second.REFUSED:
            raise CallFailed(SubError.METHOD_FAILED)
        self._number = self._number % 0xFFFF + 1
        self._sessions[self._number] = BaseSession(self._number, connection, login, self.now_s())
        return self._number

    def _session(self, connection: object, request: Frame) -> BaseSession:
        self._forget_silent()
        session = self._sessions.get(request.session)
        if session is None or session.connection is not connection:
            raise CallFailed(SubError.INVALID_SESSION)
        session.last_request_s = self.now_s()
        return session

    def _forget_silent(self) -> None:
        now_s = self.now_s()
        for number, session in list(self._sessions.items()):
            if now_s - session.last_request_s > session.lifetime_s:
                del self._sessions[number]

    def _call(self, session: BaseSession, request: Frame) -> bytes:
        if request.call not in CALLS:
            raise CallFailed(SubError.UNSUPPORTED_METHOD)
        first = min(self._sessions) == session.number
        harmless = self.kind(request) in ("read", "keepalive") or request.call == Call.CLOSE_SESSION
        if not first and self._stop_channel is Second.POWERLESS and not harmless:
            raise CallFailed(SubError.METHOD_FAILED)
        match request.call:
            case Call.KEEP_ALIVE:
                pass
            case Call.CLOSE_SESSION:
                del self._sessions[session.number]
            case Call.REFRESH_FEEDBACK:
                return self.feedback().encode()
            case Call.GET_ARM_STATE:
                return p.encode_number(self.state)
            case Call.GET_SERVOING_MODE:
                return p.encode_number(self.mode)
            case Call.GET_ACTUATOR_COUNT:
                return p.encode_number(p.JOINTS)
            case Call.SET_SERVOING_MODE:
                self._set_mode(p.decode_number(request.payload))
            case Call.STOP:
                self.halt()
            case Call.APPLY_EMERGENCY_STOP:
                self.set_state(ArmState.IN_FAULT)
            case Call.CLEAR_FAULTS:
                self.set_state(ArmState.SERVOING_READY)
            case Call.SEND_JOINT_SPEEDS:
                self._drive(p.decode_speeds(request.payload))
        return b""

    def _set_mode(self, mode: int) -> None:
        if mode not in tuple(ServoingMode):
            raise CallFailed(SubError.INVALID_PARAM)
        self.mode = ServoingMode(mode)
        self.halt()

    def _drive(self, deg_s: Mapping[int, float]) -> None:
        if self.state is not ArmState.SERVOING_READY:
            in_fault = self.state is ArmState.IN_FAULT
            raise CallFailed(SubError.ROBOT_IN_FAULT if in_fault else SubError.ROBOT_NOT_READY)
        if self.mode is not ServoingMode.SINGLE_LEVEL:
            raise CallFailed(SubError.WRONG_MODE)
        if any(joint not in ALL for joint in deg_s):
            raise CallFailed(SubError.INVALID_PARAM)
        speeds = {joint: math.radians(value) for joint, value in deg_s.items()}
        if not all(math.isfinite(value) for value in speeds.values()):
            raise CallFailed(SubError.INVALID_SPEED)
        if any(abs(value) > self._fastest[joint] for joint, value in speeds.items()):
            raise CallFailed(SubError.LARGE_SPEED)
        if not self.driven:
            self._target = list(self.plant.position_rad) if self.simulation_moves else self._target
            self.driven, self.simulation_moves = True, False
        for joint, value in speeds.items():
            self._speeds[joint] = value


def _speeds_of(request: Frame) -> Mapping[int, float]:
    """Return the joint speeds in a request, by joint. Empty if the request cannot be decoded."""
    try:
        return p.decode_speeds(request.payload)
    except MalformedFrame:
        return {}
