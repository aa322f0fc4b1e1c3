"""Answer the gRPC calls to the simulated robot."""

from __future__ import annotations

import msgspec

from strands_actors.drivers.common.twin import Fault, Faults
from strands_actors.drivers.common.twin.grpc import ServerCall
from strands_actors.drivers.rby1 import protocol as p
from strands_actors.drivers.rby1.commands import Command, Feedback, Finish, Status
from strands_actors.drivers.rby1.protocol import Done, JointOrder, ManagerOrder, Method, PowerOrder
from strands_actors.drivers.rby1.states import RobotState

from .calls import CALLS
from .controller import Controller

MOST_HZ = 500.0
WRONG_BY_RAD = 0.5


class StateStream:
    """A client that receives states."""

    def __init__(self, call: ServerCall, hz: float, now_s: float) -> None:
        self.call = call
        self.period_s = 1.0 / min(MOST_HZ, max(1.0, hz))
        self.due_s = now_s


class CommandCall:
    """One call by which a client sends commands, as a stream or a single request."""

    def __init__(self, call: ServerCall) -> None:
        self.call = call
        self.streams = call.path == Method.COMMAND_STREAM

    def finished(self, reason: Finish) -> None:
        feedback = Feedback(Status.FINISHED, reason).encode()
        if self.streams:
            self.call.send(feedback)
        else:
            self.call.answer(feedback)


class RBY1Service:
    def __init__(self, controller: Controller) -> None:
        self.controller = controller
        self.faults = Faults()
        self._states: dict[ServerCall, StateStream] = {}
        self._commands: dict[ServerCall, CommandCall] = {}
        self._stale: RobotState | None = None

    def called(self, call: ServerCall) -> bool:
        if call.path in (Method.COMMAND_STREAM, Method.COMMAND):
            self._commands[call] = CommandCall(call)
        return call.path in CALLS

    def message(self, call: ServerCall, t_ns: int, message: bytes) -> None:
        method = Method(call.path)
        call.log_received(t_ns, kind_of(method, message), message)
        self.controller.tick()
        if method in (Method.COMMAND, Method.COMMAND_STREAM):
            self._command(self._commands[call], Command.decode(message))
        elif method is Method.STATE_STREAM:
            self._states[call] = StateStream(call, p.decode_rate(message), self.controller.now_s())
        elif self.faults.of(None) is Fault.STUCK and kind_of(method, message) not in ("read", "keepalive"):
            # With the fault "stuck" the robot answers with success and does nothing.
            call.answer(p.headed(p.encode_done(Done.SUCCESS)))
        else:
            call.answer(p.headed(self._obey(method, message)))

    def over(self, call: ServerCall) -> None:
        command = self._commands.get(call)
        if command is not None and command.streams:
            self.controller.leave(command)
            call.end()
        if not call.is_open:
            self._commands.pop(call, None)
            self._states.pop(call, None)

    def tick(self) -> None:
        """Send the states that are due. A client that has not read its previous state gets no new
        one."""
        self.controller.tick()
        now_s = self.controller.now_s()
        due = [stream for stream in self._states.values() if now_s >= stream.due_s]
        if not due or self.faults.of(None) is Fault.OFF:
            return
        message = self._state().encode()
        for stream in due:
            stream.due_s = max(stream.due_s + stream.period_s, now_s - stream.period_s)
            if stream.call.has_room:
                stream.call.send(message)

    def _command(self, caller: CommandCall, command: Command) -> None:
        if self.faults.of(None) is Fault.STUCK:
            caller.call.send(Feedback(Status.RUNNING).encode())
            return
        reason = self.controller.command(caller, command)
        if reason is not None:
            caller.finished(reason)
        elif caller.streams:
            caller.call.send(Feedback(Status.RUNNING).encode())

    def _obey(self, method: Method, message: bytes) -> bytes:
        """Carry out a request and return the encoded answer. Raise ``MalformedFrame``."""
        controller = self.controller
        match method:
            case Method.GET_ROBOT_INFO:
                return controller.info.encode()
            case Method.GET_ROBOT_MODEL:
                return p.encode_model(controller.urdf)
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
            return "safe" if Command.decode(message).stops else "setpoint"
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
            return "read"


def _done(done: bool) -> bytes:
    return p.encode_done(Done.SUCCESS) if done else p.encode_done(Done.INTERNAL_ERROR, "not possible now")
