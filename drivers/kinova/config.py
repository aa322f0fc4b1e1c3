"""The immutable settings of a Gen3 arm. The wire process and the stop channel use the same ones."""

from __future__ import annotations

import msgspec

from strands_actors.drivers.common.kit.hand import AXIS as HAND
from strands_actors.drivers.common.ports.addresses import parse_address

from .protocol import TCP_PORT


class KinovaConfig(msgspec.Struct, frozen=True):
    robot: str
    port: str
    login: tuple[str, str]  # User name and password for the base.
    axes: tuple[str, ...]  # The joints.
    fastest_rad_s: float
    period_s: float
    silent_s: float
    """The arm is stopped after this long without a new speed from us, or without new feedback."""

    gripper: str = ""
    """The gripper on the interface; empty for none."""

    @property
    def all_axes(self) -> tuple[str, ...]:
        """The joints, and then the gripper if there is one."""
        return (*self.axes, HAND) if self.gripper else self.axes

    def address(self) -> tuple[str, int]:
        """Return host and port. Raise ``ValueError`` if ``port`` is not an address."""
        return parse_address(self.port, TCP_PORT)
