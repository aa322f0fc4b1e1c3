"""The robot's end of the wire: a Modbus server with a gripper behind it, on TCP (as a gateway, and as
the URCap of a UR) or on a serial port."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator, Mapping
from typing import Any, Unpack

from strands_actors.drivers.common.simulation_control.body import Body
from strands_actors.drivers.common.twin import (
    Exchange,
    Fault,
    PtyLine,
    Server,
    Start,
    TcpServer,
    WireLog,
    answering,
    known_options,
    run_server,
)

from .config import BAUD
from .mechanism import Setup
from .robots import TABLES, UNIT
from .sessions import RtuSession, TcpSession
from .unit import RobotiqTwin
from .urcap import PORT as URCAP_PORT
from .urcap import UrcapSession

OPTIONS = {
    "host": "address to serve at (default: one of its own in 127.0.0.0/8)",
    "port": "TCP port (default: any free one)",
    "urcap_port": "TCP port of the URCap's text protocol (default 63352; with host= any free one)",
    "framing": "tcp, or rtu: frames of a serial line over TCP, as a gateway hands them through (default tcp)",
    "serial": "a serial port instead: true, or the path where it is to appear (default false)",
    "baud": "bits per second of the serial port (default 115200)",
    "unit_id": "Modbus unit (default 9)",
    "object_mm": "width of a rigid object between the fingers (default 0: none)",
    "activation_s": "seconds an activation takes (default 1.5)",
    "activated": "whether it is activated from the start (default false)",
    "echo_s": "seconds until a command counts and is repeated (default 0)",
    "gflt": "number of a fault it has from the start; below 10 it has it for good (default 0: none)",
}


def twin_of(robot: str, now_s: Callable[[], float] = time.monotonic, **options: Any) -> RobotiqTwin:
    """The twin of a robot of ``robots.toml``; ``options`` without host and port."""
    table = TABLES.table(robot)
    unit = int(options.pop("unit_id", UNIT))
    return RobotiqTwin(Setup.from_table(table, **options), unit, table, now_s)


class SerialRobot:
    """A gripper on a line that it has for itself."""

    def __init__(self, twin: RobotiqTwin, baud: int) -> None:
        self._twin = twin
        self._session = RtuSession(twin, baud)

    @property
    def body(self) -> Body:
        return self._twin.body

    def receive(self, data: bytes, bits_per_s: int | None) -> Iterator[Exchange]:
        return self._session.receive(data, bits_per_s)

    def set_fault(self, fault: Fault, unit: int | None = None) -> None:
        self._twin.set_fault(fault, unit)

    def power_cycle(self) -> None:
        self._twin.power_cycle()


def main(robot: str, *, options: Mapping[str, Any] | None = None, **start: Unpack[Start]) -> None:
    """Serve a robot of ``robots.toml`` until interrupted (see ``common.twin.run``)."""
    given = known_options(options, OPTIONS)
    host, port = given.pop("host", None), int(given.pop("port", 0))
    own = host is None and sys.platform.startswith("linux")
    urcap_port = int(given.pop("urcap_port", URCAP_PORT if own else 0))
    framing, serial = given.pop("framing", "tcp"), given.pop("serial", False)
    baud = int(given.pop("baud", BAUD))
    if framing not in ("tcp", "rtu"):
        raise ValueError(f"framing is {framing!r}. use tcp or rtu")
    twin = twin_of(robot, **given)

    def build_serial(wire_log: WireLog) -> Server:
        line = PtyLine(serial if isinstance(serial, str) else None)
        return Server(SerialRobot(twin, baud), line, wire_log)

    def build(wire_log: WireLog) -> TcpServer:
        modbus = answering(lambda: TcpSession(twin) if framing == "tcp" else RtuSession(twin))
        handlers = {port: modbus}
        if urcap_port != port:
            handlers[urcap_port] = answering(lambda: UrcapSession(twin))
        return TcpServer(twin, handlers, wire_log, host)

    run_server(build_serial if serial else build, **start)
