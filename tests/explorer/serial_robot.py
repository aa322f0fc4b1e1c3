"""Model a robot by a twin with several serial ports. The bytes that a process writes are handled at once."""

from __future__ import annotations

import os
from abc import abstractmethod
from collections.abc import Iterable
from functools import partial
from types import ModuleType
from typing import ClassVar, Protocol

from strands_actors.contract.loading import load
from strands_actors.drivers.common.twin import Exchange

from .hostile_peer import HostilePeer
from .kinds import PEER
from .plan import Event
from .robot_model import Effect, Seam, put
from .serial_line import SerialLine, SimPort
from .twin_robot import TwinRobot
from .world import World

TICK_S = 0.01
ANSWER_S = 0.001
"""The delay that USB adds to each answer."""
LATE_S = 0.06
BITS_PER_S = 115_200


class Device(Protocol):
    """A device of the twin, at one port."""

    def exchanges(self, data: bytes) -> Iterable[Exchange]:
        """Carry out the frames that these bytes complete."""
        ...


class SerialRobot(TwinRobot):
    """A robot at serial ports. Each has a cable of its own, but faults hit all of them, except ``mute``.

    Attributes:
        ADOPTERS: Modules that make a port of a descriptor.
        lines: The ports by path.
    """

    ADOPTERS: ClassVar[tuple[ModuleType, ...]]

    def __init__(self, world: World, robot: str) -> None:
        super().__init__(world, robot)
        self.peer = HostilePeer(world.rng("peer"))
        devices = self.devices()
        self.lines = {
            path: SerialLine(world, path, partial(self._hear, path, device)) for path, device in devices.items()
        }
        self.late_s = 0.0
        self.replies_lost = self.requests_lost = False
        self.mute: set[str] = set()
        self._answers = {path: self.peer.stream() for path in devices}
        world.after(TICK_S, self._tick)

    @abstractmethod
    def devices(self) -> dict[str, Device]:
        """Return the device at each port, by path."""

    def seams(self) -> tuple[Seam, ...]:
        driver_class = self.driver_class
        wire, channel = load(driver_class.WIRE), load(driver_class.STOP_CHANNEL)
        return (
            *super().seams(),
            (driver_class, "open_wire", lambda driver, clock: wire(driver.config, clock, self.open_port)),
            (
                driver_class,
                "stop_channel",
                lambda driver, fds, clock: channel(driver.config, fds, clock, self.open_port),
            ),
            *((module, "adopt_serial", self._adopt) for module in self.ADOPTERS),
        )

    def open_port(self, path: str, baud: int) -> SimPort:
        return self.lines[path].open(path, baud)

    def effect(self, event: Event) -> Effect | None:
        match event.kind:
            case "lose replies":
                return put(self, "replies_lost", True, False)
            case "lose requests":
                return put(self, "requests_lost", True, False)
            case "mute":
                path = list(self.lines)[event.motor % len(self.lines)]
                return lambda: self.mute.add(path), lambda: self.mute.discard(path)
            case "late":
                return put(self, "late_s", LATE_S, 0.0)
            case "pull":
                return self._pull, self._put_back
            case kind if kind in PEER:
                return put(self.peer, "kind", kind, "")
        return super().effect(event)

    def mend(self) -> None:
        super().mend()
        self.late_s, self.peer.kind = 0.0, ""
        self.replies_lost = self.requests_lost = False
        self.mute.clear()
        self._put_back()

    def _pull(self) -> None:
        for line in self.lines.values():
            line.pull()

    def _put_back(self) -> None:
        for line in self.lines.values():
            line.put_back()

    def _adopt(self, fd: int, name: str) -> SimPort:
        """As ``adopt_serial``."""
        return self.lines[name].adopt(fd)

    # -- the robot's end of the lines

    def _hear(self, path: str, device: Device, data: bytes, role: str) -> Iterable[tuple[float, bytes]]:
        if self.requests_lost:
            self.world.note("wire", "loses", f"{role}: {os.path.basename(path)} {data.hex()}")
            return
        for exchange in device.exchanges(data):
            self.note_frame(exchange.kind, exchange.safe_state, role, self.world.now_s)
            at_s = ANSWER_S
            for reply in exchange.replies:
                at_s += reply.delay_s
                if not self.replies_lost and path not in self.mute:
                    late_s = self.late_s * self.rng.random() if self.late_s else 0.0
                    for piece in self._answers[path].spoil(self.spoil(reply.data)):
                        yield at_s + late_s, piece

    def _tick(self) -> None:
        self.pass_time()
        self.look()
        self.world.after(TICK_S, self._tick)
