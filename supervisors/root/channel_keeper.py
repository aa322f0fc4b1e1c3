"""Keep the stop channels of the root and of the standby process ready. A stop channel is the way to the hardware
without the wire process.

When the wire process connects to the robot, it hands over file descriptors for both channels. The robot counts as
connected only when both channels are ready. The root's channel is closed before the next wire process opens the
port, since an open port is locked. If one channel is no longer ready, the gate is informed. It then arms nothing
until the channel is ready again.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence

import trio

from strands_actors.contract.driver import Driver
from strands_actors.contract.wire import StopChannel, WireDown
from strands_actors.kernel.actor import Context, Deferred, first_of
from strands_actors.kernel.messages import Refused
from strands_actors.kernel.node import Ref
from strands_actors.kernel.processes.reserve import RESERVE
from strands_actors.supervisors.gate.messages import StandbyIs
from strands_actors.supervisors.refusals import no_stop_channel
from strands_actors.supervisors.root.messages import HandedOver, Handover
from strands_actors.supervisors.wire.messages import HandOverAgain

from . import refusals
from .guarded import GuardedStandby
from .stop_channel import serve

AGAIN_S = 0.5
"""Pause before another attempt, in seconds. A controller may still count the session of the standby that has
ended."""


class ChannelKeeper:
    """The stop channels of the root and the standby of one robot.

    Args:
        driver: The driver of the robot.
        standby: The standby; None in tests with one process.
        broken: Called with the reason when the root's channel has failed.

    Attributes:
        own: The root's channel; None while there is none.
    """

    def __init__(self, driver: Driver, standby: GuardedStandby | None, broken: Callable[[str], None]) -> None:
        self._driver = driver
        self.standby = standby
        self._broken = broken
        self.own: StopChannel | None = None
        self._standby_problem = self._lacks = ""
        self._scope = trio.CancelScope()
        self._again = trio.CancelScope()  # cancels a handover to a new standby

    def begin(self, context: Context, gate: Ref, transport: Ref) -> None:
        """Set what the actor's context provides. Called once, before all other methods.

        Args:
            context: The context of the guardian.
            gate: The gate. It is informed whether both channels are ready.
            transport: The transport. It is asked to hand over descriptors again, for a new standby.
        """
        self._context = context
        self._gate = gate
        self._transport = transport

    def take(self, message: Handover) -> Deferred | Refused:
        """Open the stop channels of root and standby with the descriptors from the wire process. The reply is sent
        when both are ready."""
        if message.again:
            self._again.cancel()
            self._again = trio.CancelScope()
            deferred = self._context.defer()
            self._context.start_soon(self._answer_guarded, self._again, deferred, message.descriptors)
            return deferred
        if missing := RESERVE.check():
            for fd in message.descriptors:
                os.close(fd)
            return refusals.no_reserve(missing)
        try:
            spare = () if self.standby is None else _duplicates(message.descriptors)
        except OSError as error:
            for fd in message.descriptors:
                os.close(fd)
            return refusals.port_not_passed(str(error))
        self._drop()
        if self.standby is not None:
            self._standby_problem = "the standby process has no connection to the robot yet"
        self.own = path = self._driver.stop_channel(message.descriptors, self._context.clock)
        self._scope = trio.CancelScope()
        deferred = self._context.defer()
        self._context.start_soon(self._keep, path, self._scope, deferred, spare)
        return deferred

    def look(self) -> None:
        """Inform the gate when the root's stop channel is no longer ready for a stop, or is ready again."""
        lacks = "" if self.own is None else self.own.lacks
        if lacks != self._lacks:
            self._lacks = lacks
            self._tell_gate()

    def set_standby_problem(self, problem: str) -> None:
        """Inform the gate why the standby cannot stop the robot; an empty text means that it can."""
        self._standby_problem = problem
        self._tell_gate()

    def _tell_gate(self) -> None:
        self._gate.tell(StandbyIs(self._standby_problem or self._lacks))

    async def release_channel(self) -> None:
        """Close both stop channels (of the root and of the standby), since the next wire process could not open
        the port otherwise."""
        self._drop()
        if self.standby is not None:
            await self.standby.release_channel()

    async def _keep(
        self, path: StopChannel, scope: trio.CancelScope, deferred: Deferred, spare: tuple[int, ...]
    ) -> None:
        """Run the root's stop channel, and give the standby the descriptors ``spare`` for its own stop channel."""
        ready = False
        guarded = trio.Event()
        refusal: Refused | None = None

        async def guard() -> None:
            nonlocal refusal
            refusal = await self._guard(spare)
            guarded.set()

        with scope:
            try:
                async with trio.open_nursery() as nursery:
                    nursery.start_soon(guard)
                    await nursery.start(serve, path)
                    ready = True
                    await guarded.wait()
                    deferred.send(refusal or HandedOver())
            except* WireDown as down:
                reason = str(first_of(down))
                if ready:
                    self._broken(f"the root process has lost its connection to the robot: {reason}")
                else:
                    # The wire process then closes the link and tries again later.
                    deferred.send(no_stop_channel(reason))

    async def _answer_guarded(
        self, scope: trio.CancelScope, deferred: Deferred, descriptors: tuple[int, ...]
    ) -> None:
        """Give a new standby a stop channel, and reply to the wire process. If that fails, ask the wire process
        again after a pause, since it does not hand over again by itself."""
        answer: HandedOver | Refused | None = None
        with scope:
            answer = await self._guard(descriptors) or HandedOver()
            deferred.send(answer)
            if isinstance(answer, Refused):
                await trio.sleep(AGAIN_S)
                self._transport.tell(HandOverAgain())
        if answer is None:
            deferred.send(refusals.link_closed())

    async def _guard(self, descriptors: tuple[int, ...]) -> Refused | None:
        """Give the standby its stop channel, and inform the gate whether it is ready. The descriptors are closed
        in this process."""
        try:
            if self.standby is None:
                return None
            refusal = await self.standby.guard(descriptors)
        finally:
            for fd in descriptors:
                os.close(fd)
        reason = "" if refusal is None else f"the standby process has no connection to the robot: {refusal.reason}"
        self.set_standby_problem(reason)
        return refusal

    def _drop(self) -> None:
        self._again.cancel()
        if self.own is not None:
            self._scope.cancel()
            self.own.close()
            self.own = None
            self._lacks = ""


def _duplicates(descriptors: Sequence[int]) -> tuple[int, ...]:
    """Return duplicates of all descriptors. If ``OSError`` is raised, all of them are closed again."""
    made: list[int] = []
    try:
        for fd in descriptors:
            made.append(os.dup(fd))
    except OSError:
        for fd in made:
            os.close(fd)
        raise
    return tuple(made)
