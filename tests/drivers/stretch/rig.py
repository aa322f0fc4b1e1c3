"""The twin's robot behind ports in memory, for the wire in virtual time."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import PurePath
from typing import Any

import msgspec
import trio

from strands_actors.contract.wire import WireDown
from strands_actors.drivers.stretch import frames as f
from strands_actors.drivers.stretch import protocol as p
from strands_actors.drivers.stretch.config import StretchConfig
from strands_actors.drivers.stretch.parameters import parameters_of
from strands_actors.drivers.stretch.stop_channel import StretchStopChannel
from strands_actors.drivers.stretch.twin.boards import DeviceDecoder
from strands_actors.drivers.stretch.twin.server import decoders_of
from strands_actors.drivers.stretch.twin.world import World
from strands_actors.drivers.stretch.wire import StretchWire
from strands_actors.kernel.clock import VirtualClock
from tests.drivers.common.memory_port import MemoryPort, Peer

ANSWER_S = 0.001
"""The delay that USB adds to each answer."""

LIFT, ARM, LEFT, RIGHT = "hello-motor-lift", "hello-motor-arm", "hello-motor-left-wheel", "hello-motor-right-wheel"
PIMU, WRIST, HEAD = "hello-pimu", "hello-dynamixel-wrist", "hello-dynamixel-head"


class OneReader(MemoryPort):
    """A port on which only one task may wait at a time, as on a real port."""

    _waits = False

    async def read(self) -> bytes:
        if self._waits:
            raise trio.BusyResourceError("another task is reading this port")
        self._waits = True
        try:
            return await super().read()
        finally:
            self._waits = False


class Rig:
    """One robot. ``changes`` are changes of its parameters."""

    def __init__(self, **changes: Any) -> None:
        self.world = World("stretch3", trio.current_time)
        self.decoders: dict[str, DeviceDecoder] = {
            name: decoder for name, (decoder, _) in decoders_of(self.world).items()
        }
        self.ports: dict[str, list[MemoryPort]] = {}
        self.kinds: list[tuple[str, str, str | None]] = []
        """The messages of each port: its name, kind and safe state."""
        self.mute: set[str] = set()
        self.gone: set[str] = set()
        self.config = StretchConfig("stretch3", msgspec.structs.replace(parameters_of("stretch3"), **changes))

    def wire(self) -> StretchWire:
        return StretchWire(self.config, VirtualClock(), self.open_port)

    def stop_channel(self) -> StretchStopChannel:
        return StretchStopChannel(self.config, (), VirtualClock(), self.open_port)

    def open_port(self, path: str, baud: int) -> MemoryPort:
        name = PurePath(path).name
        if name in self.gone:
            raise WireDown(f"{path}: cannot open")
        port = OneReader(self._peer(name))
        self.ports.setdefault(name, []).append(port)
        return port

    def _peer(self, name: str) -> Peer:
        def peer(data: bytes) -> Iterable[tuple[float, bytes]]:
            for heard in self.decoders[name].frames(data, 115_200):
                exchange = heard.act()
                self.kinds.append((name, exchange.kind, exchange.safe_state))
                if name not in self.mute:
                    for reply in exchange.replies:
                        yield ANSWER_S + reply.delay_s + reply.late_s, reply.data

        return peer

    def unplug(self, name: str) -> None:
        self.gone.add(name)
        for port in self.ports.get(name, ()):
            port.unplugged = True

    def ports_written(self, *kinds: str) -> list[str]:
        """Return the ports that received frames of these kinds."""
        return [name for name, kind, _ in self.kinds if kind in kinds]

    def commands(self, name: str) -> list[p.Command]:
        """Return the commands to a stepper on all its ports."""
        return [
            p.parse_command(frame.data[1:])
            for port in self.ports[name]
            for _, data in port.written
            for frame in f.Decoder().feed(data)
            if frame.data[:1] == bytes((p.COMMAND,))
        ]
