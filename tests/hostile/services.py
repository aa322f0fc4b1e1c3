"""Robots behind HTTP and WebSockets, in virtual time: the twins' own servers on streams in memory."""

from __future__ import annotations

import contextlib
from collections.abc import AsyncIterator, Callable, Mapping, Sequence
from functools import partial
from typing import Any

import msgspec
import trio

from strands_actors.drivers.common.ports.http_port import HttpPort
from strands_actors.drivers.common.ports.tcp_port import OrderlyStream
from strands_actors.drivers.common.ports.websocket import begin_websocket, open_websocket
from strands_actors.drivers.common.twin.http import HttpSession
from strands_actors.drivers.common.twin.http import serving as serving_http
from strands_actors.drivers.common.twin.tcp import ClientGone, Handler
from strands_actors.drivers.common.twin.websocket import serving_both, serving_websocket
from strands_actors.drivers.earthrover.config import EarthRoverConfig
from strands_actors.drivers.earthrover.driver import EarthRover
from strands_actors.drivers.earthrover.robots import TABLES as ROVERS
from strands_actors.drivers.earthrover.stop import EarthRoverStopChannel
from strands_actors.drivers.earthrover.twin import RoverTwin
from strands_actors.drivers.earthrover.wire import EarthRoverWire
from strands_actors.drivers.reachy import services as reachy_services
from strands_actors.drivers.reachy import stop as reachy_stop
from strands_actors.drivers.reachy import wire as reachy_wire
from strands_actors.drivers.reachy.driver import Reachy
from strands_actors.drivers.reachy.twin import ReachyTwin
from strands_actors.drivers.yahboom.driver import YahboomM3Pro
from strands_actors.drivers.yahboom.rosbridge import RosbridgeLink
from strands_actors.drivers.yahboom.stop import StopLink, YahboomStopChannel
from strands_actors.drivers.yahboom.twin import M3ProTwin
from strands_actors.drivers.yahboom.twin.bridge import serving as serving_bridge
from strands_actors.drivers.yahboom.wire import YahboomWire
from tests.drivers.common.memory_stream import MemoryConnection, MemoryStream, Pipe

from .bench import Bench, Log
from .peer import HostilePeer, HostileStream


class EntryLog:
    """A wire log in virtual time."""

    def __init__(self) -> None:
        self.entries: Log = []

    def write(
        self, t_ns: int, sender: str, frames: Sequence[tuple[str, bytes]], safe_state: str | None = None
    ) -> None:
        if sender == "host":
            for kind, _ in frames:
                self.note(kind)

    def note(self, kind: str) -> None:
        self.entries.append((trio.current_time(), kind))


class Service:
    """One robot with output that ``peer`` changes.

    Args:
        handler: The handler of its only port, or the handlers by port number.
    """

    def __init__(self, peer: HostilePeer, handler: Handler | Mapping[int, Handler]) -> None:
        self._peer = peer
        self._handler = handler
        self._nursery: trio.Nursery | None = None
        self.log = EntryLog()

    @contextlib.asynccontextmanager
    async def living(self) -> AsyncIterator[None]:
        async with trio.open_nursery() as self._nursery:
            yield
            self._nursery.cancel_scope.cancel()

    async def open_stream(self, host: str, port: int) -> OrderlyStream:
        await trio.lowlevel.checkpoint()
        assert self._nursery is not None
        to_robot, to_host = Pipe(), Pipe()
        handler = self._handler[port] if isinstance(self._handler, Mapping) else self._handler
        self._nursery.start_soon(self._serve, handler, MemoryConnection(to_robot, to_host, self.log))
        return HostileStream(self._peer, MemoryStream(to_robot, to_host))

    async def _serve(self, handler: Handler, connection: MemoryConnection) -> None:
        try:
            await handler(connection)
        except* ClientGone:
            pass
        finally:
            connection.abort()


class _RoverConfig(EarthRoverConfig, frozen=True):
    service: Any = None

    def open_port(self) -> HttpPort:
        return HttpPort(*self.address(), self.service.open_stream)


def earthrover(peer: HostilePeer) -> Bench:
    twin = RoverTwin(ROVERS.table("earthrover"), trio.current_time)
    service = Service(peer, serving_http(twin))
    driver = EarthRover("earthrover", "192.0.2.1", {})
    config = _RoverConfig(**msgspec.structs.asdict(driver.config), service=service)
    driver.open_wire = partial(EarthRoverWire, config)  # type: ignore[method-assign]
    driver.stop_channel = partial(EarthRoverStopChannel, config)  # type: ignore[method-assign]
    return Bench(driver, lambda: service.log.entries, service.living)


class _YahboomChannel(YahboomStopChannel):
    link: Callable[[], StopLink]

    def new_link(self) -> StopLink:
        return self.link()


def yahboom(peer: HostilePeer) -> Bench:
    twin = M3ProTwin("yahboom_m3pro", trio.current_time)
    serve = serving_bridge(twin.graph)
    service = Service(peer, serving_websocket(lambda path: serve))
    driver = YahboomM3Pro("yahboom_m3pro", "192.0.2.1", {})
    open_socket = partial(begin_websocket, open_stream=service.open_stream)

    def open_wire(clock: Any) -> YahboomWire:
        links = [RosbridgeLink(driver.config, clock, open_socket) for _ in range(2)]
        return YahboomWire(driver.config, clock, *links)

    def stop_channel(descriptors: Sequence[int], clock: Any) -> YahboomStopChannel:
        channel = _YahboomChannel(driver.config, descriptors, clock)
        channel.link = lambda: RosbridgeLink(driver.config, clock, open_socket)
        return channel

    driver.open_wire = open_wire  # type: ignore[method-assign]
    driver.stop_channel = stop_channel  # type: ignore[method-assign]
    return Bench(driver, lambda: service.log.entries, service.living)


def reachy(peer: HostilePeer) -> Bench:
    twin = ReachyTwin("reachy_mini", trio.current_time)
    service = Service(peer, serving_both(lambda: HttpSession(twin), twin.choose))
    driver = Reachy("reachy_mini", "192.0.2.1", {})

    @contextlib.asynccontextmanager
    async def living() -> AsyncIterator[None]:
        """Let the modules of the wire open streams in memory."""
        stream = service.open_stream
        here: dict[str, Any] = {
            "HttpPort": lambda host, number, **more: HttpPort(host, number, stream, **more),
            "begin_websocket": partial(begin_websocket, open_stream=stream),
            "open_websocket": partial(open_websocket, open_stream=stream),
        }
        modules = (reachy_stop, reachy_wire, reachy_services)
        places = [(module, name) for module in modules for name in here if hasattr(module, name)]
        before = [getattr(module, name) for module, name in places]
        for module, name in places:
            setattr(module, name, here[name])
        try:
            async with service.living():
                yield
        finally:
            for (module, name), value in zip(places, before, strict=True):
                setattr(module, name, value)

    return Bench(driver, lambda: service.log.entries, living, twin)
