"""Simulate a gripper (a "twin") that Modbus clients can control, by TCP or a serial port.

By TCP it behaves like a Modbus gateway. It also has the text port that Robotiq's URCap opens on a UR controller.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator, Mapping
from typing import Annotated, Any, Literal, Unpack

from strands_actors.contract.options import option
from strands_actors.drivers.common.physics.body import Body
from strands_actors.drivers.common.twin import (
    Exchange,
    Fault,
    NetworkOptions,
    PtyLine,
    Server,
    Start,
    TcpServer,
    WireLog,
    answering,
    read_twin_options,
    run_server,
)

from .config import BAUD
from .mechanism import Setup
from .robots import TABLES, UNIT
from .sessions import FUNCTIONS, RtuSession, TcpSession
from .unit import RobotiqTwin
from .urcap import LINES, UrcapSession
from .urcap import PORT as URCAP_PORT

MODELLED = (FUNCTIONS, LINES)


class RobotiqTwinOptions(NetworkOptions, frozen=True):
    urcap_port: Annotated[
        int | None,
        option(f"TCP port of the URCap's text protocol; None: {URCAP_PORT}, and with host= any free one"),
    ] = None
    framing: Annotated[
        Literal["tcp", "rtu"],
        option("rtu: frames of a serial line over TCP, as a gateway hands them through"),
    ] = "tcp"
    serial: Annotated[bool, option("a serial port instead")] = False
    link: Annotated[str | None, option("path at which the serial port appears; None: a temporary one")] = None
    baud: Annotated[int, option("bits per second of the serial port", gt=0)] = BAUD
    unit_id: Annotated[int, option("Modbus unit", ge=0, le=255)] = UNIT
    object_mm: Annotated[float, option("width of a rigid object between the fingers; 0: none", ge=0)] = 0.0
    activation_s: Annotated[float, option("seconds an activation takes", ge=0)] = 1.5
    activated: Annotated[bool, option("whether it is activated from the start")] = False
    echo_s: Annotated[float, option("seconds until a command counts and is repeated", ge=0)] = 0.0
    gflt: Annotated[
        int, option("number of a fault it has from the start; below 10 it has it for good; 0: none", ge=0, le=15)
    ] = 0


def twin_of(robot: str, now_s: Callable[[], float] = time.monotonic, **options: Any) -> RobotiqTwin:
    """Return a simulated gripper of ``robots.toml``. ``options`` are ``unit_id`` and the fields of ``Setup``."""
    table = TABLES.table(robot)
    unit = int(options.pop("unit_id", UNIT))
    return RobotiqTwin(Setup.from_table(table, **options), unit, table, now_s)


class SerialRobot:
    """A simulated gripper that is the only device on a serial line."""

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
    """Run the simulated gripper of this name from ``robots.toml`` until interrupted (see ``common.twin.run``)."""
    chosen = read_twin_options(robot, RobotiqTwinOptions, options)
    own = chosen.host is None and sys.platform.startswith("linux")
    urcap_port = (URCAP_PORT if own else 0) if chosen.urcap_port is None else chosen.urcap_port
    twin = twin_of(
        robot,
        unit_id=chosen.unit_id,
        object_mm=chosen.object_mm,
        activation_s=chosen.activation_s,
        activated=chosen.activated,
        echo_s=chosen.echo_s,
        gflt=chosen.gflt,
    )

    def build_serial(wire_log: WireLog) -> Server:
        line = PtyLine(chosen.link)
        return Server(SerialRobot(twin, chosen.baud), line, wire_log)

    def build(wire_log: WireLog) -> TcpServer:
        modbus = answering(lambda: TcpSession(twin) if chosen.framing == "tcp" else RtuSession(twin))
        handlers = {chosen.port: modbus}
        if urcap_port != chosen.port:
            handlers[urcap_port] = answering(lambda: UrcapSession(twin))
        return TcpServer(twin, handlers, wire_log, chosen.host)

    run_server(build_serial if chosen.serial else build, **start)
