"""The frozen settings that the wire and the stop channel share."""

from __future__ import annotations

import msgspec

from strands_actors.contract.wire import WireDown
from strands_actors.drivers.common.ports.addresses import parse_address

from .arms import Arm, ArmType
from .protocol import CONTROL_PORT, JOINTS, Version

LATE_S = 0.3
"""A request of a killed client may wait this long in the controller's queue [assumed: a controller that
takes longer counts as lost, see ``silent_s``]. A stop on another connection overtakes it."""


class XArmConfig(msgspec.Struct, frozen=True):
    robot: str
    port: str
    arm: Arm
    silent_s: float = 0.3
    """The link counts as lost after this long without a report, or without an outstanding reply."""

    def address(self) -> tuple[str, int]:
        """Return host and control port. Raise ``ValueError`` if ``port`` is not an address."""
        return parse_address(self.port, CONTROL_PORT)

    @property
    def host(self) -> str:
        return self.address()[0]

    def kind_of(self, version: Version) -> ArmType:
        """Return the arm's type. Raise ``WireDown`` if it is not a type of this robot."""
        index = self.arm.type_at(version)
        if index is None:
            numbers = ", ".join(str(number) for number in sorted({kind.number for kind in self.arm.types}))
            raise WireDown(
                f"open: the arm at {self.port} has {version.axes} joints and is of type {version.arm_type}. "
                f"{self.robot} has {JOINTS}, of type {numbers}"
            )
        return self.arm.types[index]
