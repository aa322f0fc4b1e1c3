"""The Robotiq wire and its stop channel on the twin's gripper, in memory and virtual time."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

import pytest
import trio

from strands_actors.contract.wire import MotorReport, Observation, WireDown
from strands_actors.drivers.robotiq.driver import Robotiq
from strands_actors.drivers.robotiq.sessions import TcpSession
from strands_actors.drivers.robotiq.stop_channel import RobotiqStopChannel
from strands_actors.drivers.robotiq.twin import twin_of
from strands_actors.drivers.robotiq.unit import RobotiqTwin
from strands_actors.drivers.robotiq.wire import RobotiqWire
from strands_actors.kernel.clock import VirtualClock
from tests.drivers.common.memory_port import MemoryPort, Permission


class Rig:
    """A wire on the twin's gripper, in memory. ``written`` has the kinds of the requests to the gripper, in
    order."""

    def __init__(self, options: dict[str, Any] | None = None, **bench: Any) -> None:
        self.driver = Robotiq("robotiq_2f85", "192.0.2.10", options or {})
        self.twin: RobotiqTwin = twin_of("robotiq_2f85", trio.current_time, **bench)
        self.clock = VirtualClock()
        self.wire = RobotiqWire(self.driver.config, self.clock, self.connect)
        self.ports: list[MemoryPort] = []
        self.written: list[str] = []
        self.questions = 0
        self.silent_from: int | None = None  # number of the first request that is not answered
        self.unread: list[tuple[TcpSession, bytes]] | None = None  # requests that the gripper reads later
        self.delay_s: Callable[[int], float] = lambda _: 0.001

    async def connect(self, host: str, port: int) -> MemoryPort:
        assert (host, port) == ("192.0.2.10", 502)
        session = TcpSession(self.twin)

        def peer(data: bytes) -> Iterable[tuple[float, bytes]]:
            if self.unread is not None:
                self.unread.append((session, data))
                return
            for exchange in session.receive(data, None):
                if exchange.kind != "read":
                    self.written.append(exchange.kind)
                self.questions += 1
                if self.silent_from is not None and self.questions > self.silent_from:
                    continue
                for reply in exchange.replies:
                    yield self.delay_s(self.questions) + reply.late_s, reply.data

        await trio.lowlevel.checkpoint()
        self.ports.append(MemoryPort(peer))
        return self.ports[-1]

    def read_on_after(self, requests: int) -> None:
        """Let the gripper answer again. It reads what waited on the old connections only after it has answered this
        number of new requests."""
        waiting, self.unread = self.unread or [], None
        first = self.questions

        def delay_s(number: int) -> float:
            if number > first + requests - 1:
                while waiting:
                    session, data = waiting.pop(0)
                    self.written.extend(exchange.kind for exchange in session.receive(data, None))
            return 0.001

        self.delay_s = delay_s

    async def armed(self) -> Rig:
        await self.wire.open()
        await self.wire.arm(Permission())
        self.written.clear()
        return self

    async def go(self, closed: float, speed: float = 1.0, force: float = 1.0) -> None:
        await self.wire.write((closed, speed, force), Permission())

    async def observe_for(self, seconds: float) -> Observation:
        end_s = trio.current_time() + seconds
        while True:
            seen = await self.wire.read()
            if trio.current_time() >= end_s:
                return seen
            await trio.sleep(0.02)

    async def stop(self) -> MotorReport:
        (report,) = await self.wire.make_safe("hold")
        return report

    async def stop_channel(self) -> MotorReport:
        path = RobotiqStopChannel(self.driver.config, (), self.clock, self.connect)
        (report,) = await path.make_safe("hold")
        path.close()
        assert self.ports[-1].closed
        return report


def sensor(seen: Observation, name: str) -> float:
    (value,) = seen.sensors[name]
    return value


async def refused(rig: Rig) -> str:
    with pytest.raises(WireDown) as down:
        await rig.wire.arm(Permission())
    return str(down.value)
