"""The robot's end of a Unitree network: LowState 500 times a second, LowCmd, the services; MuJoCo
behind them.

The log has every LowCmd (``safe`` with its safe state when it gives no torque, else ``setpoint``;
``garbled`` when its checksum is wrong) and every request; of the robot's side the answers and what
it does by itself: ``fsm``, ``mode``, ``fell``, ``stood``. LowStates are not in it: a megabyte a
second that nobody reads.

Besides the control lines of every twin it takes ``fsm NUMBER``, ``mode NAME`` (``mode -``:
released) and ``battery PERCENT`` (``battery unknown``).
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Mapping, Sequence
from contextlib import aclosing
from typing import Any, Unpack

from strands_actors.drivers.common.malformed import MalformedFrame
from strands_actors.drivers.common.rtps import CDR, Participant, Writer
from strands_actors.drivers.common.twin import (
    Fault,
    Faults,
    Reply,
    Start,
    WireLog,
    known_options,
    own_host,
    parse_fault,
    run_server,
)
from strands_actors.drivers.common.twin.server import Frost
from strands_actors.drivers.unitree import protocol as p
from strands_actors.drivers.unitree import rpc
from strands_actors.drivers.unitree.gates import CONTROL_S
from strands_actors.drivers.unitree.protocol import Command, CommandCodec, StateCodec
from strands_actors.drivers.unitree.robots import Model, model_of
from strands_actors.kernel.clock import NS, MonotonicClock
from strands_actors.kernel.health.realtime import TWIN_PRIORITY, run_first

from .onboard import Onboard

OPTIONS = {
    "host": "address to serve at (default: one of its own in 127.0.0.0/8)",
    "domain": "DDS domain (default 0)",
    "multicast": "be found by multicast, too, as a vendor's client looks for a robot (default: false)",
    "silence_s": "damp after so long without a LowCmd (default 0: never)",
    "battery": "state of charge, percent (default 80), or unknown",
    "fsm": "FSM id it wakes up in (default 801)",
}

BATTERY_EVERY = 50
"""Ticks."""
WRONG_RAD = 1.0
_READS = (rpc.SERVER_VERSION, rpc.CHECK_MODE, rpc.GET_FSM_ID, rpc.LOCO_GET_FSM_ID)


def safe_state_of(command: Command) -> str:
    """What a LowCmd brings the whole robot to: ``zero_torque``, ``damp``, or "" for anything
    else."""
    if any(command.tau) or any(command.kp):
        return ""
    return "damp" if any(command.kd) else "zero_torque"


class Machine:
    """What may happen to the robot."""

    def __init__(self, onboard: Onboard) -> None:
        self.onboard = onboard
        self.faults = Faults()

    def set_fault(self, fault: Fault, unit: int | None) -> None:
        """``unit``: the slot of a motor, which can get stuck or lose its supply. None: what the
        robot says."""
        model = self.onboard.model
        if unit is None:
            self.faults.set(fault)
        elif unit in model.slots and fault in (Fault.OK, Fault.STUCK, Fault.OFF):
            at = model.slots.index(unit)
            self.onboard.body.set_stuck(at, fault is Fault.STUCK)
            self.onboard.body.set_off(at, fault is Fault.OFF)
        else:
            raise ValueError(
                f"a motor, {model.slots[0]} to {model.slots[-1]}, can be ok, stuck or off, not {fault}"
            )


class UnitreeServer:
    """Serves one robot. Its methods are what may happen to it while it runs."""

    def __init__(self, model: Model, log: WireLog, options: Mapping[str, Any]) -> None:
        self._log = log
        self._model = model
        self._clock = MonotonicClock()
        self.onboard = Onboard(model, self._note, float(options.get("silence_s", 0.0)))
        battery = options.get("battery", self.onboard.soc)
        self.onboard.soc = None if battery == "unknown" else int(battery)
        if "fsm" in options:
            self.onboard.set_fsm(int(options["fsm"]))
        self._machine = Machine(self.onboard)
        self._frost = Frost()
        self._commands = CommandCodec(model)
        self._states = StateCodec(model)
        self._held = b""  # the state that a stuck robot repeats
        self._late: deque[tuple[int, bytes]] = deque()
        self._domain = int(options.get("domain", 0))
        self._multicast = bool(options.get("multicast", False))
        self._host = str(options.get("host") or own_host())
        self._participant: Participant | None = None
        self._answers: dict[str, Writer] = {}
        self.address = ""

    # -- the network

    def plug(self) -> None:
        if self._participant is not None:
            return
        self._participant = part = Participant(self._domain, self._host, (), self._multicast, clock=self._clock)
        self.address = part.address
        family = self._model.family
        self._state_writer = part.writer(p.STATE_TOPIC, p.state_type(family))
        part.reader(p.COMMAND_TOPIC, p.command_type(family), self._on_command)
        self._battery_writer = part.writer(p.BATTERY_TOPIC, p.BATTERY_TYPE) if family == "hg" else None
        for service in self.onboard.services:
            self._answers[service] = part.writer(rpc.response_topic(service), rpc.RESPONSE_TYPE, reliable=True)
            self._serve_requests(part, service)

    def _serve_requests(self, part: Participant, service: str) -> None:
        def on_request(payload: memoryview, writer: bytes, t_ns: int) -> None:
            self._on_request(service, payload, t_ns)

        part.reader(rpc.request_topic(service), rpc.REQUEST_TYPE, on_request, reliable=True)

    def unplug(self) -> None:
        """Pull the cable. The robot itself does not notice, and goes on with its last command."""
        if self._participant is not None:
            self._participant.close()
            self._participant = None

    def close(self) -> None:
        self.unplug()

    async def serve(self) -> None:
        """Until cancelled."""
        async with aclosing(self._clock.ticks(CONTROL_S)) as ticks:
            tick = 0
            async for now_ns in ticks:
                await self._frost.thawed()
                tick += 1
                if self._participant is not None:
                    self._participant.poll()
                self.onboard.advance(now_ns / NS)
                if self._participant is not None:
                    self._say(tick, now_ns)

    # -- what it hears

    def _on_command(self, payload: memoryview, writer: bytes, t_ns: int) -> None:
        if self._machine.faults.of(None) is Fault.OFF:
            return
        body = bytes(payload[4:])
        try:
            command = self._commands.decode(body)
        except MalformedFrame:
            self._log.write(t_ns, "host", [("garbled", body)])
            return
        safe_state = safe_state_of(command)
        self._log.write(t_ns, "host", [("safe" if safe_state else "setpoint", body)], safe_state)
        self.onboard.command(command, t_ns / NS)

    def _on_request(self, service: str, payload: memoryview, t_ns: int) -> None:
        if self._machine.faults.of(None) is Fault.OFF:
            return
        body = bytes(payload[4:])
        try:
            request = rpc.decode_request(body)
        except MalformedFrame:
            self._log.write(t_ns, "host", [("garbled", body)])
            return
        self._log.write(t_ns, "host", [("read" if request.api in _READS else "config", body)])
        response = self.onboard.serve(service, request)
        if response is not None and not request.no_reply:
            answer = rpc.encode_response(response)
            self._log.write(time.monotonic_ns(), "robot", [("answer", answer)])
            self._answers[service].write(CDR + answer)

    # -- what it says

    def _say(self, tick: int, now_ns: int) -> None:
        faults = self._machine.faults
        fault = faults.of(None)
        state = self.onboard.state()
        if fault is Fault.WRONG:
            state = state._replace(q=tuple(rad + WRONG_RAD for rad in state.q))
        if fault is not Fault.STUCK or not self._held:
            self._held = self._states.encode(state)
        reply = faults.apply(Reply(0.0, self._held))
        if reply is not None:
            late_ns = round((reply.delay_s + reply.late_s) * NS)
            self._late.append((now_ns + late_ns, CDR + reply.data))
        while self._late and self._late[0][0] <= now_ns:
            self._state_writer.write(self._late.popleft()[1])
        battery, soc = self._battery_writer, self.onboard.soc
        if battery is not None and soc is not None and fault is not Fault.OFF and tick % BATTERY_EVERY == 0:
            battery.write(CDR + p.encode_battery(soc))

    def _note(self, kind: str, text: str) -> None:
        self._log.write(time.monotonic_ns(), "robot", [(kind, text.encode())])

    # -- what may happen to it

    def set_fault(self, text: str) -> None:
        """``WORD`` or ``WORD:slot``. Raise ``ValueError`` for another word."""
        self._machine.set_fault(*parse_fault(text))

    def power_cycle(self) -> None:
        self.onboard.reset()

    def freeze(self, seconds: float) -> None:
        """The robot neither reads nor says anything for so long; then it takes up what waited."""
        self._frost.freeze(seconds)

    def order(self, words: Sequence[str]) -> bool:
        match words:
            case ["fsm", number] if number.isdecimal():
                self.onboard.set_fsm(int(number))
            case ["mode", name]:
                self.onboard.set_mode("" if name == "-" else name)
            case ["battery", "unknown"]:
                self.onboard.soc = None
            case ["battery", percent] if percent.isdecimal() and int(percent) <= 100:
                self.onboard.soc = int(percent)
            case _:
                return False
        return True


def main(robot: str, *, options: Mapping[str, Any] | None = None, **start: Unpack[Start]) -> None:
    """Serve a robot of ``robots.toml`` until interrupted (see ``common.twin.run``)."""
    given = known_options(options, OPTIONS)
    model = model_of(robot)
    run_first(TWIN_PRIORITY)

    def build(wire_log: WireLog) -> UnitreeServer:
        return UnitreeServer(model, wire_log, given)

    run_server(build, **start)
