"""The root's way to a Crazyflie: a peer of its own, that speaks only when it has to.

On UDP the drone answers whoever spoke last, so the socket is open and silent until then. A radio's
dongle is the wire process's; when that is gone, a process of its own opens it (``stop_process``),
so that no USB library is loaded in the root.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence

import msgspec
import trio

from strands_actors.contract.driver import MotorReport, StopChannel, WireDown
from strands_actors.contract.safe_state import SafeState
from strands_actors.kernel.clock import Clock

from .config import CrazyflieConfig, Place
from .links import Link, open_link
from .session import Session
from .stopping import STOP_S, Outcome, bring_down

PROCESS = f"{__package__}.stop_process"


class CrazyflieStopChannel(StopChannel):
    def __init__(self, config: CrazyflieConfig, descriptors: Sequence[int], clock: Clock) -> None:
        self._config = config
        self._descriptors = tuple(descriptors)
        self._clock = clock
        self._link: Link | None = None

    async def serve(self, task_status: trio.TaskStatus[None] = trio.TASK_STATUS_IGNORED) -> None:
        if self._config.place().kind == "udp":
            self._link = await open_link(self._config.place())
        task_status.started()

    async def make_safe(self, safe_state: str) -> tuple[MotorReport, ...]:
        within = SafeState.LAND if safe_state == SafeState.HOLD else safe_state
        try:
            place = self._config.place()
            outcome = await (self._by_process(within) if place.is_usb else self._by_link(place, within))
        except WireDown as down:
            outcome = Outcome(False, False, str(down))
        return outcome.reports()

    def close(self) -> None:
        if self._link is not None:
            self._link.close()
        self._link = None

    async def _by_link(self, place: Place, safe_state: str) -> Outcome:
        descriptors, self._descriptors = self._descriptors, ()  # what was handed over may be dead the next time
        link, self._link = self._link, None
        link = link or await open_link(place, descriptors)
        try:
            return await bring_down(Session(link, self._clock), safe_state)
        finally:
            link.close()

    async def _by_process(self, safe_state: str) -> Outcome:
        command = [sys.executable, "-m", PROCESS, self._config.port, safe_state]
        with trio.move_on_after(STOP_S):
            done = await trio.run_process(command, capture_stdout=True, check=False)
            try:
                return msgspec.json.decode(done.stdout, type=Outcome)
            except msgspec.DecodeError:
                return Outcome(False, False, f"the process that lands it ended with code {done.returncode}")
        return Outcome(False, False, "the process that lands it did not end")
