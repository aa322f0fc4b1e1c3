"""The stop channel to a legged robot: the supervising process (root) stops it after the wire process has ended."""

from __future__ import annotations

from collections.abc import Sequence

import trio

from strands_actors.contract.safe_state import SafeState
from strands_actors.contract.wire import MotorReport, StopChannel, WireDown
from strands_actors.kernel.clock import Clock

from . import protocol as p
from . import rpc
from .config import UnitreeConfig
from .gates import CONTROL_S, fsm_in_control, mode_in_control
from .link import FIND_S, Link, Service
from .safing import bring_down, reports
from .session import ASK_EVERY_NS


class Holder:
    """Ask the robot, during one stop, which onboard mode or state controls it instead of our commands.

    A robot that stands by its own controller shows torque and ignores our commands. Without this question its stop
    could not be confirmed after the end of the wire process.
    """

    def __init__(self, link: Link, config: UnitreeConfig) -> None:
        self._has_fsm = config.model.handshake == "fsm"
        self._clock = link.clock
        name = config.model.service if self._has_fsm else rpc.MOTION_SWITCHER
        self._service = Service(link.participant, name, link.clock)
        self._began_ns = self._requested_ns = 0
        self._holder = ""

    def begin(self) -> None:
        """Forget earlier answers. The robot may have been released since."""
        self._began_ns, self._requested_ns, self._holder = self._clock.now_ns(), 0, ""

    def held_by(self) -> str:
        """Return the mode or state in the newest answer, and repeat the question. Empty: none, or not known."""
        now_ns = self._clock.now_ns()
        if now_ns - self._requested_ns >= ASK_EVERY_NS:
            self._requested_ns = now_ns
            self._service.ask(rpc.GET_FSM_ID if self._has_fsm else rpc.CHECK_MODE, self._on_response)
        return self._holder

    def _on_response(self, response: rpc.Response) -> None:
        if response.error or response.id < self._began_ns:
            return
        if self._has_fsm:
            self._holder = fsm_in_control(rpc.fsm_id(response))
        else:
            self._holder = mode_in_control(rpc.mode_name(response))


class UnitreeStopChannel(StopChannel):
    """A separate DDS participant in the root process. It connects to the robot at the start, so that a stop
    need not wait for the connection."""

    def __init__(self, config: UnitreeConfig, descriptors: Sequence[int], clock: Clock) -> None:
        self._config = config
        self._clock = clock
        self._link: Link | None = None
        self._holder: Holder | None = None  # None of Unitree's simulator, which has no mode
        self._listens = False

    async def serve(self, task_status: trio.TaskStatus[None] = trio.TASK_STATUS_IGNORED) -> None:
        self._link = link = Link(self._config, self._clock)
        if not self._config.simulator:
            self._holder = Holder(link, self._config)
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
        holder = self._holder
        if holder is None:
            return await bring_down(link, safe_state)
        holder.begin()
        return await bring_down(link, safe_state, holder.held_by)

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
