"""The root's way to the base: a session of its own, and the wire's.

Nobody of us has seen whether a base lets a second session stop the arm. So the root opens one, and has the wire's,
too: a descriptor of its connection, and its id and counter in memory that both processes share. A stop is sent on
both, and when neither is answered, on a session opened for it. A base that takes no second session is stopped on
the wire's alone.
"""

from __future__ import annotations

import contextlib
import mmap
import os
import socket
from collections.abc import Sequence
from typing import TYPE_CHECKING

import trio

from strands_actors.contract.driver import MotorReport, StopChannel, WireDown
from strands_actors.drivers.common.tcp_port import TcpPort, open_tcp
from strands_actors.kernel.clock import Clock

from .client import KortexClient, OpenStream, Page, log_in_at
from .protocol import Call
from .stopping import not_connected, stop_arm

if TYPE_CHECKING:
    from .driver import Kinova

KEEP_S = 0.5
"""A base forgets a session that says nothing for 2 s."""


class KinovaStopChannel(StopChannel):
    def __init__(
        self,
        driver: Kinova,
        descriptors: Sequence[int],
        clock: Clock,
        open_stream: OpenStream = open_tcp,
        wires: KortexClient | None = None,
    ) -> None:
        """``descriptors``: of the wire's connection and of its page, where they were handed over. ``wires``: that
        connection, in the wire's own process, which closes it."""
        self._driver = driver
        self._clock = clock
        self._open_stream = open_stream
        self._own: KortexClient | None = None
        self._newest: KortexClient | None = None  # opened by the last stop
        self._wires = self._client_of(*descriptors) if descriptors else wires
        self._closes_wires = wires is None
        self._serving = trio.CancelScope()

    async def serve(self, task_status: trio.TaskStatus[None] = trio.TASK_STATUS_IGNORED) -> None:
        told = False
        with self._serving:
            try:
                self._own = await self._log_in()
            except WireDown:
                if self._wires is None:
                    raise
            told = True
            task_status.started()
            while self._own is not None:
                await trio.sleep(KEEP_S)
                await self._keep_own(self._own)
        if not told:
            task_status.started()  # used already

    async def make_safe(self, safe_state: str) -> tuple[MotorReport, ...]:
        self._serving.cancel()  # nobody else reads from our connection
        if self._newest is not None:
            self._replace_own(self._newest)
            self._newest = None
        clients = [client for client in (self._own, self._wires) if client is not None]
        why = "not connected"

        async def another() -> KortexClient:
            nonlocal why
            try:
                self._newest = await self._log_in()
            except WireDown as down:
                why = str(down)
                raise
            return self._newest

        reports = await stop_arm(self._driver.axes, clients, another)
        if not any(report.written for report in reports):
            return not_connected(self._driver.axes, why)
        if all(report.safe for report in reports):
            self._log_out()
        return reports

    def close(self) -> None:
        for client in (self._own, self._newest, self._wires if self._closes_wires else None):
            if client is not None:
                client.close()
        self._own = self._newest = self._wires = None

    def _log_out(self) -> None:
        """A base may have room for one session only. A further stop opens another one."""
        for client in (self._own, self._newest, self._wires):
            if client is not None:
                with contextlib.suppress(WireDown):
                    client.tell(Call.CLOSE_SESSION)
        self.close()

    async def _log_in(self) -> KortexClient:
        """Raise ``WireDown``."""
        host, port = self._driver.address()
        return await log_in_at(host, port, self._driver.login, self._clock, self._open_stream)

    def _replace_own(self, client: KortexClient) -> None:
        if self._own is not None:
            self._own.close()
        self._own = client

    async def _keep_own(self, own: KortexClient) -> None:
        """Keep the session alive, or make a new one for one that is gone. While there is no way to the base, the
        wire has none either, and hands over anew when it is back."""
        try:
            await own.call(Call.KEEP_ALIVE)
        except WireDown:
            with contextlib.suppress(WireDown):
                self._replace_own(await self._log_in())

    def _client_of(self, connection: int, page: int) -> KortexClient:
        host, port = self._driver.address()
        stream = TcpPort(socket.socket(fileno=connection), f"{host}:{port}")
        try:
            return KortexClient(stream, stream.name, self._clock, Page(mmap.mmap(page, 0)))
        finally:
            os.close(page)
