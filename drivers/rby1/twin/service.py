"""Answer the gRPC calls to the simulated robot."""

from __future__ import annotations

import msgspec

from strands_actors.drivers.common.codecs import protobuf as pb
from strands_actors.drivers.common.twin import Fault, Faults
from strands_actors.drivers.common.twin.grpc import ServerCall
from strands_actors.drivers.rby1 import protocol as p
from strands_actors.drivers.rby1.commands import Feedback, Finish, Status
from strands_actors.drivers.rby1.protocol import Done, JointOrder, ManagerOrder, Method, PowerOrder
from strands_actors.drivers.rby1.states import RobotState

from .administration import ANSWERS, READS, Rejected
from .calls import CALLS
from .controller import Controller
from .journal import Journal, Level
from .parameters import Invalid
from .requests import Request

MOST_HZ = 500.0
WRONG_BY_RAD = 0.5


class Stream:
    """A client that receives messages at a rate."""

    def __init__(self, call: ServerCall, hz: float, now_s: float) -> None:
        self.call = call
        self.period_s = 1.0 / min(MOST_HZ, max(1.0, hz))
        self.due_s = now_s

    def is_due(self, now_s: float) -> bool:
        """Return True once in each period, if the client has read the previous message."""
        if now_s < self.due_s:
            return False
        self.due_s = max(self.due_s + self.period_s, now_s - self.period_s)
        return self.call.has_room


class LogStream(Stream):
    """A client that receives the log from its call on."""

    def __init__(self, call: ServerCall, hz: float, now_s: float, newest: int) -> None:
        super().__init__(call, hz, now_s)
        self._number = newest  # of the newest line that was sent

    def send(self, journal: Journal) -> None:
        lines = journal.since(self._number)
        if lines:
            self._number = lines[-1].number
            self.call.send(b"".join(pb.bytes_field(2, line.encode()) for line in lines))


class CommandCall:
    """One call by which a client sends commands, as a stream or a single request."""

    def __init__(self, call: ServerCall, controller: Controller) -> None:
        self.call = call
        self.streams = call.path == Method.COMMAND_STREAM
        self.priority: int | None = None  # of the stream: that of its first message
        self.result: Finish | None = None  # why its newest command has ended; None while it runs
        self._controller = controller

    def finished(self, reason: Finish) -> None:
        self.result = reason
        self._controller.devices.journal.write(
            self._controller.time_ns,
            Level.INFO if reason is Finish.OK else Level.WARN,
            f"a command has ended: {reason.name}",
        )
        feedback = Feedback(Status.FINISHED, reason).encode(self._controller.feedback())
        if self.streams:
            self.call.send(feedback)
        else:
            self.call.answer(feedback)


