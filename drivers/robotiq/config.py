"""The immutable settings of a gripper. The wire process and the stop channel use the same ones."""

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
    """Return True if ``port`` is a serial device (a path, or COM and a number). Otherwise it is a network
    address."""
    return port.startswith(("/", "~")) or (port.upper().startswith("COM") and port[3:].isdigit())


LATE_S = 0.3
"""A command of a killed process may wait in a gateway for this time [assumed]. It would then arrive after the stop
that the root process sends on another connection."""


class RobotiqConfig(msgspec.Struct, frozen=True):
    robot: str
    port: str
    unit_id: int
    stroke_mm: float
    activate: bool
    """True if arming may activate the gripper. An activation moves its fingers."""
    tcp_port: int | None = None
    baud: int = BAUD
    """Bits per second, if ``port`` is a serial device."""

    @property
    def serial(self) -> bool:
        return is_serial(self.port)

    def address(self) -> tuple[str, int]:
        """Return the host and the TCP port of the gripper.

        Raises:
            ValueError: ``port`` is not an address, or the TCP port in it differs from ``tcp_port``.
        """
        host, number = parse_address(self.port, self.tcp_port or TCP_PORT)
        if self.tcp_port not in (None, number):
            raise ValueError(f"port is {self.port!r} and tcp_port is {self.tcp_port}. Give the TCP port only once")
        return host, number

    def aperture_mm(self, closed: float) -> float:
        """Return the opening between the fingers in mm, for the closed fraction ``closed``.

        This is the nominal value. The real relation is not linear near both ends [assumed].
        """
        return self.stroke_mm * (1.0 - closed)

    def report(self, written: bool, acknowledged: bool, detail: str) -> MotorReport:
        """Return the report on a stop of the gripper.

        ``detail`` is the reason why the gripper is not known to be safe. It is empty for a safe gripper.
        """
        return MotorReport(AXIS, self.unit_id, written, acknowledged, not detail, detail)
