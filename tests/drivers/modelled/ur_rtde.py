"""Walk of the packets of a UR controller's RTDE."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from typing import Any

from strands_actors.drivers.common.twin import Faults
from strands_actors.drivers.ur import protocol as p
from strands_actors.drivers.ur.twin.requests import PACKETS
from strands_actors.drivers.ur.twin.rtde import Client, RtdeServer
from tests.drivers.ur.world import World

from .walk import Answer, Walk


class Wire:
    """The client's end of an RTDE connection."""

    def __init__(self) -> None:
        self.sent: list[bytes] = []

    def log_received(self, t_ns: int, kind: str, data: bytes) -> None: ...

    def send_logged(self, kind: str, data: bytes) -> None:
        self.sent.append(data)


class RtdeWorld(World):
    def __init__(self) -> None:
        super().__init__()
        self.wire = Wire()
        self.server = RtdeServer(self.controller, Faults())
        wire: Any = self.wire
        self.client = Client(self.server, wire)


def ask_packet(world: RtdeWorld, kind: int, payload: bytes) -> Answer:
    before, events = len(world.controller.log), len(world.events)
    world.client._try(0, p.Packet(kind, payload))
    replies = [packet for data in world.wire.sent for packet in p.Decoder().feed(data)]
    noted = list(world.controller.log)[before:]
    world.wire.sent.clear()
    for _ in noted:  # A refusal is noted in the log, which is no effect of the packet.
        world.controller.log.pop()
    del world.events[events:]
    refused = any(reply.kind == p.Kind.TEXT for reply in replies)
    if kind in (p.Kind.DATA, p.Kind.TEXT):
        return Answer(not refused and not replies, noted)
    content = replies[0].payload if replies else b""
    if kind == p.Kind.CONTROLLER:
        return Answer(not refused and bool(content), content)
    return Answer(not refused and content[:1] not in (b"", b"\0"), content if kind == p.Kind.VERSION else b"")


def with_outputs(world: RtdeWorld) -> None:
    ask_packet(world, p.Kind.OUTPUTS, ASKED)


def with_samples(world: RtdeWorld) -> None:
    with_outputs(world)
    ask_packet(world, p.Kind.START, b"")


def with_inputs(world: RtdeWorld) -> None:
    ask_packet(world, p.Kind.INPUTS, b"input_int_register_5")


ASKED = struct.pack(">d", 125.0) + b"actual_q,timestamp"


def walks() -> Iterator[Walk]:
    """Yield the walk of this module."""
    yield Walk(
        "rtde",
        PACKETS,
        range(256),
        RtdeWorld,
        ask_packet,
        {
            p.Kind.VERSION: struct.pack(">H", p.RTDE_VERSION),
            p.Kind.CONTROLLER: b"",
            p.Kind.OUTPUTS: ASKED,
            p.Kind.INPUTS: b"input_int_register_5",
            p.Kind.START: b"",
            p.Kind.PAUSE: b"",
            p.Kind.DATA: struct.pack(">Bi", 1, 7),
            p.Kind.TEXT: b"\x05hello\x04test\x02",
        },
        (b"", b"\0", b"\1", ASKED, b"input_int_register_5"),
        {p.Kind.START: with_outputs, p.Kind.PAUSE: with_samples, p.Kind.DATA: with_inputs},
    )
