"""Simulate a Gen3 (a "twin"): a Kortex server on TCP, its base and its arm.

A test controls a simulated robot by lines of text. This one accepts the lines of every twin, and also ``state
NAME`` and ``mode NAME``, with the names of ``protocol.ArmState`` and ``protocol.ServoingMode``. Its log of all
frames (wire log) shows no passwords.
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
from .base import CALLS, Base, Second
from .robots import TABLES

MODELLED = (CALLS,)


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
    def simulation_moves(self) -> bool:
        return self._base.simulation_moves

    def let_simulation_move(self, on: bool) -> None:
        self._base.simulation_moves = True
        self.hold()
        self._base.simulation_moves = on

    def set_controller_targets(self, values: Sequence[float]) -> None:
        self._base.set_targets(list(values))

    def reset(self) -> None:
        super().reset()
        self._base.wake_up()


class KinovaTwin:
    """The simulated robot: one base with its arm, which all clients share."""

    def __init__(self, base: Base) -> None:
        self.base = base
        self.body = KinovaBody(base)
        self.faults = Faults()

    def set_fault(self, fault: Fault, unit: int | None = None) -> None:
        """Inject a fault. ``unit`` is ignored, because this robot has only one unit."""
        self.base.advance()
        self.base.set_fault(fault)
        self.faults.set(fault)

    def power_cycle(self) -> None:
        self.base.wake_up()


class KortexSession:
    """One client's connection, as the simulated base handles it."""

    def __init__(self, twin: KinovaTwin) -> None:
        self._twin = twin
        self._decoder = p.Decoder()

    def receive(self, data: bytes, bits_per_s: int | None) -> Iterator[Exchange]:
        for frame in self._decoder.feed(data):
            kind = self._twin.base.kind(frame)
            yield Exchange(kind, _without_password(frame).encode(), self._replies(frame, kind))
        if self._decoder.skipped:
            raise ClientGone  # A real base also closes the connection after unreadable bytes [assumed].

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
    """Serve the clients of one simulated robot, and let its arm move between their requests, too."""

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
        """Restart the base, which closes every connection and every session."""
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
    """Return a simulated robot of ``robots.toml``. ``options`` are the keyword arguments of ``Base``."""
    return KinovaTwin(Base(TABLES.table(robot), **options))


def main(robot: str, *, options: Mapping[str, Any] | None = None, **start: Unpack[Start]) -> None:
    """Run the simulated robot of this name from ``robots.toml`` until interrupted (see ``common.twin.run``)."""
    chosen = read_twin_options(robot, KinovaTwinOptions, options)
    twin = twin_of(robot, username=chosen.username, password=chosen.password, second=chosen.second)

    def build(wire_log: WireLog) -> KinovaServer:
        return KinovaServer(twin, chosen.port, wire_log, chosen.host)

    run_server(build, **start)
