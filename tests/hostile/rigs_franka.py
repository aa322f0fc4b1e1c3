"""Rig of an arm that is stopped over TCP and moved by 1,000 datagrams a second: Franka over FCI.

The process of the 1 kHz cycle is a task here, which runs the product's own turns.
"""

from __future__ import annotations

import contextlib
import itertools
import os
import socket
from collections import deque
from collections.abc import AsyncIterator, Iterator, Mapping, Sequence
from types import SimpleNamespace
from typing import Any

import msgspec
import trio

from strands_actors.contract.wire import Wire
from strands_actors.drivers.common.twin.tcp import Connection
from strands_actors.drivers.franka import client, cycle
from strands_actors.drivers.franka import protocol as p
from strands_actors.drivers.franka import wire as franka_wire
from strands_actors.drivers.franka.arms import arm_of
from strands_actors.drivers.franka.driver import Franka
from strands_actors.drivers.franka.generator import Limits
from strands_actors.drivers.franka.twin.controller import TICK_S, Controller
from strands_actors.drivers.franka.twin.server import IDLE_TICKS, FrankaServer, FrankaTwin
from strands_actors.drivers.franka.wire import FrankaWire
from strands_actors.kernel.clock import Clock, VirtualClock
from strands_actors.kernel.health.heartbeat import Heartbeat, words_of

from .bench import Bench, Rig
from .datagrams import Datagrams, HostileSocket
from .peer import HostilePeer, HostileStream
from .services import Service

HOST, ROBOT = "192.0.2.9", "192.0.2.1"
SILENT_S = cycle.SILENT_MS / 1e3


class _Udp:
    """The host's socket for states. The process to which it is passed has it, too."""

    def __init__(self, robot: _Robot) -> None:
        self._robot = robot
        self._port = next(robot.ports)
        self._from = (ROBOT, 1)
        self.inner = Datagrams(robot.commands.append)
        self.hostile = HostileSocket(robot.peer, self.inner, restart=lambda: None)
        self.given_away = False
        robot.sockets[self._port] = self

    def setblocking(self, flag: bool) -> None:
        """Do nothing: this socket never blocks."""

    def bind(self, address: tuple[str, int]) -> None:
        """Do nothing: the socket has its port already."""

    def getsockname(self) -> tuple[str, int]:
        return HOST, self._port

    def connect(self, address: tuple[str, int]) -> None:
        """Do nothing: no other peer sends to this socket."""

    def fileno(self) -> int:
        return self.hostile.fileno()

    def recv(self, size: int) -> bytes:
        data = self.hostile.receive()
        if data is None:
            raise BlockingIOError
        return data[:size]

    def recvfrom(self, size: int) -> tuple[bytes, tuple[str, int]]:
        return self.recv(size), self._from

    def send(self, data: bytes) -> int:
        self.hostile.write(data)
        return len(data)

    def close(self) -> None:
        if not self.given_away:
            self.end()

    def end(self) -> None:
        self._robot.sockets.pop(self._port, None)
        self.hostile.close()

    def __enter__(self) -> _Udp:
        self.given_away = True
        return self

    def __exit__(self, *error: object) -> None:
        """Do nothing: the other process keeps the socket."""


class _Cycle:
    """The task in place of the process of the 1 kHz cycle."""

    def __init__(self, udp: _Udp, told: Mapping[str, Any], nursery: trio.Nursery) -> None:
        self.pid = os.getpid()
        self.socket = SimpleNamespace(close=lambda: None)
        self._udp = udp
        self._wire = socket.socket(fileno=os.dup(told["wire"]))
        self._wire.setblocking(False)
        self._heartbeat = Heartbeat(words_of(told["page"]), cycle.CYCLE_END, cycle.WIRE_END)
        dialect = p.DIALECTS[told["fci"]]
        self._cycle = cycle.Cycle(dialect, msgspec.convert(told["limits"], Limits), self._heartbeat)
        self._reporter = cycle.Reporter(dialect, told["stride"])
        self._scope = trio.CancelScope()
        nursery.start_soon(self._run)

    @property
    def alive(self) -> bool:
        return not self._scope.cancel_called

    async def _run(self) -> None:
        clock = VirtualClock()
        try:
            with self._scope:
                while True:
                    state = b""
                    with trio.move_on_after(SILENT_S):
                        await self._udp.hostile.readable()
                        state = cycle.newest(self._udp)
                    cycle.turn(
                        self._cycle, self._reporter, state, self._udp, self._wire, self._heartbeat, clock.now_ns()
                    )
        finally:
            self._udp.end()
            self._wire.close()

    def kill(self) -> None:
        self._scope.cancel()

    async def wait(self) -> int:
        return 0


