"""The RTDE server of a simulated controller.

It agrees with each client on the variables of its packets (a recipe), sends samples, and lets only one client write
each input.
"""

from __future__ import annotations

import struct
from collections import deque
from collections.abc import Callable

from strands_actors.drivers.common.codecs.malformed import MalformedFrame
from strands_actors.drivers.common.twin import Connection, Fault, Faults, Reply
from strands_actors.drivers.ur import protocol as p

from . import commands as c
from .controller import TICK_HZ, Controller
from .outputs import INPUT_TYPES, OUTPUTS, Sample
from .requests import PACKETS

VERSION = struct.pack(">4I", 5, 13, 1, 0)
WRONG_BY_RAD = 0.5
TEXT_ERROR = 1


def _text_message(text: str) -> bytes:
    """Return the payload of an RTDE text message: the text, then its source and its severity."""
    message = text.encode()[:255]
    return bytes((len(message),)) + message + b"\x04RTDE" + bytes((TEXT_ERROR,))


def _text_of(payload: bytes) -> str:
    """Return the text of a client's RTDE text message. Raise ``MalformedFrame`` if the payload is too short.

    The length of the text comes first, then the text, its source with a length, and the severity.
    """
    size = payload[0] if payload else 0
    if len(payload) < 1 + size + 2:
        raise MalformedFrame(f"a text message of {len(payload)} bytes")
    return payload[1 : 1 + size].decode("utf-8", "replace")


class RtdeServer:
    """Serve all RTDE clients of one simulated controller."""

    def __init__(self, controller: Controller, faults: Faults) -> None:
        self.controller = controller
        self.faults = faults
        self.owners: dict[str, Client] = {}
        self._clients: set[Client] = set()

    async def handle(self, connection: Connection) -> None:
        client = Client(self, connection)
        self._clients.add(client)
        try:
            await client.serve()
        finally:
            self._clients.discard(client)
            for name in [name for name, owner in self.owners.items() if owner is client]:
                del self.owners[name]

    def push(self, tick: int, now_s: float, sample: Callable[[], Sample]) -> None:
        """Send the sample of a tick to each client that receives one in this tick, by its rate."""
        for client in self._clients:
            if client.wants(tick):
                client.queue(sample(), now_s)
            client.flush(now_s)


