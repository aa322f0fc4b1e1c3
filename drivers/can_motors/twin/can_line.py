"""The robot's end of a CAN bus that is a network interface of the kernel, such as ``vcan0``."""

from __future__ import annotations

import contextlib
import select
import time

import trio

from strands_actors.contract.wire import WireDown
from strands_actors.drivers.can_motors.can_port import CanSocket, open_interface


class CanLine:
    """A ``Line`` on a network interface. Each read is one frame of the kernel."""

    def __init__(self, interface: str) -> None:
        self._interface = interface
        self._port: CanSocket | None = None
        self._plugged = trio.Event()

    @property
    def address(self) -> str:
        return self._interface

    def plug(self) -> None:
        if self._port is None:
            self._port = open_interface(self._interface)
            self._plugged.set()

    def unplug(self) -> None:
        if self._port is not None:
            self._plugged = trio.Event()
            trio.lowlevel.notify_closing(self._port.fileno())
            self._port.close()
            self._port = None

    def close(self) -> None:
        self.unplug()

    def bits_per_s(self) -> int | None:
        return None

    async def receive(self) -> tuple[int, bytes]:
        while True:
            await self._plugged.wait()
            if self._port is not None:
                with contextlib.suppress(WireDown, trio.ClosedResourceError):
                    data = await self._port.read()
                    return time.monotonic_ns(), data

    def quiet_for(self, seconds: float) -> bool:
        waiting, _, _ = select.select([self._port] if self._port is not None else [], [], [], seconds)
        return not waiting

    def send(self, data: bytes) -> None:
        if self._port is not None:
            with contextlib.suppress(WireDown):
                self._port.write(data)
