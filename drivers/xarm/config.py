"""The settings of an xArm that the wire process and the root's stop channel share."""

from __future__ import annotations

import msgspec

from strands_actors.contract.wire import WireDown
from strands_actors.drivers.common.kit.hand import AXIS as HAND
from strands_actors.drivers.common.ports.addresses import parse_address

from .arms import AXES, Arm, ArmType
from .protocol import CONTROL_PORT, JOINTS, Version

LATE_S = 0.3
"""How long a request may wait in the controller's queue after its client was killed, in seconds [assumed: a slower
controller counts as lost, see ``silent_s``]. A stop on another connection can overtake such a request."""


class XArmConfig(msgspec.Struct, frozen=True):
    robot: str
    port: str
    arm: Arm
    gripper: str = ""
    """The gripper on the flange (``grippers``); empty for none."""
    silent_s: float = 0.3
    """The link counts as lost after this many seconds without a report, or with a request that is not answered."""

    def address(self) -> tuple[str, int]:
        """Return the host and the control port. Raise ``ValueError`` if ``port`` is not a valid address."""
        return parse_address(self.port, CONTROL_PORT)

    @property
    def axes(self) -> tuple[str, ...]:
        """The axes of the robot: the joints, and then its gripper."""
        return (*AXES, HAND) if self.gripper else AXES

    @property
    def host(self) -> str:
        return self.address()[0]

    def find_arm_type(self, version: Version) -> ArmType:
        """Return the type of the connected arm. Raise ``WireDown`` if this robot has no such type."""
        index = self.arm.type_index(version)
        if index is None:
            numbers = ", ".join(str(number) for number in sorted({arm_type.number for arm_type in self.arm.types}))
            raise WireDown(
                f"open: the arm at {self.port} has {version.axes} joints and type {version.arm_type}, but "
                f"{self.robot} has {JOINTS} joints and type {numbers}. Check the address and the robot's name"
            )
        return self.arm.types[index]
