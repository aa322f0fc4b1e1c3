"""Serve the simulated robot on DDS: LowState 500 times a second, LowCmd, the service, and slow
topics.

The log contains every LowCmd and every request of the host. It also contains the robot's answers,
and changes that the robot makes by itself: ``mode``, ``fall``, ``twist``, ``upper_body``. Kinds of
the host's messages:

``setpoint``  a LowCmd that moves an arm, a ``Move`` that is not zero, a ``RotateHead``
``safe``      ``Move(0, 0, 0)``, and then a LowCmd that holds each arm joint exactly at a position that was
              reported lately; giving back the upper body; damping mode. The log entry also names the safe
              state of the whole robot; it is empty as long as the robot walks or the host has the arms
``enable``    taking the upper body
``read``, ``config``, ``garbled``
"""

from __future__ import annotations

import struct
import time
from collections import deque
from collections.abc import Sequence
from typing import Annotated, Literal

from strands_actors.contract.options import option
from strands_actors.contract.safe_state import SafeState
from strands_actors.drivers.booster import protocol as p
from strands_actors.drivers.booster import rpc
from strands_actors.drivers.booster.protocol import Battery, Command, Fall
from strands_actors.drivers.booster.robots import FIRST_ARM, LAST_ARM, Model
from strands_actors.drivers.booster.rpc import Api, Mode, Request, Response
from strands_actors.drivers.common.codecs.malformed import MalformedFrame
from strands_actors.drivers.common.rtps import CDR, PREFIX_SIZE, Participant
from strands_actors.drivers.common.twin import WireLog
from strands_actors.drivers.common.twin.dds import DdsOptions, DdsServer
from strands_actors.kernel.clock import NS

from .onboard import Onboard
from .simulated import BoosterBody

FALL_S, BATTERY_S, ODOMETER_S = 0.1, 0.5, 0.02
"""Periods of the slow topics. They follow the clock, since a busy machine skips ticks."""
LATELY = 500
"""Number of states that a hold may refer to: a second."""
WRONG_RAD = 1.0

_READS = (
    Api.GET_FRAME_TRANSFORM,
    Api.GET_MODE,
    Api.GET_STATUS,
    Api.GET_ROBOT_INFO,
    Api.GET_SENSORS,
    Api.GET_HANDS,
    Api.GET_ROBOT_MODEL,
)
_ARMS = slice(FIRST_ARM, LAST_ARM + 1)
_ROW = struct.Struct(f"<{LAST_ARM + 1 - FIRST_ARM}f")


class BoosterTwinOptions(DdsOptions, frozen=True):
    robot_name: Annotated[str, option("name that is part of its topics; empty: none")] = ""
    mode: Annotated[Literal["damping", "prepare", "walking", "custom", "soccer"], option("mode it wakes up in")] = (
        "walking"
    )
    battery: Annotated[float, option("state of charge, percent", ge=0, le=100)] = 80.0


