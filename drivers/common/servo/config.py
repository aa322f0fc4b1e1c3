"""The configuration of a robot of position servos, for all processes that use its port."""

from __future__ import annotations

from collections.abc import Mapping

import msgspec

from strands_actors.drivers.common.kit.calibration import MotorCalibration

from .axes import Axis
from .lowering import LoweringConfig


class ServoConfig(msgspec.Struct, frozen=True):
    robot: str
    port: str
    baud: int
    joints: tuple[Axis, ...]
    calibration: Mapping[str, MotorCalibration] | None
    calibration_source: str
    timeout_s: float = 0.5
    """How long the whole bus may be silent before it counts as lost, in seconds."""
    others: tuple[int, ...] = ()
    """Ids of servos on this bus that belong to the robot and are not driven."""
    modes: Mapping[str, int] = {}
    """Operating mode of each servo, by joint, if the protocol has several."""
    lowering: LoweringConfig | None = None
    """How the arm is lowered; None for a robot that is not."""
    passive: bool = False
    """True for a leader arm. Its wire energises nothing and takes no target."""

    @property
    def ids(self) -> tuple[int, ...]:
        return tuple(axis.id for axis in self.joints)
