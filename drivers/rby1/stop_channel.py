"""Stop an RB-Y1 from the supervising process (root), by a separate connection. It is kept open, and
replaced if it is lost.

No call on it can hang: this package implements gRPC itself, on trio. The stop therefore needs no
separate process.
"""

from __future__ import annotations

import contextlib
from collections.abc import Sequence

import trio

from strands_actors.contract.safe_state import SafeState
from strands_actors.contract.stop_channels import KeptSession
from strands_actors.contract.wire import MotorReport
from strands_actors.drivers.common.ports.grpc import CallFailed, Connection, OpenStream, open_grpc
from strands_actors.drivers.common.ports.tcp_port import open_tcp
from strands_actors.kernel.clock import Clock

from .config import RBY1Config
from .protocol import Method
from .stopping import ANSWER_S, Stop

KEEP_S = 0.5
CONNECT_S = 0.6
KEPT = 2
"""Number of unanswered connections that stay open. The oldest is closed first."""


class RBY1StopChannel(KeptSession[RBY1Config, Connection]):
    def __init__(
        self, config: RBY1Config, descriptors: Sequence[int], clock: Clock, open_stream: OpenStream = open_tcp
    ) -> None:
        super().__init__(config, descriptors, clock)
        self._open_stream = open_stream
        self._silent: list[Connection] = []

    async def connect(self) -> Connection:
        host, port = self.config.address()
        return await open_grpc(host, port, within_s=CONNECT_S, open_stream=self._open_stream)

    async def keep_up(self, session: Connection) -> None:
        while True:
            await trio.sleep(KEEP_S)
            # An error status is an answer, too: the robot is reachable.
            with contextlib.suppress(CallFailed):
                await session.unary(Method.PING, b"", KEEP_S)

    async def make_safe_by(self, session: Connection | None, safe_state: SafeState) -> tuple[MotorReport, ...]:
        stop = Stop(self.config, session, lambda: connect_to_stop(self.config, self._open_stream))
        try:
            return await stop.run(safe_state)
        finally:
            self.session = stop.connection
            self._silent += stop.silent
            while len(self._silent) > KEPT:
                self._silent.pop(0).close_in_order()

    def close(self) -> None:
        """Close the connections without dropping sent data. A robot that was frozen then still
        receives the stop."""
        for connection in (*self._silent, *([self.session] if self.session else [])):
            connection.close_in_order()
        self._silent, self.session = [], None


async def connect_to_stop(config: RBY1Config, open_stream: OpenStream) -> Connection:
    """Connect without waiting for the server's first message. A stop is thereby sent even to a
    robot that sends nothing readable. Raise ``WireDown``."""
    host, port = config.address()
    return await open_grpc(host, port, within_s=ANSWER_S, settle=False, open_stream=open_stream)