class BoosterServer(DdsServer):
    """Serve one simulated robot. The methods at the end inject faults."""

    def __init__(self, model: Model, log: WireLog, options: BoosterTwinOptions) -> None:
        mode = Mode[options.mode.upper()]
        self.onboard = Onboard(model, self.note, mode)
        super().__init__(log, options, self.onboard.body, [motor.slot for motor in model.motors])
        self.onboard.percent = options.battery
        self.body = BoosterBody(self.onboard)
        self._name = options.robot_name
        self._reported_rows: deque[tuple[float, ...]] = deque(maxlen=LATELY)
        self._due_ns: dict[str, int] = {}  # when each slow topic is sent next
        # Functions that are not carried out but answered with this status; None for no answer.
        self._answered: dict[Api, int | None] = {}
        # The clients that have stopped the base and sent no motion command since.
        self._stood: set[bytes] = set()

    def make_endpoints(self, participant: Participant) -> None:
        def topic(name: str) -> str:
            return p.topic(name, self._name)

        self._states = participant.writer(topic("low_state"), p.STATE_TYPE, reliable=True)
        self._falls = participant.writer(topic("fall_down"), p.FALL_TYPE, reliable=True)
        self._batteries = participant.writer(topic("battery_state"), p.BATTERY_TYPE, reliable=True)
        self._odometers = participant.writer(topic("odometer_state"), p.ODOMETER_TYPE, reliable=True)
        self._answers = participant.writer(rpc.response_topic(self._name), rpc.RESPONSE_TYPE, reliable=True)
        participant.reader(topic("joint_ctrl"), p.COMMAND_TYPE, self._on_command)
        participant.reader(rpc.request_topic(self._name), rpc.REQUEST_TYPE, self._on_request, reliable=True)

    def advance(self, now_s: float) -> None:
        self.onboard.advance(now_s)

    # -- received frames

    def _on_command(self, payload: memoryview, writer: bytes, t_ns: int) -> None:
        if self.is_off:
            return
        body = bytes(payload[4:])
        self.receive(writer, t_ns, lambda t_ns: self._take_command(body, writer, t_ns))

    def _take_command(self, body: bytes, writer: bytes, t_ns: int) -> None:
        try:
            command = p.decode_command(body)
        except MalformedFrame:
            self.log.write(t_ns, "host", [("garbled", body)])
            return
        if writer[:PREFIX_SIZE] in self._stood and self._holds(command):
            self.log.write(t_ns, "host", [("safe", body)], "" if any(self.onboard.twist) else SafeState.HOLD)
        else:
            self._stood.clear()
            self.log.write(t_ns, "host", [("setpoint", body)], "")
        self.onboard.command(command)

    def _holds(self, command: Command) -> bool:
        """Return True if the command holds each arm joint exactly, to the last bit, at a recently
        reported position."""
        goals = tuple(motor.q for motor in command.motors[_ARMS])
        if any(motor.dq or motor.tau for motor in command.motors) or len(goals) * 4 != _ROW.size:
            return False
        return all(any(row[index] == q for row in self._reported_rows) for index, q in enumerate(goals))

    def _on_request(self, payload: memoryview, writer: bytes, t_ns: int) -> None:
        if self.is_off:
            return
        body = bytes(payload[4:])
        self.receive(writer, t_ns, lambda t_ns: self._take_request(body, writer, t_ns))

    def _take_request(self, body: bytes, writer: bytes, t_ns: int) -> None:
        try:
            request = rpc.decode_request(body)
        except MalformedFrame:
            self.log.write(t_ns, "host", [("garbled", body)])
            return
        kind, safe_state = self._kind_of(request)
        if kind in ("setpoint", "enable"):
            self._stood.clear()
        elif request.api == Api.MOVE:
            self._stood.add(writer[:PREFIX_SIZE])
        self.log.write(t_ns, "host", [(kind, body)], safe_state)
        response = self._serve(request)
        if request.wants_answer and response is not None:
            answer = rpc.encode_response(response)
            self.log.write(time.monotonic_ns(), "robot", [("answer", answer)])
            self._answers.write(CDR + answer)

    def _serve(self, request: Request) -> Response | None:
        """Carry out and answer a request, unless the control line ``answer`` has changed its
        answer."""
        status = next((status for api, status in self._answered.items() if api == request.api), rpc.OK)
        if status:
            return Response(request.id, status)
        response = self.onboard.serve(request)
        return None if status is None else response

    def _kind_of(self, request: Request) -> tuple[str, str]:
        """Return the kind of a request for the log of messages, and the safe state of the whole robot that it
        causes."""
        try:
            body = rpc.parsed(request.body)
        except MalformedFrame:
            return "config", ""
        walks = any(self.onboard.twist)
        match request.api:
            case Api.MOVE if not any(body.get(name) for name in ("vx", "vy", "vyaw")):
                return "safe", "" if self.onboard.host_has_arms else SafeState.HOLD
            case Api.MOVE | Api.ROTATE_HEAD:
                return "setpoint", ""
            case Api.UPPER_BODY if body.get("start") is False:
                return "safe", "" if walks else SafeState.STOP
            case Api.UPPER_BODY:
                return "enable", ""
            case Api.CHANGE_MODE if body.get("mode") == Mode.DAMPING:
                return "safe", SafeState.DAMP
        return ("read" if request.api in _READS else "config"), ""

    # -- sent frames

    def send_due(self, tick: int, now_ns: int) -> None:
        state = self.onboard.state()
        if self.lies:
            state = state._replace(q=tuple(rad + WRONG_RAD for rad in state.q))
        self._reported_rows.append(_ROW.unpack(_ROW.pack(*state.q[_ARMS])))
        self.send_state(self._states, p.encode_state(state), now_ns)
        if self.is_off:
            return
        if self._is_due("fall", FALL_S, now_ns):
            fall = self.onboard.fall
            self._falls.write(CDR + p.encode_fall(fall, fall is Fall.HAS_FALLEN))
        if self._is_due("battery", BATTERY_S, now_ns):
            self._batteries.write(CDR + p.encode_battery(Battery(*self.onboard.battery)))
        if self._is_due("odometer", ODOMETER_S, now_ns):
            self._odometers.write(CDR + p.encode_odometer(self.onboard.odometer))

    def _is_due(self, name: str, every_s: float, now_ns: int) -> bool:
        due = now_ns >= self._due_ns.get(name, 0)
        if due:
            self._due_ns[name] = now_ns + round(every_s * NS)
        return due

    # -- faults

    def power_cycle(self) -> None:
        self.onboard.reset()

    def order(self, words: Sequence[str]) -> bool:
        match words:
            case ["fall"]:
                self.onboard.fall_over()
            case ["get-up"]:
                self.onboard.get_up()
            case ["mode", name] if name.upper() in Mode.__members__:
                self.onboard.set_mode(Mode[name.upper()])
            case ["answer", name, how] if name in Api.__members__ and how in ("-", "nothing"):
                self._answered[Api[name]] = rpc.OK if how == "-" else None
            case ["answer", name, status] if name in Api.__members__ and status.isdecimal():
                self._answered[Api[name]] = int(status)
            case ["battery", percent] if percent.isdecimal() and int(percent) <= 100:
                self.onboard.percent = float(percent)
            case _:
                return False
        return True
