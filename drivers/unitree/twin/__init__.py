"""Simulate a Unitree robot (a "twin") on a DDS network. MuJoCo simulates its body.

It publishes LowState 500 times a second, obeys LowCmd, and answers the requests to its services. All robots except
the H1-2 can also walk by their onboard controller, while their onboard mode is active. A Go2 and a B2 publish
SportModeState 50 times a second, and a G1 publishes its odometry.

The log of the network (wire log) has every LowCmd and every request, by its kind:

    setpoint   a LowCmd with torque, a velocity, or a gesture
    safe       a LowCmd without torque, StopMove or Damp. A G1 and an H1 have no StopMove: there it is a velocity of
               zero with a duration of one second, as the vendor's client sends it
    garbled    a LowCmd with a wrong checksum
    other      a LowCmd for another ``mode_machine``
    arms       a LowCmd on ``rt/arm_sdk``

It also has the robot's answers and events: ``fsm``, ``mode``, ``fell``, ``stood``. It has no LowStates, which would
be a megabyte a second.

A test controls a simulated robot by lines of text. This one accepts the lines of every twin, and also ``fsm
NUMBER``, ``mode NAME`` (``mode -`` releases the onboard mode) and ``battery PERCENT`` (or ``battery unknown``).
After ``nan JOINT`` this joint reports a position that is not a number, until ``nan -``.
"""

from __future__ import annotations

import json
import math
import struct
import time
from collections.abc import Sequence
from typing import Annotated, Any, Literal

from strands_actors.contract.options import option
from strands_actors.contract.safe_state import SafeState
from strands_actors.drivers.common.codecs.malformed import MalformedFrame
from strands_actors.drivers.common.rtps import CDR, Participant, Writer
from strands_actors.drivers.common.twin import WireLog, main_of
from strands_actors.drivers.common.twin.dds import DdsOptions, DdsServer
from strands_actors.drivers.unitree import protocol as p
from strands_actors.drivers.unitree import rpc
from strands_actors.drivers.unitree.protocol import Command, CommandCodec, StateCodec
from strands_actors.drivers.unitree.robots import Model, model_of
from strands_actors.drivers.unitree.walking.loco import DAMP, STOP_DURATION_S, ZERO_TORQUE
from strands_actors.drivers.unitree.walking.robots import dialect_of
from strands_actors.drivers.unitree.walking.states import STATE_TYPE, encode_state
from strands_actors.kernel.clock import NS

from . import arm_actions, arm_sdk, obstacles
from .onboard import Onboard
from .requests import MODELLED
from .standing import StandingBody


class UnitreeTwinOptions(DdsOptions, frozen=True):
    silence_s: Annotated[float, option("damp after so long without a LowCmd; 0: never", ge=0)] = 0.0
    battery: Annotated[int | Literal["unknown"], option("state of charge, percent, or unknown")] = 80
    keeps_s: Annotated[float, option("a velocity ends by itself after so long; 0: never", ge=0)] = 1.0
    fsm: Annotated[int | None, option("FSM id it wakes up in; None: the robot's own")] = None
    simulator: Annotated[
        bool,
        option("speak as Unitree's own simulator: without checksum, tick, mode_machine, services and battery"),
    ] = False


BATTERY_EVERY, GAIT_EVERY, GESTURE_EVERY = 50, 10, 50
"""Periods of publishing the battery, SportModeState and the state of the gestures, in ticks of 2 ms."""
WRONG_RAD = 1.0
_SAFE_STATES = {ZERO_TORQUE: SafeState.ZERO_TORQUE, DAMP: SafeState.DAMP}
"""FSM id -> safe state that it means."""
_READS = {
    rpc.MOTION_SWITCHER: (rpc.SERVER_VERSION, rpc.CHECK_MODE),
    arm_actions.SERVICE: (rpc.SERVER_VERSION, arm_actions.LIST),
    obstacles.SERVICE: (rpc.SERVER_VERSION, obstacles.SWITCH_GET),
}
_SPORT_READS = (rpc.SERVER_VERSION, rpc.GET_FSM_ID, rpc.LOCO_GET_FSM_ID, rpc.LOCO_GET_ODOM)
"""Requests that only read, by service. The same number has another meaning in another service."""


def safe_state_of(command: Command) -> str:
    """Return the safe state that a LowCmd commands: ``zero_torque`` or ``damp``. Return "" if it commands
    torque."""
    if any(command.tau) or any(command.kp):
        return ""
    return "damp" if any(command.kd) else "zero_torque"