class _Robot(FrankaServer):
    """The twin's server, on streams and datagrams in memory."""

    def __init__(self, peer: HostilePeer) -> None:  # not its own: that opens sockets
        self.peer = peer
        self.controller = Controller(arm_of("panda"), 5)
        self.service = Service(peer, self._attend_client)
        self.sockets: dict[int, _Udp] = {}
        self.ports: Iterator[int] = itertools.count(40_000)
        self.commands: deque[bytes] = deque()
        self._twin = FrankaTwin(self.controller)
        self._listeners_of_state: dict[Connection, tuple[str, int]] = {}
        self._mover = None
        self._hand = None
        self._late = deque()
        self._log = self.service.log  # type: ignore[assignment]
        self._udp = self  # type: ignore[assignment]

    def recv(self, size: int) -> bytes:
        if not self.commands:
            raise BlockingIOError
        return self.commands.popleft()

    def sendto(self, data: bytes, address: tuple[str, int]) -> None:
        if address[1] in self.sockets:
            self.sockets[address[1]].inner.put(data)

    async def live(self) -> None:
        while True:
            ticks = IDLE_TICKS if self.controller.motion is None else 1
            await trio.sleep(ticks * TICK_S)
            self._take_commands()
            for _ in range(ticks):
                self._tick()

    async def open_tcp(self, host: str, port: int) -> HostileStream:
        stream = await self.service.open_stream(host, port)
        stream.own_host, stream.peer_host = HOST, ROBOT  # type: ignore[attr-defined]
        return stream  # type: ignore[return-value]


def _franka(peer: HostilePeer) -> Bench:
    robot = _Robot(peer)
    driver = Franka("panda", ROBOT, {})
    wires: list[Wire] = []
    wait_readable = trio.lowlevel.wait_readable

    async def readable(end: Any) -> None:
        await (end.hostile.readable() if isinstance(end, _Udp) else wait_readable(end))

    @contextlib.asynccontextmanager
    async def living() -> AsyncIterator[None]:
        opened: list[_Udp] = []

        def open_udp(type: int) -> _Udp:
            opened.append(_Udp(robot))
            return opened[-1]

        async with robot.service.living(), trio.open_nursery() as nursery:

            def start(entry: str, told: Mapping[str, Any], descriptors: Sequence[int]) -> _Cycle:
                udp = next(udp for udp in opened if udp.fileno() == told["udp"])
                return _Cycle(udp, told, nursery)

            places: list[tuple[Any, str, Any]] = [
                (client, "open_tcp", robot.open_tcp),
                (client, "socket", SimpleNamespace(socket=open_udp, SOCK_DGRAM=socket.SOCK_DGRAM)),
                (franka_wire, "start", start),
                (trio.lowlevel, "wait_readable", readable),
            ]
            before = [getattr(module, name) for module, name, _ in places]
            for module, name, value in places:
                setattr(module, name, value)
            try:
                nursery.start_soon(robot.live)
                yield
                nursery.cancel_scope.cancel()
            finally:
                for wire in wires:
                    wire.close()  # as the end of the wire process does
                for (module, name, _), value in zip(places, before, strict=True):
                    setattr(module, name, value)

    def open_wire(clock: Clock) -> Wire:
        wires.append(FrankaWire(driver.config, clock))
        return wires[-1]

    driver.open_wire = open_wire  # type: ignore[method-assign]
    return Bench(driver, lambda: robot.service.log.entries, living)


def _all_joints(position: Sequence[float]) -> dict[str, float]:
    """Return a command that names all joints, as this arm requires."""
    return {f"joint{at}": rad + 0.01 * (at == 1) for at, rad in enumerate(position, 1)}


_FER = p.DIALECTS[5]
_STOPPED = p.HEADER.pack(_FER.commands.index("stop"), 1_000_000, p.HEADER.size + 1) + b"\0"


def _old_state() -> bytes:
    """Return the state of an idle arm soon after its start."""
    data = bytearray(_FER.state_bytes)
    _FER.put(data, "message_id", 7)
    _FER.put(data, "robot_mode", p.RobotMode.IDLE)
    return bytes(data)


def _renumbered(data: bytes) -> bytes:
    """Return an answer to the next request, with a time far in the future."""
    if len(data) == _FER.state_bytes:
        state = bytearray(data)
        _FER.put(state, "message_id", _FER.get(state, "message_id")[0] + (1 << 40))
        return bytes(state)
    if len(data) < p.HEADER.size:
        return data
    code, number, size = p.HEADER.unpack_from(data)
    return p.HEADER.pack(code, number + 1, size) + data[p.HEADER.size :]


RIGS: Mapping[str, Rig] = {
    "panda": Rig(
        _franka,
        _all_joints,
        quick=("garbled", "older answers", "flood"),
        floods={"unasked answers": _STOPPED, "an old state": _old_state(), "noise": b"\x07" * 300},
        bombs={"an answer of 4 GB": p.HEADER.pack(2, 1, 0xFFFFFFFF)},
        wrong_ids={"number": _renumbered},
        streams=True,
        bound_s=0.1,  # the published bound
    ),
}
