"""Connect a robot handle to processes that another program has started, over a zenoh session of its own.

The handle neither starts nor ends these processes. It only opens and closes a connection to them.
"""

from __future__ import annotations

import contextlib
from abc import abstractmethod
from collections.abc import Awaitable, Callable

import trio

from strands_actors.contract.driver import Driver, Reason
from strands_actors.kernel.channels.zenoh_mesh import ZenohMesh
from strands_actors.kernel.clock import MonotonicClock
from strands_actors.kernel.node import AskTimeout, Node, Unreachable
from strands_actors.supervisors import stop_result
from strands_actors.supervisors.gate.messages import Lease, Release, Stop
from strands_actors.supervisors.stop_result import StopResult

from .plan import Plan
from .robot_processes import Processes


class SessionProcesses(Processes):
    """The base of a connection to processes that another program has started.

    Args:
        name: Name of the node (the actors of this connection).
        nursery: Tasks of the connection run in it.
        plan: The robot.
        driver: The driver of the robot.
    """

    def __init__(self, name: str, nursery: trio.Nursery, plan: Plan, driver: Driver) -> None:
        super().__init__(Node(name, MonotonicClock()), nursery, plan, driver)
        self._scope: trio.CancelScope | None = None

    @property
    def started(self) -> bool:
        return self._scope is not None

    async def _join(self, session: ZenohMesh, *background: Callable[[], Awaitable[None]]) -> None:
        """Serve an open session and run ``background`` until ``_leave``, then reach the robot (``_reach``)."""
        self._scope = trio.CancelScope()
        self.nursery.start_soon(self._serve, session, self._scope, background)
        try:
            await self._reach()
        except BaseException:
            self._leave()
            raise

    @abstractmethod
    async def _reach(self) -> None:
        """Wait until the robot answers. Raise ``NotConnected`` if it does not."""

    async def _serve(
        self, session: ZenohMesh, scope: trio.CancelScope, background: tuple[Callable[[], Awaitable[None]], ...]
    ) -> None:
        try:
            with scope:
                async with trio.open_nursery() as nursery:
                    await nursery.start(self.node.run)
                    await nursery.start(session.run)
                    for run in background:
                        nursery.start_soon(run)
        finally:
            with trio.CancelScope(shield=True):
                await trio.to_thread.run_sync(session.close)

    def _leave(self) -> None:
        if self._scope is not None:
            self._scope.cancel()
            self._scope = None

    async def end(self, lease: Lease | None) -> StopResult:
        """If this caller holds the lease (the right to command), stop the robot and release the lease. Then
        disconnect. Without the lease the robot is not stopped, because another program may be commanding it."""
        result: StopResult = stop_result.Confirmed(stop_result.NothingRan("nothing was commanded from here"))
        if self.started and lease is not None:
            # The reason CLEANUP would end the robot's processes, which this caller did not start.
            stop = Stop(Reason.STOP, self.holder)
            try:
                answer = await self.gate.ask(stop, self.patience.stop_s)
                result = stop_result.of_answer("cleanup", answer, self.driver.axes)
            except (AskTimeout, Unreachable) as failure:
                result = await self._stop_unanswered(stop, failure)
            with contextlib.suppress(AskTimeout, Unreachable):  # If the release fails, the lease ends by itself.
                await self.gate.ask(Release(lease.id), self.patience.ask_s)
        self._leave()
        return result

    @abstractmethod
    async def _stop_unanswered(self, stop: Stop, failure: Exception) -> StopResult:
        """Return the result of a stop that the gate did not answer, at the end of the connection."""

    async def require_mesh(self) -> None:
        """Do nothing. The program that started the robot decides about its mesh."""
