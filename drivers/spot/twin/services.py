"""Answer the requests to the services of the simulated Spot, all on one port."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence

from strands_actors.drivers.common.codecs.malformed import MalformedFrame
from strands_actors.drivers.common.physics.body import Commander
from strands_actors.drivers.common.twin import Fault, TwinRobot
from strands_actors.drivers.common.twin.grpc import ServerCall
from strands_actors.drivers.spot import protocol as p
from strands_actors.drivers.spot.config import TWIN_LOGIN
from strands_actors.drivers.spot.messages import Message, decode, encode
from strands_actors.drivers.spot.protocol import Motors
from strands_actors.drivers.spot.robots import TABLES

from .body import SpotBody
from .cameras import ImageService
from .commands import CLOCK, Commands, kind_of
from .directory import Directory
from .faults import Cause, RobotFaults
from .login import Logins
from .mechanism import Mechanism
from .reports import IDENTITY, Reports
from .requests import METHODS
from .safety import Estop, Leases

SKEW_S = 123.456
"""How far the robot's clock is ahead of the host's, by default."""
WRONG_M_S = 0.5
"""Error of the reported speed of a robot with wrong readings."""
DURATIONS = ("power_on_s", "stand_s", "sit_s")
_PATHS: Mapping[str, p.Method] = {method.path: method for method in p.METHODS.values()}

COMMENTS = 1000
"""How many comments of operators are kept."""

_UNNAMED = "unnamed"
Logged = tuple[str, str | None]


class SpotTwin(TwinRobot):
    """One simulated robot, which all clients share.

    Args:
        robot: Name of the robot.
        now_s: The monotonic clock.
        skew_s: How far the robot's clock is ahead of the host's.
        sync_s: For how long after the first request the robot has no time estimate yet.
        arm: True if the robot has an arm.
        user: The only permitted user. The driver logs in at a twin with the default.
        password: The user's password.
        haste: How many times faster than the real robot this one powers on, stands up and sits down.
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
        user: str = TWIN_LOGIN[0],
        password: str = TWIN_LOGIN[1],
        haste: float = 1.0,
        wall_ns: Callable[[], int] = time.time_ns,
    ) -> None:
        super().__init__()
        table = TABLES.table(robot)
        table = {**table, **{key: float(table[key]) / haste for key in DURATIONS}}
        self.mechanism = Mechanism(table, now_s)
        self.body = SpotBody(self.mechanism, table)
        self.estop = Estop(now_s)
        self.leases = Leases()
        self.logins = Logins(now_s, user, password)
        self.directory = Directory(self.robot_ns)
        self.robot_faults = RobotFaults(self.robot_ns, self.directory.liveness_faults)
        self.commands = Commands(self.mechanism, table, arm, self.robot_ns)
        self.reports = Reports(self.mechanism, arm, lambda: self.estop, self.robot_ns, self.robot_faults, table)
        self.images = ImageService(self.mechanism, arm, self.reports, self.robot_ns)
        self.comments: list[Message] = []
        """The latest comments of operators, as the robot's log keeps them."""
        self.muted: set[str] = set()
        """Methods that are carried out and never answered."""
        self._now_s = now_s
        self._wall_ns = wall_ns
        self._skew_s = skew_s
        self._sync_s = sync_s
        self._sync_since_s: float | None = None
        self._power_request = p.POWER_OFF
        self._stuck: Message | None = None

    # -- faults

    def begin_fault(self, fault: Fault) -> None:
        self.mechanism.pass_time()
        self._stuck = self.state() if fault is Fault.STUCK else None
        self.mechanism.stuck = fault is Fault.STUCK

    def power_cycle(self) -> None:
        """Restart as after a boot: no client has the lease, and there is no endpoint."""
        self.mechanism.reset()
        self.estop, self.leases = Estop(self._now_s), Leases()
        self.robot_faults.restart()
        self.directory.clear()

    def order(self, words: Sequence[str]) -> bool:
        match words:
            case ["steal", owner]:
                self.leases.acquire(owner, take=True)
            case ["press"]:
                self.estop.pressed = True
            case ["release"]:
                self.estop.pressed = False
            case ["fall"]:
                self.robot_faults.begin(Cause.FALL)
                self.mechanism.cut()
            case ["break", name]:
                self.robot_faults.break_hardware(name)
            case ["repair"]:
                self.robot_faults.repair()
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
                return {"robot_id": IDENTITY}, ("read", None)
            case "ListServiceEntries":
                return {"service_entries": self.directory.entries()}, ("read", None)
            case "GetServiceEntry":
                return self.directory.entry(request.get("service_name", "")), ("read", None)
            case "RegisterService" | "UpdateService":
                return self.directory.register(request, name == "RegisterService"), ("config", None)
            case "UnregisterService":
                return self.directory.unregister(request.get("service_name", "")), ("config", None)
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
            case "GetRobotMetrics":
                return {"robot_metrics": self.reports.metrics()}, ("read", None)
            case "GetRobotHardwareConfiguration":
                return {"hardware_configuration": self.reports.hardware()}, ("read", None)
            case "GetRobotLinkModel":
                return {"link_model": self.reports.link(request.get("link_name", ""))}, ("read", None)
            case "ListImageSources":
                return self.images.listed(), ("read", None)
            case "GetImage":
                return self.images.pictures(request.get("image_requests", [])), ("read", None)
            case "RecordOperatorComments":
                self.comments = [*self.comments, *request.get("operator_comments", ())][-COMMENTS:]
                return {}, ("config", None)
            case "PowerCommand":
                reply = self._power(request, lease)
                is_accepted = reply.get("status") in (p.Power.SUCCESS, p.Power.IN_PROGRESS)
                return reply, ("enable" if is_accepted else "other", None)
            case "PowerCommandFeedback":
                return {"status": int(self._power_status())}, ("read", None)
            case "RobotCommand":
                return self._carry_out(request, lease)
            case "RobotCommandFeedback":
                feedback = self.commands.feedback(request.get("robot_command_id", 0))
                return {"feedback": feedback, "lease_use_result": {"status": p.OK}}, ("read", None)
            case "ClearBehaviorFault":
                return self._clear(request, lease), ("config", None)
            case "TriggerServiceFault":
                return {"status": self.robot_faults.trigger_service_fault(request.get("fault", {}))}, (
                    "config",
                    None,
                )
            case "ClearServiceFault":
                return {"status": self.robot_faults.clear_service_fault(request)}, ("config", None)
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
        return self.logins.log_in(request)

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
        requested: int = request.get("request", 0)
        if requested == p.POWER_OFF:
            self.mechanism.cut()
            status = p.Power.SUCCESS
        elif requested != p.POWER_ON:
            status = p.Power.INTERNAL_ERROR
        elif self.estop.level is not p.StopLevel.NONE:
            status = p.Power.ESTOPPED
        elif self.robot_faults.is_broken:
            status = p.Power.FAULTED
        else:
            self.mechanism.power_on()
            status = p.Power.SUCCESS if self.mechanism.motors is Motors.ON else p.Power.IN_PROGRESS
        if status in (p.Power.SUCCESS, p.Power.IN_PROGRESS):
            self._power_request = requested
        return {"lease_use_result": use, "status": int(status), "power_command_id": 1, "license_status": 1}

    def _power_status(self) -> p.Power:
        """Return the progress of the last power command. "In the case of a commanded power OFF, robot will report
        SUCCESS if power is disabled" (power.proto)."""
        match self.mechanism.motors:
            case Motors.ON:
                return p.Power.SUCCESS
            case Motors.POWERING_ON:
                return p.Power.IN_PROGRESS
        return p.Power.SUCCESS if self._power_request == p.POWER_OFF else p.Power.OVERRIDDEN

    # -- commands

    def _carry_out(self, request: Message, lease: Message) -> tuple[Message, Logged]:
        command = request.get("command", {})
        kind, safe_state = kind_of(command)
        use = self.leases.use(lease)
        reply: Message = {"lease_use_result": use}
        if use["status"] == p.OK and self.robot_faults.refuses_commands:
            reply["status"] = int(p.Command.BEHAVIOR_FAULT)
        elif use["status"] == p.OK:
            is_estopped = self.estop.level is not p.StopLevel.NONE
            status, number = self.commands.carry_out(command, request.get("clock_identifier", ""), is_estopped)
            # "If empty, command was not accepted" (robot_command.proto).
            reply |= {"status": int(status), **({"robot_command_id": number} if number else {})}
        if kind == "safe" and reply.get("status") not in (p.Command.OK, p.Command.NOT_POWERED_ON):
            safe_state = ""
        is_unsupported = reply.get("status") == p.Command.UNSUPPORTED
        if is_unsupported or (kind == "enable" and reply.get("status") != p.Command.OK):
            # The robot has refused the command, so it enabled nothing.
            kind = "other"
        return reply, (kind, safe_state)

    def _clear(self, request: Message, lease: Message) -> Message:
        use = self.leases.use(lease)
        if use["status"] != p.OK:
            return {"lease_use_result": use}
        return {"lease_use_result": use, **self.robot_faults.clear(request.get("behavior_fault_id", 0))}

    # -- reports

    def state(self) -> Message:
        """Return the robot's present state."""
        return self.reports.state(WRONG_M_S if self.faults.of(None) is Fault.WRONG else 0.0)


def _logged_check_in(request: Message, reply: Message) -> Logged:
    level = request["stop_level"]
    if level == p.StopLevel.NONE or reply["status"] != p.CheckIn.OK:
        return "other", None
    return "safe", "off" if level == p.StopLevel.CUT else "settle"
