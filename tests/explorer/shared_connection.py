"""Simulate connections that several processes have open: a descriptor that was passed on, and its duplicates."""

from __future__ import annotations

import os
from types import ModuleType, SimpleNamespace

from strands_actors.contract.wire import WireDown

from .robot_model import Seam
from .tcp_network import SimStream, TcpNetwork
from .world import Process


def adopting_seams(network: TcpNetwork, module: ModuleType) -> tuple[Seam, ...]:
    """Return the replacements with which a module makes a ``TcpPort`` of a descriptor."""

    def adopt(fileno: int) -> DuplicateStream:
        return DuplicateStream(network.stream_of(fileno), fileno, network.world.current)

    return ((module, "socket", SimpleNamespace(socket=adopt)), (module, "TcpPort", lambda stream, name: stream))


class DuplicateStream:
    """The descriptor of a connection in a process that has not opened it, and its methods of a ``TcpPort``."""

    def __init__(self, stream: SimStream, fd: int, process: Process) -> None:
        self.name = stream.name
        self._stream = stream
        self._fd = fd
        self._process = process
        stream.duplicate()
        process.at_end.append(self._drop)

    def write(self, data: bytes) -> None:
        self._check()
        self._stream.write_by(self._process, data)

    async def read(self) -> bytes:
        self._check()
        return await self._stream.read_by(self._process)

    def fileno(self) -> int:
        return self._fd

    def reset_if_stalled(self) -> bool:
        return self._fd >= 0 and self._stream.reset_if_stalled()

    def reset(self) -> None:
        self._stream.reset()

    def close(self) -> None:
        if not self._process.dead:
            self._drop()

    def _drop(self) -> None:
        if self._fd >= 0:
            os.close(self._fd)
            self._fd = -1
            self._stream.close_duplicate()

    def _check(self) -> None:
        if self._fd < 0:
            raise WireDown(f"{self.name}: the connection is closed. Reconnect")
