"""Simulate the robot's end of the wire: a Kortex server on TCP with a base and its arm behind it.

Besides the control lines of every twin it takes ``state NAME`` and ``mode NAME``, with the names of
``protocol.ArmState`` and ``protocol.ServoingMode``. Passwords are blanked in its wire log.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Annotated, Any, Unpack

import msgspec
import trio

from strands_actors.contract.options import option
from strands_actors.drivers.common.codecs.malformed import MalformedFrame
from strands_actors.drivers.common.physics.controlled_body import ControlledBody
from strands_actors.drivers.common.twin import (
    ClientGone,
    Exchange,
    Fault,
    Faults,
    NetworkOptions,
    Port,
    Reply,
    Start,
    TcpServer,
    WireLog,
    answering,
    read_twin_options,
    run_server,
)

from . import protocol as p
from .base import Base, Second
from .robots import TABLES


class KinovaTwinOptions(NetworkOptions, frozen=True):
    port: Port = p.TCP_PORT
    username: Annotated[str, option("of those who may open a session")] = "admin"
    password: Annotated[str, option("theirs")] = "admin"
    second: Annotated[Second, option(f"what becomes of a second session: {', '.join(Second)}")] = Second.ACCEPTED


TICK_S = 0.01


class KinovaBody(ControlledBody):
    def __init__(self, base: Base) -> None:
        super().__init__(base.plant, base.advance)
        self._base = base

    @property
    def driven(self) -> bool:
        return self._base.driven

    @property
    def led(self) -> bool:
        return self._base.led

    def lead(self, on: bool) -> None:
        self._base.led = True
        self.hold()
        self._base.led = on

    def aim_controller(self, values: Sequence[float]) -> None:
        self._base.lead(list(values))

    def reset(self) -> None:
        super().reset()
        self._base.wake_up()


class KinovaTwin:
    """One arm that all clients share."""

    def __init__(self, base: Base) -> None:
        self.base = base
        self.body = KinovaBody(base)
        self.faults = Faults()

    def set_fault(self, fault: Fault, unit: int | None = None) -> None:
        """Set a fault. ``unit`` has no meaning here, because there is only one server."""
        self.base.advance()
        self.base.set_fault(fault)
        self.faults.set(fault)

    def power_cycle(self) -> None:
        self.base.wake_up()


class KortexSession:
    """The server's side of one client's connection."""

    def __init__(self, twin: KinovaTwin) -> None:
        self._twin = twin
        self._decoder = p.Decoder()

    def receive(self, data: bytes, bits_per_s: int | None) -> Iterator[Exchange]:
        for frame in self._decoder.feed(data):
            kind = self._twin.base.kind(frame)
            yield Exchange(kind, _without_password(frame).encode(), self._replies(frame, kind))
        if self._decoder.skipped:
            raise ClientGone  # A server closes the connection when it cannot decode it [assumed].

    def _replies(self, request: p.Frame, kind: str) -> list[Reply]:
        if request.kind != p.Kind.REQUEST or self._twin.faults.of(None) is Fault.OFF:
            return []
        reply = self._twin.faults.apply(Reply(0.0, self._twin.base.answer(self, request).encode(), None, kind))
        return [] if reply is None else [reply]


def _without_password(frame: p.Frame) -> p.Frame:
    if frame.call != p.Call.CREATE_SESSION:
        return frame
    try:
        login = msgspec.structs.replace(p.Login.decode(frame.payload), password="***")
    except MalformedFrame:
        return msgspec.structs.replace(frame, payload=b"")
    return msgspec.structs.replace(frame, payload=login.encode())


class KinovaServer(TcpServer):
    """Serve one arm and advance its time. The arm moves between requests, too."""

    def __init__(self, twin: KinovaTwin, port: int, log: WireLog, host: str | None) -> None:
        super().__init__(twin, {port: answering(lambda: KortexSession(twin))}, log, host)
        self._twin = twin

    def set_fault(self, text: str) -> None:
        was_off = self._twin.faults.of(None) is Fault.OFF
        super().set_fault(text)
        if self._twin.faults.of(None) is Fault.OFF:
            self.unplug()
        elif was_off:
            self.power_cycle()

    def power_cycle(self) -> None:
        """End every connection and every session."""
        super().power_cycle()
        self.unplug()
        self.plug()

    def order(self, words: Sequence[str]) -> bool:
        match words:
            case ["state", name] if name in p.ArmState.__members__:
                self._twin.base.set_state(p.ArmState[name])
            case ["mode", name] if name in p.ServoingMode.__members__:
                self._twin.base.mode = p.ServoingMode[name]
            case _:
                return False
        return True

    async def serve(self) -> None:
        async with trio.open_nursery() as nursery:
            nursery.start_soon(super().serve)
            nursery.start_soon(self._tick)

    async def _tick(self) -> None:
        while True:
            await self._frost.thawed()
            self._twin.base.advance()
            await trio.sleep(TICK_S)


def twin_of(robot: str, **options: Any) -> KinovaTwin:
    """Return the twin of a robot of ``robots.toml``. ``options`` are those of ``Base``."""
    return KinovaTwin(Base(TABLES.table(robot), **options))


def main(robot: str, *, options: Mapping[str, Any] | None = None, **start: Unpack[Start]) -> None:
    """Serve a robot of ``robots.toml`` until interrupted (see ``common.twin.run``)."""
    given = read_twin_options(robot, KinovaTwinOptions, options)
    twin = twin_of(robot, username=given.username, password=given.password, second=given.second)

    def build(wire_log: WireLog) -> KinovaServer:
        return KinovaServer(twin, given.port, wire_log, given.host)

    run_server(build, **start)
