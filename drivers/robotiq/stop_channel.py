"""The root's way to a gripper: a connection made for the stop."""

from __future__ import annotations

from collections.abc import Sequence

from strands_actors.contract.driver import MotorReport, StopChannel, WireDown
from strands_actors.drivers.common.tcp_port import open_tcp
from strands_actors.kernel.clock import Clock

from .client import OpenStream, hold, open_gripper
from .config import RobotiqConfig


class RobotiqStopChannel(StopChannel):
    """By the time it is needed the wire's connection is gone with its process, so a gateway that takes one client
    takes this one. A name for an address has to be looked up then, too: a number is quicker."""

    def __init__(
        self, config: RobotiqConfig, descriptors: Sequence[int], clock: Clock, open_stream: OpenStream = open_tcp
    ) -> None:
        self._config = config
        self._clock = clock
        self._open_stream = open_stream

    async def make_safe(self, safe_state: str) -> tuple[MotorReport, ...]:
        try:
            gripper = await open_gripper(self._config, self._clock, self._open_stream)
        except WireDown as error:
            return (self._config.report(False, False, str(error)),)
        try:
            return (await hold(gripper, None, self._config),)
        finally:
            gripper.close()

    def close(self) -> None:
        """Nothing is kept open."""
