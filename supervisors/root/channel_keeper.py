"""Keep the stop channels of root and standby ready.

A wire hands over the descriptors for both when it opens. Its link counts as up only when both channels are
ready. The root's channel is closed before the next wire opens the port, since an open port is locked. When one
of the channels is no longer ready, the gate gets a message, and arms nothing until it is.
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
from strands_actors.kernel.refusals import Code
from strands_actors.supervisors.gate.messages import StandbyIs
from strands_actors.supervisors.root.messages import HandedOver, Handover
from strands_actors.supervisors.wire.messages import HandOverAgain

from .guarded import GuardedStandby
from .stop_channel import serve

AGAIN_S = 0.5
"""Pause before another attempt. A controller may still count the session of a standby that has
ended."""


class ChannelKeeper:
    """The stop channels of one robot.

    Args:
        driver: The driver of the robot.
        standby: The standby; None in tests with one process.
        broken: Called with the reason when the root's channel is lost.

    Attributes:
        own: The root's channel; None while it has no channel.
    """

    def __init__(self, driver: Driver, standby: GuardedStandby | None, broken: Callable[[str], None]) -> None:
        self._driver = driver
        self.standby = standby
        self._broken = broken
        self.own: StopChannel | None = None
        self._standby_problem = self._lacks = ""
        self._scope = trio.CancelScope()
        self._again = trio.CancelScope()  # of a handover to a new standby

    def begin(self, context: Context, gate: Ref, transport: Ref) -> None:
        """Start.

        Args:
            context: The context of the guardian.
            gate: The gate, which gets messages on whether both channels are ready.
            transport: The transport, which is asked to hand over again.
        """
        self._context = context
        self._gate = gate
        self._transport = transport

    def take(self, message: Handover) -> Deferred | Refused:
        """Open the channels with the descriptors of a wire. The reply comes when both are ready."""
        if message.again:
            self._again.cancel()
            self._again = trio.CancelScope()
            deferred = self._context.defer()
            self._context.start_soon(self._answer_guarded, self._again, deferred, message.descriptors)
            return deferred
        if missing := RESERVE.check():
            for fd in message.descriptors:
                os.close(fd)
            return Refused(Code.NO_RESERVE, f"the root could not stop the robot: {missing}", "close other programs")
        try:
            spare = () if self.standby is None else _duplicates(message.descriptors)
        except OSError as error:
            for fd in message.descriptors:
                os.close(fd)
            return Refused(Code.NO_DESCRIPTOR, f"the standby cannot be given the port: {error}", "ulimit -n 1024")
        self._drop()
        if self.standby is not None:
            self._standby_problem = "the standby process has no way to the hardware yet"
        self.own = path = self._driver.stop_channel(message.descriptors, self._context.clock)
        self._scope = trio.CancelScope()
        deferred = self._context.defer()
        self._context.start_soon(self._keep, path, self._scope, deferred, spare)
        return deferred

    def look(self) -> None:
        """Tell the gate when the root's channel begins or ends to lack something."""
        lacks = "" if self.own is None else self.own.lacks
        if lacks != self._lacks:
            self._lacks = lacks
            self._tell_gate()

    def set_standby_problem(self, problem: str) -> None:
        """Tell the gate why there is no standby; an empty text means that there is one."""
        self._standby_problem = problem
        self._tell_gate()

    def _tell_gate(self) -> None:
        self._gate.tell(StandbyIs(self._standby_problem or self._lacks))

    async def let_go(self) -> None:
        """Close both channels, since they would keep the next wire from the port."""
        self._drop()
        if self.standby is not None:
            await self.standby.let_go()

    async def _keep(
        self, path: StopChannel, scope: trio.CancelScope, deferred: Deferred, spare: tuple[int, ...]
    ) -> None:
        """Serve the root's channel, and give the standby its descriptors (``spare``)."""
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
                why = str(first_of(down))
                if ready:
                    self._broken(f"the root has lost its way to the hardware: {why}")
                else:
                    deferred.send(Refused(Code.NO_STOP_CHANNEL, why))  # The wire will try again.

    async def _answer_guarded(
        self, scope: trio.CancelScope, deferred: Deferred, descriptors: tuple[int, ...]
    ) -> None:
        """Give a new standby a channel. Until it has one, ask the wire again, since a wire that is open
        does not try by itself."""
        answer: HandedOver | Refused | None = None
        with scope:
            answer = await self._guard(descriptors) or HandedOver()
            deferred.send(answer)
            if isinstance(answer, Refused):
                await trio.sleep(AGAIN_S)
                self._transport.tell(HandOverAgain())
        if answer is None:
            deferred.send(Refused(Code.NO_STOP_CHANNEL, "the wire has closed its link"))

    async def _guard(self, descriptors: tuple[int, ...]) -> Refused | None:
        """Give the standby its channel and tell the gate. The descriptors are closed."""
        try:
            if self.standby is None:
                return None
            refusal = await self.standby.guard(descriptors)
        finally:
            for fd in descriptors:
                os.close(fd)
        why = "" if refusal is None else f"the standby process has no way to the hardware: {refusal.reason}"
        self.set_standby_problem(why)
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
