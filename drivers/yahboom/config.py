"""Settings of an M3 Pro, shared by the process that drives it (the wire) and the supervising process (root), which
can also stop it."""

from __future__ import annotations

import os

import msgspec

from strands_actors.contract.wire import WireDown
from strands_actors.drivers.common.ports.addresses import parse_address

from .protocol import PORT
from .robots import Servo

ROSBRIDGE = "rosbridge"
ROS2 = "ros2"
LINKS = {
    ROSBRIDGE: f"{__package__}.rosbridge:RosbridgeLink",
    ROS2: f"{__package__}.ros2:Ros2Link",
}
"""Links by transport. The wire process and the root use the same."""

DEFAULT_HOST = "127.0.0.1"

DOMAIN = 30
MAX_DOMAIN = 232
"""``ROS_DOMAIN_ID`` of the image that the robot is shipped with."""


def domain_of_environment() -> int:
    """Return the ROS domain: the environment variable ``ROS_DOMAIN_ID``, or ``DOMAIN`` if it is not set. Raise
    ``WireDown`` for an invalid value."""
    text = os.environ.get("ROS_DOMAIN_ID") or str(DOMAIN)
    if not text.isdecimal() or int(text) > MAX_DOMAIN:
        raise WireDown(f"ROS_DOMAIN_ID is {text!r}. Give 0..{MAX_DOMAIN}, or unset it for {DOMAIN}")
    return int(text)


class YahboomConfig(msgspec.Struct, frozen=True):
    robot: str
    port: str
    transport: str
    timeout_s: float
    axes: tuple[str, ...]
    ids: tuple[int, ...]
    servos: tuple[Servo, ...]
    humble: bool = False

    def address(self) -> tuple[str, int]:
        """Return host and port of rosbridge. Raise ``ValueError`` for an invalid ``port``."""
        return parse_address(self.port.removeprefix("ws://").removesuffix("/") or DEFAULT_HOST, PORT)
