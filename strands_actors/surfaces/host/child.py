"""Keep a process beside a host, such as the one that serves the metrics."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import trio

from strands_actors.kernel.processes.process import ChildProcess, start

from .messages import ServiceStatus

PAUSE_S = 60.0
"""Pause before the process is started again."""
LINE_BYTES = 4096


class Child:
    """Keeps one process. ``run`` starts it, and starts it again when it has ended, until it is cancelled.

    Args:
        name: Name of the service.
        entry: The function that the process runs, as ``module:name``.
        arguments: The arguments of this function.
    """

    def __init__(self, name: str, entry: str, arguments: Mapping[str, Any]) -> None:
        self._name = name
        self._entry = entry
        self._arguments = arguments
        self.status = ServiceStatus("", "it is starting")

    async def run(self) -> None:
        while True:
            try:
                process = start(self._entry, {**self._arguments, "label": f"host {self._name}"})
            except OSError as error:
                self.status = ServiceStatus("", f"its process cannot be started: {error.strerror}")
            else:
                await self._attend(process)
            await trio.sleep(PAUSE_S)

    async def _attend(self, process: ChildProcess) -> None:
        """Show the lines that the process sends, until it ends."""
        try:
            rest = b""
            while part := await self._receive(process):
                *lines, rest = (rest + part)[-LINE_BYTES:].split(b"\n")
                for line in lines:
                    text = line.decode(errors="replace")
                    is_problem = text.startswith("!")
                    self.status = ServiceStatus("", text[1:]) if is_problem else ServiceStatus(text, "")
            code = await process.wait()
            self.status = ServiceStatus("", self.status.problem or f"its process ended with code {code}")
        finally:
            with trio.CancelScope(shield=True):
                await process.drop()

    async def _receive(self, process: ChildProcess) -> bytes:
        await trio.lowlevel.wait_readable(process.socket)
        return process.socket.recv(LINE_BYTES)
