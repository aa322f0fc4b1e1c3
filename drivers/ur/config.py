"""The immutable settings of a UR arm. The wire process and the stop channel use the same ones."""

from __future__ import annotations

from typing import Literal

import msgspec

from strands_actors.drivers.common.kit.hand import AXIS
from strands_actors.drivers.common.ports.addresses import parse_address

from .arms import JOINTS
from .gates import CONTROL_HZ
from .protocol import RTDE_PORT

ControlMethod = Literal["ur-rtde", "script"]
"""How to command a robot: by ur-rtde, or by our own control script."""


class URConfig(msgspec.Struct, frozen=True):
    robot: str
    port: str
    silent_s: float = 0.3
    """If the controller's clock does not advance for this time, the connection counts as lost."""
    rtde_hz: float | None = None
    """Rate at which the controller exchanges samples and registers, in Hz. None: the default of this driver."""
    control: ControlMethod | None = None
    """How to command the robot. None: by ur-rtde if it can be imported, else by our own script."""
    drives_gripper: bool = False
    """True if the gripper on the flange is an axis of the robot, driven by the text port of its URCap."""
    activates_gripper: bool = True
    """True if arming may activate the gripper, which moves its fingers through their whole stroke."""

    @property
    def axes(self) -> tuple[str, ...]:
        return (*JOINTS, AXIS) if self.drives_gripper else JOINTS

    @property
    def ids(self) -> range:
        return range(len(self.axes))

    @property
    def samples_hz(self) -> float:
        return self.rtde_hz or CONTROL_HZ

    @property
    def host(self) -> str:
        """The controller's host name or IP address, taken from ``port``.

        Raises:
            ValueError: ``port`` is not an address, or it contains another TCP port than 30004 (RTDE).
        """
        host, port = parse_address(self.port, RTDE_PORT)
        if port != RTDE_PORT:
            raise ValueError(
                f"port is {self.port!r}. Give the controller's address without a port number: its ports are fixed"
            )
        return host
