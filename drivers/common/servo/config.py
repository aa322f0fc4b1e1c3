"""What the wire and the stop channel of position servos know of their robot."""

from __future__ import annotations

from collections.abc import Mapping

import msgspec

from strands_actors.drivers.common.calibration import MotorCalibration

from .axes import Axis


class ServoConfig(msgspec.Struct, frozen=True):
    robot: str
    port: str
    baud: int
    joints: tuple[Axis, ...]
    calibration: Mapping[str, MotorCalibration] | None
    calibration_source: str
    timeout_s: float = 0.5
    """How long the whole bus may be silent before it counts as lost."""
    others: tuple[int, ...] = ()
    """Ids of servos on this bus that are the robot's and not driven."""
    modes: Mapping[str, int] = {}
    """Operating modes of its servos, by joint, where a protocol has several."""
    passive: bool = False
    """Whether it is a leader arm: its wire energises nothing and takes no target."""

    @property
    def ids(self) -> tuple[int, ...]:
        return tuple(axis.id for axis in self.joints)
