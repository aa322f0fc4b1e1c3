"""The Kinova wire and its stop channel on the twin's base, in memory and virtual time."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

import trio

from strands_actors.contract.wire import MotorReport, Observation
from strands_actors.drivers.kinova.driver import Kinova
from strands_actors.drivers.kinova.protocol import Call, Decoder, Frame
from strands_actors.drivers.kinova.stop_channel import KinovaStopChannel
from strands_actors.drivers.kinova.twin import KinovaTwin, KortexSession, twin_of
from strands_actors.drivers.kinova.wire import KinovaWire
from strands_actors.kernel.clock import VirtualClock
from tests.drivers.common.memory_port import MemoryPort, Permission

HOST = "192.0.2.10"


class Rig:
    """A wire on a base. ``received`` has every frame that reached the base, in order."""

    def __init__(self, options: dict[str, Any] | None = None, **bench: Any) -> None:
        self.driver = Kinova("kinova_gen3", HOST, options or {})
        self.twin: KinovaTwin = twin_of("kinova_gen3", now_s=trio.current_time, **bench)
        self.clock = VirtualClock()
        self.wire = KinovaWire(self.driver.config, self.clock, self.connect)
        self.ports: list[MemoryPort] = []
        self.received: list[tuple[float, Frame]] = []
        self.silent = False  # the base receives, but sends nothing
        self.deaf: set[int] = set()  # calls that are lost before they are carried out
        self.delay_s: Callable[[int], float] = lambda call: 0.001
        self.target: tuple[float, ...] | None = None

    async def connect(self, host: str, port: int) -> MemoryPort:
        assert (host, port) == (HOST, 10000)
        session = KortexSession(self.twin)

        def peer(data: bytes) -> Iterable[tuple[float, bytes]]:
            for frame in Decoder().feed(data):
                self.received.append((trio.current_time(), frame))
                if frame.call in self.deaf:
                    continue
                for exchange in session.receive(frame.encode(), None):
                    for reply in exchange.replies if not self.silent else ():
                        yield self.delay_s(frame.call) + reply.late_s, reply.data

        await trio.lowlevel.checkpoint()
        self.ports.append(MemoryPort(peer))
        return self.ports[-1]

    # -- the actions of the tree

    async def armed(self) -> Rig:
        await self.wire.open()
        await self.wire.arm(Permission())
        self.received.clear()
        return self

    async def period(self, earned: bool = True) -> Observation:
        """Run one control period: re-send the live target, then read."""
        await trio.sleep(self.driver.config.period_s)
        if earned and self.target is not None:
            await self.wire.write(self.target, Permission())
        return await self.wire.read()

    async def go(self, joint: int, step_rad: float) -> None:
        """Write a target at this distance from the joint's position."""
        target = list((await self.wire.read()).position)
        target[joint] += step_rad
        self.target = tuple(target)
        await self.wire.write(self.target, Permission())

    async def stop(self, safe_state: str = "stop") -> tuple[MotorReport, ...]:
        self.target = None
        return await self.wire.make_safe(safe_state)

    def stop_channel(self) -> KinovaStopChannel:
        return KinovaStopChannel(self.driver.config, (), self.clock, self.connect)

    # -- results

    def awaited(self) -> set[int]:
        """Return the numbers of the wire's requests with an awaited response that was not fetched yet."""
        exchange = self.wire.session.client._exchange
        return {*filter(exchange.waits_for, exchange._sent), *exchange._answers}

    def calls(self, since_s: float = 0.0) -> list[int]:
        return [frame.call for at_s, frame in self.received if at_s >= since_s]

    def stops(self) -> list[float]:
        return [at_s for at_s, frame in self.received if frame.call == Call.STOP]

    def speeds(self) -> list[tuple[float, Frame]]:
        return [(at_s, frame) for at_s, frame in self.received if frame.call == Call.SEND_JOINT_SPEEDS]

    @property
    def velocity(self) -> float:
        """Return the true velocity of the fastest joint."""
        self.twin.base.advance()
        return max(abs(rad_s) for rad_s in self.twin.base.plant.velocity_rad_s)