class Client:
    def __init__(self, server: RtdeServer, connection: Connection) -> None:
        self._server = server
        self._connection = connection
        self._decoder = p.Decoder()
        self._outputs: p.Recipe | None = None
        self._every = 1
        self._started = False
        self._inputs: dict[int, p.Recipe] = {}
        self._waiting: deque[tuple[float, bytes]] = deque()
        self._stale: dict[str, p.Value] = {}

    async def serve(self) -> None:
        while True:
            t_ns, data = await self._connection.receive()
            try:
                for packet in self._decoder.feed(data):
                    self._try(t_ns, packet)
            except MalformedFrame as malformed:  # The next packet cannot be located any more, so hang up.
                self._refuse(t_ns, data, str(malformed))
                self._connection.hang_up()
                return

    def _try(self, t_ns: int, packet: p.Packet) -> None:
        try:
            self._handle(t_ns, packet)
        except MalformedFrame as malformed:
            self._refuse(t_ns, p.frame(*packet), str(malformed))

    def _refuse(self, t_ns: int, raw: bytes, reason: str) -> None:
        """Log bytes that cannot be decoded, also in the controller's own log, and send the client the reason."""
        self._connection.log_received(t_ns, "malformed", raw)
        self._server.controller.note(f"RTDE: {reason}")
        self._connection.send_logged("read", p.frame(p.Kind.TEXT, _text_message(f"RTDE: {reason}")))

    def wants(self, tick: int) -> bool:
        return self._started and self._outputs is not None and tick % self._every == 0

    def queue(self, sample: Sample, now_s: float) -> None:
        """Queue a sample for the client. Samples are not logged, because they would hide all other lines."""
        assert self._outputs is not None
        faults = self._server.faults
        fault = faults.of(None)
        values = {name: sample[name] for name in self._outputs.names}  # Reading an output computes it.
        if fault is Fault.STUCK:
            values = self._stale or values
        elif (
            fault is Fault.WRONG and "actual_q" in values
        ):  # Falsify the joint positions, if the client reads them.
            wrong = values["actual_q"]
            assert isinstance(wrong, tuple)
            values["actual_q"] = tuple(rad + WRONG_BY_RAD for rad in wrong)
        self._stale = values
        reply = faults.apply(Reply(0.0, self._outputs.pack(values)))
        if reply is not None:
            self._waiting.append((now_s + reply.delay_s + reply.late_s, reply.data))

    def flush(self, now_s: float) -> None:
        while self._waiting and self._waiting[0][0] <= now_s:
            self._connection.send(self._waiting.popleft()[1])

    def _handle(self, t_ns: int, packet: p.Packet) -> None:
        raw = p.frame(*packet)
        if packet.kind not in PACKETS:
            raise MalformedFrame(f"a packet of kind {packet.kind}, which no client sends")
        if packet.kind == p.Kind.DATA:
            self._take(t_ns, raw, packet.payload)
            return
        self._connection.log_received(t_ns, "config" if packet.kind == p.Kind.INPUTS else "read", raw)
        answer = self._answer(packet)
        if answer is not None:
            self._connection.send_logged("read", p.frame(packet.kind, answer))

    def _take(self, t_ns: int, raw: bytes, payload: bytes) -> None:
        recipe = self._inputs.get(payload[0]) if payload else None
        if recipe is None:
            raise MalformedFrame("data of a recipe that was not agreed")
        values = recipe.unpack(payload)
        number = next((values[name] for name in COMMAND_REGISTERS if name in values), None)
        kind = c.classify_command(number) if isinstance(number, int) else "config"
        self._connection.log_received(t_ns, kind, raw)
        self._server.controller.write(values)

    def _answer(self, packet: p.Packet) -> bytes | None:
        payload = packet.payload
        match packet.kind:
            case p.Kind.VERSION:
                return b"\x01" if payload == struct.pack(">H", p.RTDE_VERSION) else b"\x00"
            case p.Kind.CONTROLLER:
                return VERSION
            case p.Kind.OUTPUTS:
                return self._agree_outputs(payload)
            case p.Kind.INPUTS:
                return self._agree_inputs(payload)
            case p.Kind.START:
                self._started = self._outputs is not None
                return b"\x01" if self._started or self._inputs else b"\x00"
            case p.Kind.PAUSE:
                self._started = False
                return b"\x01"
            case p.Kind.TEXT:
                self._server.controller.log.append(_text_of(payload))
        return None  # A controller does not answer a text message.

    def _agree_outputs(self, payload: bytes) -> bytes:
        if len(payload) < 8:
            raise MalformedFrame(f"{len(payload)} bytes of asked outputs, the rate alone has 8")
        (hz,) = struct.unpack_from(">d", payload)
        names = _names(payload[8:])
        types = [OUTPUTS[name][0] if name in OUTPUTS else c.NOT_FOUND for name in names]
        if c.NOT_FOUND not in types:
            self._outputs = p.Recipe(1, names, types)
            self._stale = {}  # The last sample has other variables, so it cannot be repeated.
            self._every = max(1, round(TICK_HZ / hz)) if hz > 0 else 1
        return b"\x01" + ",".join(types).encode()

    def _agree_inputs(self, payload: bytes) -> bytes:
        names, owners = _names(payload), self._server.owners
        types = [
            c.IN_USE if owners.get(name, self) is not self else INPUT_TYPES.get(name, c.NOT_FOUND) for name in names
        ]
        number = 0
        if c.IN_USE not in types and c.NOT_FOUND not in types:
            number = len(self._inputs) + 1
            self._inputs[number] = p.Recipe(number, names, types)
            owners.update(dict.fromkeys(names, self))
        return bytes([number]) + ",".join(types).encode()


COMMAND_REGISTERS = ("input_int_register_0", f"input_int_register_{c.UPPER_RANGE}")
"""The registers from which a control script may read its command: the first of the lower and of the upper range."""


def _names(text: bytes) -> list[str]:
    return [name for name in text.decode("ascii", "replace").split(",") if name]
