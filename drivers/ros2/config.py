"""Settings of a robot that is a node of a ROS 2 graph, for the processes that command and stop it."""

from __future__ import annotations

import msgspec

from strands_actors.drivers.common.ports.ros2_graph import ROUTER
from strands_actors.kernel.channels.ros2.names import Dialect

from .table import Table


class Ros2Config(msgspec.Struct, frozen=True):
    robot: str
    port: str
    domain: int
    humble: bool
    timeout_s: float
    axes: tuple[str, ...]
    ids: tuple[int, ...]
    table: Table

    @property
    def router(self) -> str:
        return self.port or ROUTER

    @property
    def dialect(self) -> Dialect:
        return Dialect(self.domain, not self.humble)
