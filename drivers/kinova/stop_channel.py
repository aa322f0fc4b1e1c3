"""The stop channel to the base: the supervising process (root) stops the arm after the wire process has ended.

It is unknown whether a real base lets a second session stop the arm. The root process therefore uses two sessions:
one that it opens itself, and the session of the wire process. For the latter, both processes share the connection,
and the session's id and request counter in shared memory. A stop is sent in both sessions. If neither is answered,
the root process opens another session for the stop. If the base refuses a second session, the stop is sent in the
wire's session only.

Joint speeds may be stuck in the wire's connection, because the base has not read them yet. They would take effect
after a stop in the other session. So such a connection is reset first. If only another session confirms the stop,
the wire's connection is reset, too, which drops the speeds on it. Some may already be on their way, so the arm is
then stopped once more.
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
from strands_actors.contract.wire import MotorReport, WireDown, all_safe
from strands_actors.drivers.common.kit.outcome import Outcome
from strands_actors.drivers.common.ports.tcp_port import TcpPort, open_tcp
from strands_actors.kernel.clock import Clock

from .client import KortexClient, OpenStream, Page, log_in_at
from .config import KinovaConfig
from .hand import hand_report
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
            config: The arm's settings.
            descriptors: File descriptors of the connection of the wire process (the process that drives the arm)
                and of its shared memory, or empty.
            clock: The clock for timeouts.
            open_stream: Opens a connection to the base.
            wires: The client of the wire process, if the stop is made in that process. It is not closed here.
        """
        super().__init__(config, descriptors, clock)
        self._open_stream = open_stream
        self._newest: KortexClient | None = None  # The additional session that the last stop has opened.
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
            self._drop_wires()
        clients = [client for client in (self.session, self._wires) if client is not None]
        reason = "not connected"

        async def open_session() -> KortexClient:
            nonlocal reason
            try:
                self._newest = await self.connect()
            except WireDown as down:
                reason = str(down)
                raise
            return self._newest

        reports, silent, fingers = await stop_arm(self.config.axes, clients, open_session)
        if not any(report.written for report in reports):
            return Outcome(False, False, reason).reports(self.config.all_axes)
        if all_safe(reports) and self._wires in silent:
            self._drop_wires()
            others = [client for client in (self.session, self._newest) if client is not None]
            reports, _, fingers = await stop_arm(self.config.axes, others)
        if all_safe(reports):
            self._log_out()
        return (*reports, hand_report(reports, fingers)) if self.config.gripper else reports

    def close(self) -> None:
        """Close the connections, and first the sessions at the base.

        A base may have room for only one session. A session left open could keep out the next wire process.
        """
        for client in (self.session, self._newest):
            if client is not None:
                with contextlib.suppress(WireDown):
                    client.tell(Call.CLOSE_SESSION)
        super().close()
        for client in (self._newest, self._wires if self._closes_wires else None):
            if client is not None:
                client.close()
        self._newest = self._wires = None

    def _drop_wires(self) -> None:
        """Reset the connection of the wire process, and do not use it any more."""
        if self._wires is not None:
            self._wires.reset()
            if self._closes_wires:
                self._wires.close()
        self._wires = None

    def _log_out(self) -> None:
        """Close all sessions, because a base may have room for only one. A later stop opens a new session."""
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
