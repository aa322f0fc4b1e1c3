"""Stop a T1 from the supervising process (root), without the process that drives it."""

from __future__ import annotations

from collections.abc import Sequence

import trio

from strands_actors.contract.safe_state import SafeState
from strands_actors.contract.wire import MotorReport, StopChannel, WireDown
from strands_actors.kernel.clock import Clock

from .config import BoosterConfig
from .link import FIND_S, Link
from .stopping import bring_down, unconfirmed


class BoosterStopChannel(StopChannel):
    """The DDS connection by which the supervising process (root) stops the robot. The robot
    discovers it at the start, before a stop needs it.

    It subscribes to states only during a stop. Otherwise the root would receive 500 states a
    second.
    """

    def __init__(self, config: BoosterConfig, descriptors: Sequence[int], clock: Clock) -> None:
        self._config = config
        self._clock = clock
        self._link: Link | None = None

    async def serve(self, task_status: trio.TaskStatus[None] = trio.TASK_STATUS_IGNORED) -> None:
        self._link = link = Link(self._config, self._clock)
        async with trio.open_nursery() as nursery:
            await nursery.start(link.participant.run)
            with trio.move_on_after(FIND_S):
                await link.participant.wait_matched(link.commands, *link.calls.ends)
            if not link.matched:
                raise WireDown(
                    f"{self._config.host}: the robot has not discovered the stop connection. Check the network"
                )
            task_status.started()

    async def make_safe(self, safe_state: SafeState) -> tuple[MotorReport, ...]:
        if self._link is None:
            return unconfirmed(self._config.model, "the root has no connection to the robot")
        return await bring_down(self._link, safe_state)

    def close(self) -> None:
        if self._link is not None:
            self._link.close()
            self._link = None
