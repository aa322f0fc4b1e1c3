"""The root's stop channel to the base. It uses a separate session and the wire's session.

Whether a base lets a second session stop the arm was never seen on a real one. The root therefore
opens a session and also shares the wire's: a descriptor of its connection, and its id and counter in
memory that both processes map. A stop is sent on both. If neither is answered, another session is
opened for it. A base that takes no second session is stopped on the wire's session alone.

If bytes are stuck in the wire's connection, a stop there would arrive behind joint speeds, and these
would arrive after the stop of the other session. So that connection is reset first.
"""

from __future__ import annotations

import contextlib
import mmap
import os
import socket
from collections.abc import Sequence

import trio

from strands_actors.contract.safe_state import SafeState
from strands_actors.contract.stop_channels import KeptSession
from strands_actors.contract.wire import MotorReport, WireDown
from strands_actors.drivers.common.kit.outcome import Outcome
from strands_actors.drivers.common.ports.tcp_port import TcpPort, open_tcp
from strands_actors.kernel.clock import Clock

from .client import KortexClient, OpenStream, Page, log_in_at
from .config import KinovaConfig
from .protocol import Call
from .stopping import stop_arm

KEEP_S = 0.5
"""Period of the keepalive. A base drops a session after 2 s without a request."""


class KinovaStopChannel(KeptSession[KinovaConfig, KortexClient]):
    def __init__(
        self,
        config: KinovaConfig,
        descriptors: Sequence[int],
        clock: Clock,
        open_stream: OpenStream = open_tcp,
        wires: KortexClient | None = None,
    ) -> None:
        """
        Args:
            descriptors: The wire's connection and its page, if they were handed over.
            wires: The wire's client, when the channel runs in the wire process. The wire closes it.
        """
        super().__init__(config, descriptors, clock)
        self._open_stream = open_stream
        self._newest: KortexClient | None = None  # opened by the last stop
        self._wires = self._client_of(*descriptors) if descriptors else wires
        self._closes_wires = wires is None

    async def connect(self) -> KortexClient:
        host, port = self.config.address()
        return await log_in_at(host, port, self.config.login, self.clock, self._open_stream)

    async def keep_up(self, session: KortexClient) -> None:
        while True:
            await trio.sleep(KEEP_S)
            await session.call(Call.KEEP_ALIVE)

    @property
    def has_other_way(self) -> bool:
        return self._wires is not None

    async def make_safe_by(self, session: KortexClient | None, safe_state: SafeState) -> tuple[MotorReport, ...]:
        if self._newest is not None:
            self.replace(self._newest)
            self._newest = None
        if self._wires is not None and self._wires.reset_if_stalled():
            if self._closes_wires:
                self._wires.close()
            self._wires = None
        clients = [client for client in (self.session, self._wires) if client is not None]
        why = "not connected"

        async def another() -> KortexClient:
            nonlocal why
            try:
                self._newest = await self.connect()
            except WireDown as down:
                why = str(down)
                raise
            return self._newest

        reports = await stop_arm(self.config.axes, clients, another)
        if not any(report.written for report in reports):
            return Outcome(False, False, why).reports(self.config.axes)
        if all(report.safe for report in reports):
            self._log_out()
        return reports

    def close(self) -> None:
        """Also close our sessions at the base. A session that the base still keeps could take the place of
        the next wire's."""
        for client in (self.session, self._newest):
            if client is not None:
                with contextlib.suppress(WireDown):
                    client.tell(Call.CLOSE_SESSION)
        super().close()
        for client in (self._newest, self._wires if self._closes_wires else None):
            if client is not None:
                client.close()
        self._newest = self._wires = None

    def _log_out(self) -> None:
        """End all sessions, because a base may have room for only one. A further stop opens another."""
        if self._wires is not None:
            with contextlib.suppress(WireDown):
                self._wires.tell(Call.CLOSE_SESSION)
        self.close()

    def _client_of(self, connection: int, page: int) -> KortexClient:
        host, port = self.config.address()
        stream = TcpPort(socket.socket(fileno=connection), f"{host}:{port}")
        try:
            return KortexClient(stream, stream.name, self.clock, Page(mmap.mmap(page, 0)))
        finally:
            os.close(page)
