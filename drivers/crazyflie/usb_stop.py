"""Stop a Crazyflie by its radio or USB, in a separate process. The process opens the device after the process
that flew the drone has ended and thereby released it."""

from __future__ import annotations

from collections.abc import Sequence

import trio

from strands_actors.contract.safe_state import SafeState
from strands_actors.contract.wire import MotorReport, ProcessSpent, StopChannel, WireDown
from strands_actors.drivers.common.kit.outcome import Outcome
from strands_actors.kernel.clock import Clock

from .config import CrazyflieConfig
from .robots import AXES
from .session import CrazyflieSession
from .stopping import bring_down
from .usb_links import load_usb, open_usb_link


class UsbStop(StopChannel):
    def __init__(self, config: CrazyflieConfig, descriptors: Sequence[int], clock: Clock) -> None:
        self._config = config
        self._clock = clock

    async def serve(self, task_status: trio.TaskStatus[None] = trio.TASK_STATUS_IGNORED) -> None:
        # A stop must not import a module, because that takes time and free files.
        load_usb()
        task_status.started()

    async def make_safe(self, safe_state: SafeState) -> tuple[MotorReport, ...]:
        try:
            link = await open_usb_link(self._config.endpoint())
            try:
                return (await bring_down(CrazyflieSession(link, self._clock), safe_state)).reports(AXES)
            finally:
                link.close()
        except (WireDown, ProcessSpent) as failure:
            return Outcome(False, False, str(failure)).reports(AXES)

    def close(self) -> None:
        """Do nothing, because the device is open only during a stop."""
