"""Stop the parts of a robot without its wire process."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import trio

from strands_actors.contract.safe_state import SafeState
from strands_actors.contract.wire import MotorReport, StopChannel
from strands_actors.kernel.clock import Clock

from .config import PartConfig, PartsConfig, ordered
from .links import Links


class PartsStopChannel(StopChannel):
    """The connections of the root, or of the standby, to the gates and roots of the parts."""

    def __init__(self, config: PartsConfig, descriptors: Sequence[int], clock: Clock) -> None:
        self._config = config
        self._links = Links(config)

    async def serve(self, task_status: trio.TaskStatus[None] = trio.TASK_STATUS_IGNORED) -> None:
        await self._links.run(task_status)

    async def make_safe(self, safe_state: SafeState) -> tuple[MotorReport, ...]:
        reason = self._config.reason_for(safe_state)
        holds = any(safe_state in part.energised for part in self._config.parts)

        async def stop(part: PartConfig) -> tuple[MotorReport, ...]:
            return await self._links.stop(part, ordered(reason, part, holds), self._config.robot)

        return tuple(itertools.chain.from_iterable(await self._links.each(stop)))

    def close(self) -> None:
        """Do nothing. The connections end with ``serve``."""
