"""Answer the requests to the nine services of the simulated Spot, all on one port."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from strands_actors.drivers.common.codecs.malformed import MalformedFrame
from strands_actors.drivers.common.physics.body import Commander
from strands_actors.drivers.common.twin import Fault, Faults
from strands_actors.drivers.common.twin.grpc import ServerCall
from strands_actors.drivers.spot import protocol as p
from strands_actors.drivers.spot.messages import Message, decode, encode
from strands_actors.drivers.spot.protocol import Motors
from strands_actors.drivers.spot.robots import LEGS, TABLES, wire_name

from .body import SpotBody
from .mechanism import JOINTS, Mechanism
from .requests import COMMANDS, METHODS, names_of
from .safety import Estop, Leases

SKEW_S = 123.456
"""How far the robot's clock is ahead of the host's, by default."""
TOO_DISTANT_S = 600.0
WRONG_PASSWORD = "wrong"
WRONG_M_S = 0.5
"""Error of the reported speed of a robot with wrong readings."""
TOKEN = "twin-token"
CLOCK = "twin-clock"
_PATHS: Mapping[str, p.Method] = {method.path: method for method in p.METHODS.values()}

NOT_CLEARED = 2
"""Answer to a request to clear a fault of the behaviour, of which this robot has none."""

_UNNAMED = "unnamed"
Logged = tuple[str, str | None]


class SpotTwin:
    """One simulated robot, which all clients share.

    Args:
        robot: Name of the robot.
        now_s: The monotonic clock.
        skew_s: How far the robot's clock is ahead of the host's.
        sync_s: For how long after the first request the robot has no time estimate yet.
        arm: True if the robot has an arm.
        wall_ns: The host's clock.
    """

    def __init__(
        self,
        robot: str = "spot",
        now_s: Callable[[], float] = time.monotonic,
        *,
        skew_s: float = SKEW_S,
        sync_s: float = 0.0,
        arm: bool = True,
        wall_ns: Callable[[], int] = time.time_ns,
    ) -> None:
        table = TABLES.table(robot)
        self.mechanism = Mechanism(table, now_s)
        self.body = SpotBody(self.mechanism, table)
        self.estop = Estop(now_s)
        self.leases = Leases()
        self.faults = Faults()
        self.muted: set[str] = set()
        """Methods that are carried out and never answered."""
        self._now_s = now_s
        self._wall_ns = wall_ns
        self._skew_s = skew_s
        self._sync_s = sync_s
        self._has_arm = arm
        self._sync_since_s: float | None = None
        self._command = 0
        self._stuck: Message | None = None

    # -- faults

    def set_fault(self, fault: Fault, unit: int | None = None) -> None:
        """Inject a fault. ``unit`` is ignored, because this robot has no units that can fail
        separately."""
        self.mechanism.pass_time()
        self._stuck = self.state() if fault is Fault.STUCK else None
        self.mechanism.stuck = fault is Fault.STUCK
        self.faults.set(fault)
        if fault is Fault.OFF:
            self.power_cycle()

    def power_cycle(self) -> None:
        """Restart as after a boot: no client has the lease, and there is no endpoint."""
        self.mechanism.reset()
        self.estop, self.leases = Estop(self._now_s), Leases()

    def order(self, words: Sequence[str]) -> bool:
        """Carry out a control line of this simulated robot."""
        match words:
            case ["steal", owner]:
                self.leases.acquire(owner, take=True)
            case ["press"]:
                self.estop.pressed = True
            case ["release"]:
                self.estop.pressed = False
            case ["mute", *methods]:
                self.muted = set(methods)
            case _:
                return False
        return True

    def pass_time(self) -> None:
        """Advance the simulation to the present time, and apply the present level of the e-stop."""
        self.mechanism.pass_time()
        level = self.estop.level
        if self.mechanism.commander is Commander.SIM or self.mechanism.motors is Motors.OFF:
            return
        if level is p.StopLevel.CUT:
            self.mechanism.cut()
        elif level is p.StopLevel.SETTLE_THEN_CUT:
            self.mechanism.settle()

    # -- methods that the gRPC server calls

    def called(self, call: ServerCall) -> bool:
        method = _PATHS.get(call.path)
        return method is not None and method.name in METHODS

    def message(self, call: ServerCall, t_ns: int, message: bytes) -> None:
        if self.faults.of(None) is Fault.OFF:
            return
        method = _PATHS[call.path]
        request = decode(method.request, message)
        self.pass_time()
        reply, (kind, safe_state) = self.answer(method.name, request)
        call.log_received(t_ns, kind, message, safe_state)
        if method.name not in self.muted:
            call.answer(encode(method.reply, {"header": self._header(request), **reply}))

    def over(self, call: ServerCall) -> None:
        """Do nothing when a call has ended, because no state is kept for it."""

    def answer(self, name: str, request: Message) -> tuple[Message, Logged]:
        """Carry out a request. Return the reply, and the kind of the request for the log of
        messages. Raise ``MalformedFrame``."""
        client = request.get("header", {}).get("client_name", _UNNAMED)
        lease = request.get("lease", {})
        match name:
            case "GetAuthToken":
                return self._log_in(request), ("config", None)
            case "GetRobotId":
                return {"robot_id": _IDENTITY}, ("read", None)
            case "ListServiceEntries":
                return {"service_entries": [_entry(service) for service in p.SERVICES]}, ("read", None)
            case "GetServiceEntry":
                is_known = request.get("service_name") in p.SERVICES
                entry = {"service_entry": _entry(request["service_name"])} if is_known else {}
                return {"status": p.OK if is_known else 2, **entry}, ("read", None)
            case "TimeSyncUpdate":
                return self._sync(request), ("config", None)
            case "AcquireLease" | "TakeLease":
                return self.leases.acquire(client, name == "TakeLease"), ("config", None)
            case "ReturnLease":
                return {"status": self.leases.give_back(lease)}, ("config", None)
            case "RetainLease":
                return {"lease_use_result": self.leases.use(lease)}, ("config", None)
            case "ListLeases":
                return {"resources": [self.leases.listed()]}, ("read", None)
            case "GetRobotState":
                return {"robot_state": self._stuck or self.state()}, ("read", None)
            case "PowerCommand":
                reply = self._power(request, lease)
                is_accepted = reply.get("status") in (p.Power.SUCCESS, p.Power.IN_PROGRESS)
                return reply, ("enable" if is_accepted else "other", None)
            case "PowerCommandFeedback":
                return {"status": int(self._power_status())}, ("read", None)
            case "RobotCommand":
                return self._carry_out(request, lease)
            case "RobotCommandFeedback":
                return {"feedback": self._feedback(request), "lease_use_result": {"status": p.OK}}, ("read", None)
            case "ClearBehaviorFault":
                return {"lease_use_result": self.leases.use(lease), "status": NOT_CLEARED}, ("config", None)
        return self._answer_estop(name, request)

    def _answer_estop(self, name: str, request: Message) -> tuple[Message, Logged]:
        is_on = self.mechanism.motors is not Motors.OFF
        match name:
            case "SetEstopConfig":
                reply = self.estop.set_config(request.get("config", {}), request.get("target_config_id", ""), is_on)
            case "GetEstopConfig":
                return {"active_config": self.estop.config}, ("read", None)
            case "RegisterEstopEndpoint":
                reply = self.estop.register(request.get("new_endpoint", {}), request.get("target_config_id", ""))
            case "DeregisterEstopEndpoint":
                reply = {"status": self.estop.deregister(request.get("target_endpoint", {}), is_on)}
            case "GetEstopSystemStatus":
                return {"status": self.estop.status()}, ("read", None)
            case _:
                if request.get("stop_level") not in tuple(p.StopLevel):
                    raise MalformedFrame(f"stop level {request.get('stop_level')}")
                reply = self.estop.check_in(request)
                self.pass_time()
                return {"request": request, **reply}, _logged_check_in(request, reply)
        return {"request": request, **reply}, ("config", None)

    def _header(self, request: Message) -> Message:
        stamp = p.stamp(self.robot_ns())
        return {
            "request_header": request.get("header", {}),
            "request_received_timestamp": stamp,
            "response_timestamp": stamp,
            "error": {"code": p.OK},
        }

    # -- time, login

    def robot_ns(self) -> int:
        return self._wall_ns() + round(self._skew_s * p.NS)

    def _log_in(self, request: Message) -> Message:
        if request.get("token") == TOKEN:
            return {"status": p.OK, "token": TOKEN}
        if not request.get("username") or request.get("password") in ("", None, WRONG_PASSWORD):
            return {"status": 2}
        return {"status": p.OK, "token": TOKEN}

    def _sync(self, request: Message) -> Message:
        now_s = self._now_s()
        if self._sync_since_s is None:
            self._sync_since_s = now_s
        reply: Message = {"clock_identifier": CLOCK, "state": {"status": 2}}
        trip = request.get("previous_round_trip")
        if trip is None:
            return reply
        client_tx, server_rx, server_tx, client_rx = (
            p.stamp_ns(trip.get(key, {})) for key in ("client_tx", "server_rx", "server_tx", "client_rx")
        )
        round_trip_ns = client_rx - client_tx - (server_tx - server_rx)
        skew_ns = (server_rx - client_tx + server_tx - client_rx) // 2
        estimate = {"round_trip_time": p.stamp(round_trip_ns), "clock_skew": p.stamp(skew_ns)}
        if now_s - self._sync_since_s < self._sync_s:
            return {**reply, "previous_estimate": estimate}
        state = {"best_estimate": estimate, "status": p.OK, "measurement_time": p.stamp(self.robot_ns())}
        return {"clock_identifier": CLOCK, "previous_estimate": estimate, "state": state}

    # -- power

    def _power(self, request: Message, lease: Message) -> Message:
        use = self.leases.use(lease)
        if use["status"] != p.OK:
            return {"lease_use_result": use}
        if request.get("request") == p.POWER_OFF:
            self.mechanism.cut()
            status = p.Power.SUCCESS
        elif request.get("request") != p.POWER_ON:
            status = p.Power.INTERNAL_ERROR
        elif self.estop.level is not p.StopLevel.NONE:
            status = p.Power.ESTOPPED
        else:
            self.mechanism.power_on()
            status = self._power_status()
        return {"lease_use_result": use, "status": int(status), "power_command_id": 1, "license_status": 1}

    def _power_status(self) -> p.Power:
        match self.mechanism.motors:
            case Motors.ON:
                return p.Power.SUCCESS
            case Motors.POWERING_ON:
                return p.Power.IN_PROGRESS
        return p.Power.OVERRIDDEN

    # -- commands

    def _carry_out(self, request: Message, lease: Message) -> tuple[Message, Logged]:
        command = request.get("command", {})
        kind, safe_state = _kind_of(command)
        use = self.leases.use(lease)
        reply: Message = {"lease_use_result": use}
        if use["status"] == p.OK:
            self._command += 1
            status = self._status_of(command, request.get("clock_identifier", ""))
            reply |= {"status": int(status), "robot_command_id": self._command}
        if kind == "safe" and reply.get("status") not in (p.Command.OK, p.Command.NOT_POWERED_ON):
            safe_state = ""
        is_unsupported = reply.get("status") == p.Command.UNSUPPORTED
        if is_unsupported or (kind == "enable" and reply.get("status") != p.Command.OK):
            # The robot has refused the command, so it enabled nothing.
            kind = "other"
        return reply, (kind, safe_state)

    def _status_of(self, command: Message, clock: str) -> p.Command:
        mechanism, whole, parts = (
            self.mechanism,
            command.get("full_body_command", {}),
            command.get("synchronized_command", {}),
        )
        names = list(names_of(command))
        has_arm_command = "arm_command" in parts or "gripper_command" in parts
        if any(name not in COMMANDS for name in names) or (has_arm_command and not self._has_arm):
            return p.Command.UNSUPPORTED
        if not names:
            return p.Command.INVALID_REQUEST
        if "safe_power_off_request" in whole:
            mechanism.settle()
            return p.Command.OK
        if mechanism.motors is not Motors.ON or self.estop.level is not p.StopLevel.NONE:
            return p.Command.NOT_POWERED_ON
        base, arm = parts.get("mobility_command", {}), parts.get("arm_command", {})
        if "stop_request" in whole or "stop_request" in base:
            mechanism.halt()
            return p.Command.OK
        goals = self._goals(parts)
        if "arm_stop_command" in arm:
            goals = dict(enumerate(mechanism.joints[:-1])) | goals
        if (arm or "gripper_command" in parts) and not goals:
            return p.Command.INVALID_REQUEST
        if "stand_request" in base:
            mechanism.stand(Commander.WIRE)
        if "sit_request" in base:
            mechanism.sit()
        if "se2_velocity_request" in base:
            status = self._walk(base["se2_velocity_request"], clock)
            if status is not p.Command.OK:
                return status
        if goals:
            mechanism.reach(goals, Commander.WIRE)
        return p.Command.OK

    def _walk(self, request: Message, clock: str) -> p.Command:
        if clock != CLOCK:
            return p.Command.NO_TIMESYNC
        remaining_s = (p.stamp_ns(request.get("end_time", {})) - self.robot_ns()) / p.NS
        if remaining_s <= 0:
            return p.Command.EXPIRED
        if remaining_s > TOO_DISTANT_S:
            return p.Command.TOO_DISTANT
        velocity = request.get("velocity", {})
        speeds = (velocity.get("linear", {}).get("x", 0.0), velocity.get("linear", {}).get("y", 0.0))
        twist = (float(speeds[0]), float(speeds[1]), float(velocity.get("angular", 0.0)))
        if not all(math.isfinite(speed) for speed in twist):
            return p.Command.INVALID_REQUEST
        self.mechanism.walk(twist, remaining_s, Commander.WIRE)
        return p.Command.OK

    @staticmethod
    def _goals(parts: Message) -> dict[int, float]:
        move = parts.get("arm_command", {}).get("arm_joint_move_command", {}).get("trajectory", {})
        goals: dict[int, float] = {}
        for point in move.get("points", ())[-1:]:
            for index, name in enumerate(("sh0", "sh1", "el0", "el1", "wr0", "wr1")):
                if name in point.get("position", {}):
                    goals[index] = float(point["position"][name].get("value", 0.0))
        claw = parts.get("gripper_command", {}).get("claw_gripper_command", {}).get("trajectory", {})
        for point in claw.get("points", ())[-1:]:
            goals[len(JOINTS) - 1] = float(point.get("point", 0.0))
        return {index: goal for index, goal in goals.items() if math.isfinite(goal)}

    def _feedback(self, request: Message) -> Message:
        overridden = request.get("robot_command_id", 0) < self._command
        stands, sits = self.mechanism.stands, self.mechanism.up == 0.0
        mobility = {
            "status": 2 if overridden else 1,
            "stand_feedback": {"status": 1 if stands else 2, "standing_state": 1},
        }
        if not self.mechanism.wants_up:
            mobility = {"status": mobility["status"], "sit_feedback": {"status": 1 if sits else 2}}
        arm = {"status": 1, "arm_joint_move_feedback": {"status": 1 if self.mechanism.arrived else 2}}
        return {"synchronized_feedback": {"mobility_command_feedback": mobility, "arm_command_feedback": arm}}

    # -- reports

    def state(self) -> Message:
        """Return the robot's present state."""
        mechanism = self.mechanism
        vx, vy, wz = mechanism.present_twist
        if self.faults.of(None) is Fault.WRONG:
            vx += WRONG_M_S
        cos, sin = math.cos(mechanism.yaw_rad), math.sin(mechanism.yaw_rad)
        x, y, z = mechanism.x_m, mechanism.y_m, mechanism.height_m
        half = -mechanism.yaw_rad / 2
        in_body = {
            "position": {"x": -x * cos - y * sin, "y": x * sin - y * cos, "z": -z},
            "rotation": {"w": math.cos(half), "z": math.sin(half)},
        }
        speed = {"linear": {"x": vx * cos - vy * sin, "y": vx * sin + vy * cos}, "angular": {"z": wz}}
        edges = [
            {"key": "body", "value": {"parent_frame_name": "", "parent_tform_child": {"rotation": {"w": 1.0}}}},
            {"key": "odom", "value": {"parent_frame_name": "body", "parent_tform_child": in_body}},
            {"key": "vision", "value": {"parent_frame_name": "body", "parent_tform_child": in_body}},
        ]
        level = self.estop.level
        return {
            "power_state": {
                "timestamp": p.stamp(self.robot_ns()),
                "motor_power_state": int(mechanism.motors),
                "shore_power_state": 2,
                "robot_power_state": 1,
            },
            "battery_states": [
                {
                    "identifier": "twin",
                    "charge_percentage": {"value": 77.0},
                    "voltage": {"value": 55.0},
                    "status": 3,
                }
            ],
            "estop_states": [
                {"name": "hardware_estop", "type": 1, "state": 1 if self.estop.pressed else 2},
                {"name": "software_estop", "type": 2, "state": 2 if level is p.StopLevel.NONE else 1},
            ],
            "kinematic_state": {
                "acquisition_timestamp": p.stamp(self.robot_ns()),
                "joint_states": self._joints(),
                "velocity_of_body_in_vision": speed,
                "velocity_of_body_in_odom": speed,
                "transforms_snapshot": {"edges": edges},
            },
            **({"manipulator_state": mechanism.arm_state()} if self._has_arm else {}),
        }

    def _joints(self) -> list[Message]:
        mechanism = self.mechanism
        joints = {wire_name(key): (mechanism.leg_rad[index % 3], 0.0) for index, key in enumerate(LEGS)}
        if self._has_arm:
            both = zip(JOINTS, mechanism.joints, mechanism.speeds, strict=True)
            joints |= {wire_name(key): (position, speed) for key, position, speed in both}
        return [
            {"name": name, "position": {"value": position}, "velocity": {"value": speed}}
            for name, (position, speed) in joints.items()
        ]


