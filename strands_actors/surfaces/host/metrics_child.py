"""Keep the process that serves the metrics of a host's robots."""

from __future__ import annotations

import trio

from strands_actors.kernel.processes.process import ChildProcess, start

ENTRY = "strands_actors.surfaces.host.metrics_process:main"
PAUSE_S = 60.0
"""Pause before the process is started again."""
LINE_BYTES = 4096


class MetricsChild:
    """Keeps the process. ``run`` starts it, and starts it again when it has ended, until it is cancelled.

    Args:
        address: ``host:port``; empty for no metrics.
    """

    def __init__(self, address: str) -> None:
        self._address = address
        self.url = ""
        self.problem = ""

    async def run(self) -> None:
        host, _, port = self._address.rpartition(":")
        while self._address:
            try:
                process = start(ENTRY, {"host": host, "port": int(port), "label": "host metrics"})
            except OSError as error:
                self.problem = f"the process of the metrics cannot be started: {error.strerror}"
            else:
                await self._attend(process)
            await trio.sleep(PAUSE_S)

    async def _attend(self, process: ChildProcess) -> None:
        try:
            line = await self._line(process)
            self.url, self.problem = ("", line[1:]) if line.startswith("!") else (line, "")
            code = await process.wait()
            self.url, self.problem = "", self.problem or f"the process of the metrics ended with code {code}"
        finally:
            with trio.CancelScope(shield=True):
                await process.drop()

    async def _line(self, process: ChildProcess) -> str:
        """Return the first line that the process sends; empty if it ends before."""
        data = b""
        while not data.endswith(b"\n") and len(data) < LINE_BYTES:
            await trio.lowlevel.wait_readable(process.socket)
            part = process.socket.recv(LINE_BYTES)
            if not part:
                break
            data += part
        return data.decode(errors="replace").strip()
