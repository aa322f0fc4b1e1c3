"""Send the reports of the simulated controller on three ports. Each port has its own length and rate of reports."""

from __future__ import annotations

import struct
from collections import deque
from typing import Protocol

from strands_actors.drivers.common.twin import Connection, Fault, Faults, Reply
from strands_actors.drivers.xarm import reports as r

from .controller import TICK_HZ, Controller
from .registers import SETTINGS

HZ = {r.NORMAL_PORT: 5.0, r.RICH_PORT: 5.0, r.REAL_PORT: 100.0}
SPEEDS_OFFSET, COUNT_OFFSET, IO_OFFSET, ROTATION_OFFSET = 256, 284, 383, 482
"""Places in a rich report: speeds of the joints, counter, inputs and outputs of the control box, and the rotation
vector of the tool."""

WRONG_BY_RAD = 0.5
ROOM_C = 30


class Sender(Protocol):
    """The method of a connection by which reports are sent."""

    def send(self, data: bytes) -> None: ...


class Publisher:
    """Send reports to all clients of one controller. They are not logged, since at 100 per second they would hide
    the rest of the log."""

    def __init__(self, controller: Controller, faults: Faults) -> None:
        self._controller = controller
        self._faults = faults
        self._listeners: list[Listener] = []
        self._stale: r.Report | None = None

    def push(self, now_s: float) -> None:
        """Send the reports that are due. Called after each tick."""
        for listener in self._listeners:
            if now_s >= listener.due_s:
                listener.due_s = max(listener.due_s + 1 / HZ[listener.port], now_s - 1 / TICK_HZ)
                reply = self._faults.apply(Reply(0.0, self._packed(listener.port)))
                if reply is not None:
                    listener.waiting.append((now_s + reply.delay_s + reply.late_s, reply.data))
            listener.flush(now_s)

    async def serve(self, port: int, connection: Connection) -> None:
        listener = self.add(port, connection)
        try:
            while True:
                t_ns, data = await connection.receive()
                connection.log_received(t_ns, "other", data)
        finally:
            self.remove(listener)

    def add(self, port: int, connection: Sender) -> Listener:
        listener = Listener(port, connection)
        self._listeners.append(listener)
        return listener

    def remove(self, listener: Listener) -> None:
        self._listeners.remove(listener)

    def _packed(self, port: int) -> bytes:
        report = self._report()
        if port == r.REAL_PORT:
            return bytes(r.pack_report(r.REAL_SIZE, report))
        controller = self._controller
        data = r.pack_report(r.NORMAL_SIZE if port == r.NORMAL_PORT else r.RICH_SIZE, report)
        r.pack_details(data, controller.details)
        if port == r.RICH_PORT:
            r.pack_rich(data, controller.version, controller.version_text, controller.speed_limit_rad_s, ROOM_C)
            self._pack_rest(data)
        for register, value in controller.settings.items():
            setting = SETTINGS[register]
            if setting.place + setting.size <= len(data):
                data[setting.place : setting.place + setting.size] = value
        return bytes(data)

    def _pack_rest(self, data: bytearray) -> None:
        """Write the fields of a rich report that only the vendor's software reads."""
        controller = self._controller
        struct.pack_into("<7f", data, SPEEDS_OFFSET, *controller.plant.velocity_rad_s)
        struct.pack_into(">I", data, COUNT_OFFSET, controller.count & 0xFFFFFFFF)
        io = controller.devices.state()
        data[IO_OFFSET : IO_OFFSET + len(io)] = io
        struct.pack_into("<3f", data, ROTATION_OFFSET, *controller.pose(axis_angle=True)[3:])

    def _report(self) -> r.Report:
        fault = self._faults.of(None)
        if fault is Fault.STUCK and self._stale is not None:
            return self._stale
        report = self._stale = self._controller.report()
        if fault is Fault.WRONG:
            return report._replace(position_rad=tuple(rad + WRONG_BY_RAD for rad in report.position_rad))
        return report


class Listener:
    def __init__(self, port: int, connection: Sender) -> None:
        self.port = port
        self.due_s = 0.0
        self.waiting: deque[tuple[float, bytes]] = deque()
        self._connection = connection

    def flush(self, now_s: float) -> None:
        while self.waiting and self.waiting[0][0] <= now_s:
            self._connection.send(self.waiting.popleft()[1])
