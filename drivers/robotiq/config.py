"""The frozen settings that the wire and the stop channel share."""

from __future__ import annotations

import msgspec

from strands_actors.contract.wire import MotorReport
from strands_actors.drivers.common.ports.addresses import parse_address

AXIS = "gripper"

TCP_PORT = 502
BAUD = 115_200
BAUD_RATES = (2_400, 4_800, 9_600, 19_200, 38_400, 57_600, BAUD, 230_400)
"""Baud rates of the gripper. Robotiq's own software sets which one is used."""


def is_serial(port: str) -> bool:
    """Return whether ``port`` is a serial device and not an address: a path, or COM and a number."""
    return port.startswith(("/", "~")) or (port.upper().startswith("COM") and port[3:].isdigit())


LATE_S = 0.3
"""A write of a killed client may wait this long in a gateway [assumed]. The root's stop uses a separate
connection, and may overtake it."""


class RobotiqConfig(msgspec.Struct, frozen=True):
    robot: str
    port: str
    unit_id: int
    stroke_mm: float
    activate: bool
    """Whether arming may activate the gripper, which moves its fingers."""
    tcp_port: int | None = None
    baud: int = BAUD
    """Bits per second, if ``port`` is a serial device."""

    @property
    def serial(self) -> bool:
        return is_serial(self.port)

    def address(self) -> tuple[str, int]:
        """Return host and port. Raise ``ValueError`` if ``port`` is not an address, or if its number differs from
        ``tcp_port``."""
        host, number = parse_address(self.port, self.tcp_port or TCP_PORT)
        if self.tcp_port not in (None, number):
            raise ValueError(f"port is {self.port!r} and tcp_port {self.tcp_port}. Give one of the two")
        return host, number

    def aperture_mm(self, closed: float) -> float:
        """Return the nominal opening. The real scale is not linear at its ends [assumed]."""
        return self.stroke_mm * (1.0 - closed)

    def report(self, written: bool, heard: bool, detail: str) -> MotorReport:
        """Return the report of the gripper. ``detail`` is why it is not known to be safe; empty if it is."""
        return MotorReport(AXIS, self.unit_id, written, heard, not detail, detail)