def _entry(service: str) -> Message:
    return {
        "name": service,
        "type": f"bosdyn.api.{p.SERVICES[service]}",
        "authority": p.AUTHORITIES.get(service, p.AUTHORITIES["directory"]),
        "user_token_required": service not in ("auth", "robot-id"),
    }


def _kind_of(command: Message) -> Logged:
    """Return the kind of a command and the safe state that it causes, for the log of messages."""
    whole, parts = command.get("full_body_command", {}), command.get("synchronized_command", {})
    base = parts.get("mobility_command", {})
    if "safe_power_off_request" in whole:
        return "safe", "settle"
    if "stop_request" in whole or "stop_request" in base:
        return "safe", "hold"
    if "stand_request" in base or "sit_request" in base:
        return "enable", None
    return "setpoint", None


def _logged_check_in(request: Message, reply: Message) -> Logged:
    level = request["stop_level"]
    if level == p.StopLevel.NONE or reply["status"] != p.CheckIn.OK:
        return "other", None
    return "safe", "off" if level == p.StopLevel.CUT else "settle"


_IDENTITY: dict[str, Any] = {
    "serial_number": "spot-twin",
    "species": "spot",
    "version": "V3",
    "nickname": "twin",
    "software_release": {"version": {"major_version": 5, "minor_version": 2, "patch_level": 0}},
}
