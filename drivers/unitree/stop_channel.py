"""The stop channel to a legged robot: the supervising process (root) stops it after the wire process has ended."""

from __future__ import annotations

from collections.abc import Sequence

import trio

from strands_actors.contract.safe_state import SafeState
from strands_actors.contract.wire import MotorReport, StopChannel, WireDown
from strands_actors.kernel.clock import Clock

from . import protocol as p
from .config import UnitreeConfig
from .gates import CONTROL_S
from .link import FIND_S, Link
from .safing import bring_down, reports


class UnitreeStopChannel(StopChannel):
    """A separate DDS participant in the root process. It connects to the robot at the start, so that a stop
    need not wait for the connection."""

    def __init__(self, config: UnitreeConfig, descriptors: Sequence[int], clock: Clock) -> None:
        self._config = config
        self._clock = clock
        self._link: Link | None = None
        self._listens = False

    async def serve(self, task_status: trio.TaskStatus[None] = trio.TASK_STATUS_IGNORED) -> None:
        self._link = link = Link(self._config, self._clock)
        async with trio.open_nursery() as nursery:
            await nursery.start(link.participant.run)
            link.state = await self._one_state()
            if link.state is None:  # A command needs the mode_machine from a state, or the robot ignores it.
                raise WireDown(
                    f"{self._config.port}: the root process received no LowState. Check the robot and the network"
                )
            with trio.move_on_after(FIND_S):
                await link.participant.wait_matched(link.commands)
            if not link.matched:
                raise WireDown(
                    f"{self._config.port}: the robot does not connect to the root process, which must be able to "
                    "stop it. Check the robot and the network"
                )
            task_status.started()

    async def make_safe(self, safe_state: SafeState) -> tuple[MotorReport, ...]:
        link = self._link
        if link is None:
            return reports(self._config.model, False, "the root process has not found the robot")
        # Send the first command at once. Only then subscribe to the states that confirm the stop.
        link.send_stop(link.safe_frame(safe_state == SafeState.DAMP))
        if not self._listens:
            self._listens = True
            link.listen()
        return await bring_down(link, safe_state)

    def close(self) -> None:
        if self._link is not None:
            self._link.close()
            self._link = None

    async def _one_state(self) -> p.State | None:
        """Receive one state with a temporary participant.

        The root process must not receive 500 states a second all the time, because that costs too much CPU time.
        """
        scout = Link(self._config, self._clock)
        scout.listen()
        try:
            with trio.move_on_after(FIND_S):
                while scout.state is None:
                    scout.poll()
                    await trio.sleep(CONTROL_S)
        finally:
            scout.close()
        return scout.state
