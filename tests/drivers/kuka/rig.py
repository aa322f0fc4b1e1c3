"""A twin and the wire that answers it, in one loop."""

from __future__ import annotations

import os
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

import trio

from strands_actors.contract.wire import MotorReport, PermitDenied
from strands_actors.drivers.common.twin import WireLog as TwinLog
from strands_actors.drivers.common.twin import read_twin_options
from strands_actors.drivers.kuka.driver import Kuka
from strands_actors.drivers.kuka.protocol import State
from strands_actors.drivers.kuka.robots import arm_of
from strands_actors.drivers.kuka.stop_channel import KukaStopChannel
from strands_actors.drivers.kuka.twin import KukaServer, KukaTwinOptions
from strands_actors.drivers.kuka.wire import KukaWire
from strands_actors.kernel.clock import MonotonicClock
from strands_actors.kernel.health.realtime import WIRE_PRIORITY, run_first, run_like_others
from strands_actors.testing import WireLog
from strands_actors.testing.wirelog import Entry

PATIENCE_S = 20.0

TTL_S = 0.1
"""A setpoint that is not re-sent for this time has ended."""

SLACK_S = 0.4
"""For a busy machine."""


class Permit:
    """A permit that the test can withdraw."""

    def __init__(self) -> None:
        self.denied = False

    def check(self) -> None:
        if self.denied:
            raise PermitDenied("a stop is waiting")


class Rig:
    """A twin and the wire that answers it, in one loop."""

    def __init__(self, server: KukaServer, driver: Kuka, log: WireLog, nursery: trio.Nursery) -> None:
        self.server = server
        self.controller = server.controller
        self.driver = driver
        self.log = log
        self.clock = MonotonicClock()
        wire = driver.open_wire(self.clock)
        assert isinstance(wire, KukaWire)
        self.wire = wire
        self.permit = Permit()
        self._nursery = nursery
        self._serving = trio.CancelScope()
        self._ended = trio.Event()
        self._ended.set()

    async def connect(self) -> None:
        """Connect as the transport does, up to an active session."""
        await self.wire.open()
        self._serving = trio.CancelScope()
        await self._nursery.start(self._serve)
        await self.until(lambda: self.controller.state == State.COMMANDING_ACTIVE)
        await self.wire.arm(self.permit)

    async def _serve(self, task_status: trio.TaskStatus[None]) -> None:
        self._ended = trio.Event()
        with self._serving:
            await self.wire.serve(task_status)
        self._ended.set()

    async def lose(self) -> None:
        """Lose the link as the transport does. The wire stays open for an unconfirmed safe state."""
        self._serving.cancel()
        await self._ended.wait()

    async def stop_channel(self) -> KukaStopChannel:
        """End the wire as its process would. Return the root's channel, which has a duplicate of the socket."""
        fd = os.dup(self.wire.handover()[0])
        await self.release()
        return KukaStopChannel(self.driver.config, (fd,), self.clock)

    async def release(self) -> None:
        await self.lose()
        self.wire.close()
        self.driver.kept.release()

    async def write(self, rad: float) -> None:
        """Aim joint1 this far from its commanded position."""
        target = list(self.controller.commanded)
        target[0] += rad
        await self.wire.write((*target, 0.02), self.permit)

    async def moving(self, setpoints: int) -> None:
        """Move joint1 until this number of answers has shown it."""
        target = [*self.controller.commanded]
        target[0] += 1.0
        with trio.fail_after(PATIENCE_S):
            while self.setpoints() <= setpoints:
                await self.wire.write((*target, 0.02), self.permit)
                await trio.sleep(0.02)

    async def until(self, reached: Callable[[], Any], within_s: float = PATIENCE_S) -> None:
        with trio.fail_after(within_s):
            while not reached():  # noqa: ASYNC110  # the twin's doing
                await trio.sleep(0.002)

    async def hears(self, state: State, within_s: float = PATIENCE_S) -> None:
        """Wait until the wire has received this state. The controller is in it earlier."""
        with trio.fail_after(within_s):
            while (await self.wire.read()).sensors["fri_state"] != (float(state),):  # noqa: ASYNC110
                await trio.sleep(0.002)

    def last_setpoint(self) -> Entry:
        return self.log.host("setpoint")[-1]

    def setpoints(self, since_ns: int = 0) -> int:
        return len(self.log.host("setpoint", since_ns))


def on_a_twin(
    tmp_path: Path, test: Callable[[Rig], Awaitable[None]], options: dict[str, Any] | None = None, **keywords: Any
) -> None:
    async def main() -> None:
        path = tmp_path / "wire.ndjson"
        server = KukaServer(
            arm_of("kuka_iiwa"),
            TwinLog(str(path)),
            read_twin_options("kuka_iiwa", KukaTwinOptions, {"sample_ms": 5, **(options or {})}),
        )
        async with trio.open_nursery() as nursery:
            server.plug()
            nursery.start_soon(server.serve)
            driver = Kuka("kuka_iiwa", keywords.pop("port", server.address), {"connect_timeout": 1.0, **keywords})
            rig = Rig(server, driver, WireLog(path), nursery)
            try:
                await test(rig)
            finally:
                await rig.release()
                server.close()
                nursery.cancel_scope.cancel()

    run_first(WIRE_PRIORITY)  # if the system permits it, since the test must answer a hundred cycles in time
    try:
        trio.run(main)
    finally:
        run_like_others()


def all_safe(reports: tuple[MotorReport, ...]) -> bool:
    assert [report.axis for report in reports] == [f"joint{number}" for number in range(1, 8)]
    return all(report.safe for report in reports)