def _text(text: str) -> bytes:
    """Encode a ``std_msgs`` String."""
    data = text.encode() + b"\0"
    return struct.pack("<I", len(data)) + data


class UnitreeServer(DdsServer):
    """Run one simulated robot on the network. Its methods are events, such as a fault or a power cycle."""

    def __init__(self, model: Model, log: WireLog, options: UnitreeTwinOptions) -> None:
        self._model = model
        self._simulator = options.simulator
        self.onboard = Onboard(model, self.note, options.silence_s, self._simulator, keeps_s=options.keeps_s)
        super().__init__(log, options, self.onboard.body, model.slots)
        self.body = StandingBody(self.onboard)
        """The body that a simulation (another program on this computer) may move."""
        self.onboard.soc = None if options.battery == "unknown" else options.battery
        if options.fsm is not None:
            self.onboard.set_fsm(options.fsm)
        self._commands = CommandCodec(model)
        self._states = StateCodec(model)
        self._answers: dict[str, Writer] = {}
        self._gesture_writer: Writer | None = None
        self._nan = ""  # Name of a joint that must report NaN as its position, or empty.

    def make_endpoints(self, participant: Participant) -> None:
        family = self._model.family
        self._state_writer = participant.writer(p.STATE_TOPIC, p.state_type(family))
        participant.reader(p.COMMAND_TOPIC, p.command_type(family), self._on_command)
        walks = None if self._simulator else self._model.walks
        topic = "" if walks is None else dialect_of(walks).state_topic
        self._gait_writer = participant.writer(topic, STATE_TYPE) if topic else None
        if self.onboard.arms is not None:
            participant.reader(arm_sdk.TOPIC, p.command_type(family), self._on_arms)
        if self.onboard.actions is not None:
            self._gesture_writer = participant.writer(arm_actions.STATE_TOPIC, arm_actions.STATE_TYPE)
        tells_battery = family == "hg" and not self._simulator
        self._battery_writer = participant.writer(p.BATTERY_TOPIC, p.BATTERY_TYPE) if tells_battery else None
        for service in () if self._simulator else self.onboard.services:
            self._answers[service] = participant.writer(
                rpc.response_topic(service), rpc.RESPONSE_TYPE, reliable=True
            )
            self._serve_requests(participant, service)

    def _serve_requests(self, part: Participant, service: str) -> None:
        def on_request(payload: memoryview, writer: bytes, t_ns: int) -> None:
            if not self.is_off:
                body = bytes(payload[4:])
                self.receive(writer, t_ns, lambda t_ns: self._take_request(service, body, t_ns))

        part.reader(rpc.request_topic(service), rpc.REQUEST_TYPE, on_request, reliable=True)

    def advance(self, now_s: float) -> None:
        self.onboard.advance(now_s)
        for response in self.onboard.take_responses():
            self._answer(arm_actions.SERVICE, response)

    # -- received data

    def _on_command(self, payload: memoryview, writer: bytes, t_ns: int) -> None:
        if self.is_off:
            return
        body = bytes(payload[4:])
        self.receive(writer, t_ns, lambda t_ns: self._take_command(body, t_ns))

    def _take_command(self, body: bytes, t_ns: int) -> None:
        try:
            command = self._commands.decode(body)
        except MalformedFrame:
            self.log.write(t_ns, "host", [("garbled", body)])
            return
        if command.machine != self.onboard.machine:
            self.log.write(t_ns, "host", [("other", body)])
            return
        safe_state = safe_state_of(command)
        self.log.write(t_ns, "host", [("safe" if safe_state else "setpoint", body)], safe_state)
        self.onboard.command(command, t_ns / NS)

    def _on_arms(self, payload: memoryview, writer: bytes, t_ns: int) -> None:
        if not self.is_off:
            body = bytes(payload[4:])
            self.receive(writer, t_ns, lambda t_ns: self._take_arms(body, t_ns))

    def _take_arms(self, body: bytes, t_ns: int) -> None:
        kind = "arms"
        try:
            self.onboard.command_arms(body, t_ns / NS)
        except MalformedFrame:
            kind = "garbled"
        self.log.write(t_ns, "host", [(kind, body)])

    def _take_request(self, service: str, body: bytes, t_ns: int) -> None:
        try:
            request = rpc.decode_request(body)
        except MalformedFrame:
            self.log.write(t_ns, "host", [("garbled", body)])
            return
        kind, safe_state = self._kind_of(service, request)
        self.log.write(t_ns, "host", [(kind, body)], safe_state)
        response = self.onboard.serve(service, request)
        if response is not None and not request.no_reply:
            self._answer(service, response)

    def _answer(self, service: str, response: rpc.Response) -> None:
        answer = rpc.encode_response(response)
        self.log.write(time.monotonic_ns(), "robot", [("answer", answer)])
        if service in self._answers:  # Missing only while the cable has never been plugged in.
            self._answers[service].write(CDR + answer)

    def _kind_of(self, service: str, request: rpc.Request) -> tuple[str, str | None]:
        """Return the kind of a request for the wire log, and the safe state that it commands, if it does so."""
        if request.api in _READS.get(service, _SPORT_READS):
            return "read", None
        if service == arm_actions.SERVICE and request.api == arm_actions.EXECUTE:
            return "setpoint", ""
        if service == obstacles.SERVICE and request.api == obstacles.MOVE:
            still = not any(self._parameter(request).get(name) for name in ("x", "y", "yaw"))
            return ("safe", None) if still else ("setpoint", "")
        if service != self._model.service or self.onboard.gait is None:
            return "config", None
        match request.api:
            case rpc.MOVE:
                return "setpoint", ""
            case rpc.STOP_MOVE:  # The driver sends it for a hold and for a stop, so the safe state is unknown.
                return "safe", None
            case rpc.DAMP:
                return "safe", SafeState.DAMP
            case rpc.SET_VELOCITY | rpc.LOCO_SET_VELOCITY:
                parameter = self._parameter(request)
                # A velocity of zero may be a setpoint or a stop. A stop has the duration of the vendor's StopMove.
                stops = (parameter.get("velocity"), parameter.get("duration")) == ([0.0, 0.0, 0.0], STOP_DURATION_S)
                return ("safe", None) if stops else ("setpoint", "")
            case rpc.SET_FSM_ID | rpc.LOCO_SET_FSM_ID:
                number = self._parameter(request).get("data")
                if isinstance(number, int) and number in _SAFE_STATES:
                    return "safe", _SAFE_STATES[number]
        return "config", None

    @staticmethod
    def _parameter(request: rpc.Request) -> dict[str, Any]:
        """Decode the parameter of a request. Return an empty dict if it cannot be decoded."""
        try:
            return rpc.parsed(request.parameter)
        except MalformedFrame:
            return {}

    # -- sent data

    def send_due(self, tick: int, now_ns: int) -> None:
        state = self.onboard.state()
        if self.lies:
            state = state._replace(q=tuple(rad + WRONG_RAD for rad in state.q))
        if self._nan:
            q = (math.nan if key == self._nan else rad for key, rad in zip(self._model.axes, state.q, strict=True))
            state = state._replace(q=tuple(q))
        if self._simulator:
            state = state._replace(tick=0)
        body = self._states.encode(state)
        if self._simulator:
            body = body[:-4] + bytes(4)
        self.send_state(self._state_writer, body, now_ns)
        gait = self.onboard.sport_state(now_ns)
        if self._gait_writer is not None and gait is not None and not self.is_off and tick % GAIT_EVERY == 0:
            self._gait_writer.write(CDR + encode_state(gait))
        gestures, gesture_writer = self.onboard.actions, self._gesture_writer
        due = not self.is_off and tick % GESTURE_EVERY == 0
        if gesture_writer is not None and gestures is not None and due:
            gesture_writer.write(CDR + _text(json.dumps(gestures.state)))
        battery, soc = self._battery_writer, self.onboard.soc
        if battery is not None and soc is not None and not self.is_off and tick % BATTERY_EVERY == 0:
            battery.write(CDR + p.encode_battery(soc))

    # -- events

    def power_cycle(self) -> None:
        self.onboard.reset()

    def order(self, words: Sequence[str]) -> bool:
        match words:
            case ["fsm", number] if number.isdecimal() and self.onboard.fsm_id is not None:
                self.onboard.set_fsm(int(number))
            case ["mode", name]:
                self.onboard.set_mode("" if name == "-" else name)
            case ["nan", joint] if joint == "-" or joint in self._model.axes:
                self._nan = joint.removeprefix("-")
            case ["battery", "unknown"]:
                self.onboard.soc = None
            case ["battery", percent] if percent.isdecimal() and int(percent) <= 100:
                self.onboard.soc = int(percent)
            case _:
                return False
        return True


def build(robot: str, options: UnitreeTwinOptions, log: WireLog) -> UnitreeServer:
    """Return the server of a robot of ``robots.toml``."""
    return UnitreeServer(model_of(robot), log, options)


main = main_of(UnitreeTwinOptions, build)

__all__ = ["MODELLED", "Onboard", "UnitreeServer", "UnitreeTwinOptions", "build", "main", "safe_state_of"]
