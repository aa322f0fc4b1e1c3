"""Simulate a gripper (a "twin") that Modbus clients can control, by TCP or a serial port.

By TCP it behaves like a Modbus gateway. It also has the text port that Robotiq's URCap opens on a UR controller.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from typing import Annotated, Any, Literal

from strands_actors.contract.options import option
from strands_actors.drivers.common.twin import (
    NetworkOptions,
    PtyLine,
    Server,
    TcpServer,
    TwinServer,
    WireLog,
    answering,
    main_of,
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


class SerialRobot(RtuSession):
    """A simulated gripper that is the only device on a serial line."""

    def __init__(self, twin: RobotiqTwin, baud: int) -> None:
        super().__init__(twin, baud)
        self.body = twin.body
        self.set_fault, self.power_cycle = twin.set_fault, twin.power_cycle


def build(robot: str, options: RobotiqTwinOptions, log: WireLog) -> TwinServer:
    """Return the server of a robot of ``robots.toml``."""
    twin = twin_of(
        robot,
        unit_id=options.unit_id,
        object_mm=options.object_mm,
        activation_s=options.activation_s,
        activated=options.activated,
        echo_s=options.echo_s,
        gflt=options.gflt,
    )
    if options.serial:
        return Server(SerialRobot(twin, options.baud), PtyLine(options.link), log)
    own = options.host is None and sys.platform.startswith("linux")
    urcap_port = (URCAP_PORT if own else 0) if options.urcap_port is None else options.urcap_port
    handlers = {options.port: answering(lambda: TcpSession(twin) if options.framing == "tcp" else RtuSession(twin))}
    if urcap_port != options.port:
        handlers[urcap_port] = answering(lambda: UrcapSession(twin))
    return TcpServer(twin, handlers, log, options.host)


main = main_of(RobotiqTwinOptions, build)
