"""What the wire and the stop channel of a gripper know of it."""

from __future__ import annotations

import msgspec

from strands_actors.contract.wire import MotorReport
from strands_actors.drivers.common.addresses import parse_address

AXIS = "gripper"

TCP_PORT = 502
BAUD = 115_200
BAUD_RATES = (2_400, 4_800, 9_600, 19_200, 38_400, 57_600, BAUD, 230_400)
"""Which of them it speaks is set by Robotiq's own software."""


def is_serial(port: str) -> bool:
    """Whether a ``port`` is a serial device and not an address: a path, or COM and a number."""
    return port.startswith(("/", "~")) or (port.upper().startswith("COM") and port[3:].isdigit())


LATE_S = 0.3
"""What a client has written that was killed may wait so long in a gateway [assumed]. The stop of the root
comes by a connection of its own, and overtakes it."""


class RobotiqConfig(msgspec.Struct, frozen=True):
    robot: str
    port: str
    unit_id: int
    stroke_mm: float
    activate: bool
    """Whether arming may activate the gripper, which moves its fingers."""
    tcp_port: int | None = None
    baud: int = BAUD
    """Bits a second, where ``port`` is a serial device."""

    @property
    def serial(self) -> bool:
        return is_serial(self.port)

    def address(self) -> tuple[str, int]:
        """Return host and port. Raise ``ValueError`` for a ``port`` that is no address, or names
        another one than ``tcp_port``."""
        host, number = parse_address(self.port, self.tcp_port or TCP_PORT)
        if self.tcp_port not in (None, number):
            raise ValueError(f"port is {self.port!r} and tcp_port {self.tcp_port}. Give one of the two")
        return host, number

    def aperture_mm(self, closed: float) -> float:
        """Return the nominal opening: the real scale is not linear at its ends [assumed]."""
        return self.stroke_mm * (1.0 - closed)

    def report(self, written: bool, heard: bool, detail: str) -> MotorReport:
        """Return what became of the gripper. ``detail``: why it is not known to be safe; empty when
        it is."""
        return MotorReport(AXIS, self.unit_id, written, heard, not detail, detail)