class RBY1Service:
    def __init__(self, controller: Controller) -> None:
        self.controller = controller
        self.faults = Faults()
        self._states: dict[ServerCall, Stream] = {}
        self._logs: dict[ServerCall, LogStream] = {}
        self._commands: dict[ServerCall, CommandCall] = {}
        self._stale: RobotState | None = None

    def called(self, call: ServerCall) -> bool:
        if call.path in (Method.COMMAND_STREAM, Method.COMMAND):
            self._commands[call] = CommandCall(call, self.controller)
        return call.path in CALLS

    def message(self, call: ServerCall, t_ns: int, message: bytes) -> None:
        method, controller = Method(call.path), self.controller
        if method in (Method.COMMAND, Method.COMMAND_STREAM):
            request = Request.decode(message)
            call.log_received(t_ns, kind_of_command(request), message)
            self._command(self._commands[call], request)
            return
        kind = kind_of(method, message)
        call.log_received(t_ns, kind, message)
        controller.tick()
        now_s = controller.now_s()
        if method is Method.STATE_STREAM:
            self._states[call] = Stream(call, p.decode_rate(message), now_s)
        elif method is Method.LOG_STREAM:
            self._logs[call] = LogStream(call, p.decode_rate(message), now_s, controller.devices.journal.newest)
        elif self.faults.of(None) is Fault.STUCK and kind not in ("read", "keepalive"):
            # With the fault "stuck" the robot answers with success and does nothing.
            self._answer(call, p.encode_done(Done.SUCCESS))
        else:
            self._obey(call, method, message)
            if kind not in ("read", "keepalive"):
                controller.devices.journal.write(controller.time_ns, Level.INFO, method.rpartition("/")[2])

    def over(self, call: ServerCall) -> None:
        command = self._commands.get(call)
        if command is not None and command.streams:
            self.controller.leave(command)
            call.end()
        if not call.is_open:
            self._commands.pop(call, None)
            self._states.pop(call, None)
            self._logs.pop(call, None)

    def tick(self) -> None:
        """Send the states and the lines of the log that are due."""
        self.controller.tick()
        if self.faults.of(None) is Fault.OFF:
            return
        now_s = self.controller.now_s()
        due = [stream for stream in self._states.values() if stream.is_due(now_s)]
        if due:
            message = self._state().encode()
            for stream in due:
                stream.call.send(message)
        for log in self._logs.values():
            if log.is_due(now_s):
                log.send(self.controller.devices.journal)

    def _command(self, caller: CommandCall, request: Request) -> None:
        if self.faults.of(None) is Fault.STUCK:
            caller.call.send(Feedback(Status.RUNNING).encode())
            return
        if request.asks and caller.streams and caller.priority is not None:
            status = Status.RUNNING if caller.result is None else Status.FINISHED
            feedback = Feedback(status, caller.result or Finish.UNKNOWN)
            caller.call.send(feedback.encode(self.controller.feedback()))
            return
        if caller.priority is None:
            caller.priority = request.priority
        caller.result = None
        # The vendor's client writes the priority of a stream into its first message only.
        reason = self.controller.command(caller, msgspec.structs.replace(request, priority=caller.priority))
        if reason is not None:
            caller.finished(reason)
        elif caller.streams:
            caller.call.send(Feedback(Status.RUNNING).encode(self.controller.feedback()))

    def _answer(self, call: ServerCall, answer: bytes) -> None:
        now_ns = self.controller.time_ns
        call.answer(p.headed(answer, now_ns, now_ns))

    def _obey(self, call: ServerCall, method: Method, message: bytes) -> None:
        """Carry out a request and answer it. Raise ``MalformedFrame``."""
        try:
            if method in ANSWERS:
                answer = ANSWERS[method](self.controller, pb.message(message))
            else:
                answer = self._order(method, message)
        except Rejected as rejected:
            call.end(rejected.status, str(rejected))
        except Invalid as invalid:
            call.answer(p.refused(str(invalid)))
        else:
            self._answer(call, answer)

    def _order(self, method: Method, message: bytes) -> bytes:
        """Carry out an order to supplies, servos or control manager, or read the state."""
        controller = self.controller
        match method:
            case Method.GET_ROBOT_INFO:
                return controller.info.encode()
            case Method.GET_ROBOT_MODEL:
                return p.encode_model(controller.devices.urdf)
            case Method.GET_ROBOT_STATE:
                return self._state().encode()
            case Method.POWER:
                name, order = p.decode_order(message)
                return _done(order in tuple(PowerOrder) and controller.power(name, order == PowerOrder.ON))
            case Method.JOINT:
                return _done(controller.servo(*p.decode_order(message)))
            case Method.SERVO_ON:
                return _done(controller.servo(p.decode_order(message)[0], JointOrder.SERVO_ON))
            case Method.SERVO_OFF:
                return _done(controller.servo_off(p.decode_order(message)[0]))
            case Method.MANAGER:
                controller.order_manager(p.decode_manager_order(message))
                return p.encode_manager_answer(controller.manager_state)
            case Method.GET_MANAGER_STATE:
                return p.encode_manager_answer(controller.manager_state)
            case Method.CANCEL:
                controller.cancel()
            case Method.WAIT_READY:
                return p.encode_ready(controller.manager == p.Manager.ENABLED)
        return b""

    def _state(self) -> RobotState:
        fault = self.faults.of(None)
        if fault is Fault.STUCK and self._stale is not None:
            return self._stale
        state = self._stale = self.controller.state()
        if fault is Fault.WRONG:
            position = tuple(rad + WRONG_BY_RAD for rad in state.position)
            return msgspec.structs.replace(state, position=position)
        return state


def kind_of(method: Method, message: bytes) -> str:
    """Return the kind of a message for the log of messages. Raise ``MalformedFrame``."""
    match method:
        case Method.CANCEL | Method.SERVO_OFF:
            return "safe"
        case Method.COMMAND | Method.COMMAND_STREAM:
            return kind_of_command(Request.decode(message))
        case Method.POWER:
            return "enable" if p.decode_order(message)[1] == PowerOrder.ON else "safe"
        case Method.JOINT | Method.SERVO_ON:
            return "enable"
        case Method.MANAGER:
            order = p.decode_manager_order(message)
            kinds = {ManagerOrder.DISABLE.value: "safe", ManagerOrder.RESET_FAULT.value: "config"}
            return kinds.get(order, "enable")
        case Method.PING:
            return "keepalive"
        case _:
            return "config" if method in ANSWERS and method not in READS else "read"


def kind_of_command(request: Request) -> str:
    """Return the kind of a command for the log of messages. A request for feedback only reads."""
    return "safe" if request.stops else "read" if request.asks else "setpoint"


def _done(done: bool) -> bytes:
    return p.encode_done(Done.SUCCESS) if done else p.encode_done(Done.INTERNAL_ERROR, "not possible now")
