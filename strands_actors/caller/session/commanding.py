"""Send commands to a robot's gate, which checks them, under the program's lease (the right to command).

``ask`` is for the trio loop of this package. ``ask_here`` is for a thread of the program, which asks the gate
directly and waits. If a decision is needed (no lease, a stale lease, a running policy), the thread leaves the
command to the loop, so that such decisions are made in one place.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

from strands_actors.contract.driver import Driver
from strands_actors.contract.plain_numbers import as_python
from strands_actors.kernel.clock import Clock
from strands_actors.kernel.messages import Message, Refused
from strands_actors.kernel.node import AskTimeout, Unreachable
from strands_actors.supervisors.gate.actions import plain, refuse_shape
from strands_actors.supervisors.gate.messages import MOVE, Lease, Perform, Setpoint

from ..processes.robot_processes import Patience, Processes, unreachable
from . import refusals
from .portal import portal
from .rollouts import Rollouts
from .writer import STALE, Writer


class Order(NamedTuple):
    """One command that has no lease (right to command) yet.

    Attributes:
        verb: Name of the user's verb, for refusals.
        make: Makes the message from a lease.
        within_s: Longest time to wait for the answer.
    """

    verb: str
    make: Callable[[Lease], Message]
    within_s: float


class Orders:
    """Make the ``Order`` (a command without a lease yet) for a command or a service. Any thread may use it."""

    def __init__(self, driver: Driver, clock: Clock, patience: Patience) -> None:
        self._driver = driver
        self._clock = clock
        self._patience = patience

    def move(self, action: Mapping[str, Any]) -> Order | Refused:
        refusal = refuse_shape(action)
        if refusal is not None:
            return refusal.about(MOVE)
        return Order(MOVE, lambda lease: self._setpoint(lease, action), self._patience.ask_s)

    def perform(
        self, service: str, arguments: Mapping[str, Any], action: Mapping[str, Any] | None
    ) -> Order | Refused:
        """Return the ``Order`` for a service.

        Args:
            service: Name of the service.
            arguments: Arguments of the service.
            action: A command to write first. If it is refused, the service does not run.
        """
        arguments = {name: as_python(value) for name, value in arguments.items()}
        refusal = self._driver.check_service(service, arguments)
        if refusal is None and action is not None:
            refusal = refuse_shape(action)
        if refusal is not None:
            return refusal.about(service)

        def make(lease: Lease) -> Message:
            first = None if action is None else self._setpoint(lease, action)
            return Perform(lease.id, lease.epoch, service, plain(arguments), first)

        return Order(service, make, self._driver.SERVICES[service].within_s + self._patience.ask_s)

    def _setpoint(self, lease: Lease, action: Mapping[str, Any]) -> Setpoint:
        ttl_s = self._driver.timing.oneshot_ttl_s
        deadline_ns = self._clock.now_ns() + round(1e9 * (self._patience.command_s if ttl_s is None else ttl_s))
        return Setpoint(lease.id, lease.epoch, deadline_ns, plain(action), 0.0, ttl_s is None)


class Commanding:
    def __init__(self, processes: Processes, writer: Writer, rollouts: Rollouts) -> None:
        self._processes = processes
        self._writer = writer
        self._rollouts = rollouts

    async def ask(self, order: Order) -> Message | None:
        """Send a command, and return the gate's answer.

        The lease (the right to command) may have become stale, because the robot was held, the wire process was
        restarted, or another program commands the robot. This new command of the user then acquires the lease
        again. A disarmed or locked robot still refuses.
        """
        writer = self._writer
        async with writer.turn:
            refusal = await self._rollouts.refuse(order.verb)
            if refusal is not None:
                return refusal
            if writer.lease is not None:
                answer = await self._ask(order, writer.lease)
                if not _is_stale(answer):
                    return answer
            refusal = await writer.acquire()
            if refusal is not None or writer.lease is None:
                return refusal or refusals.no_lease(order.verb)
            return await self._ask(order, writer.lease)

    async def _ask(self, order: Order, lease: Lease) -> Message | None:
        try:
            return await self._processes.gate.ask(order.make(lease), order.within_s)
        except AskTimeout as timeout:
            return await self._processes.cancel_late_request(order.verb, timeout)
        except Unreachable as failure:
            return unreachable(order.verb, failure)

    def ask_here(self, order: Order) -> Message | None:
        """Send a command as ``ask`` does, but in the calling thread.

        None means that nothing was done, and that the loop must call ``ask``.
        """
        lease = self._writer.lease
        if lease is None or self._rollouts.running:
            return None
        try:
            answer = self._processes.gate.ask_here(order.make(lease), order.within_s)
        except AskTimeout as timeout:
            return portal().call(self._processes.cancel_late_request, order.verb, timeout)
        except Unreachable as failure:
            # This raises ``NotConnected`` if the robot was cleaned up meanwhile.
            self._processes.require()
            return unreachable(order.verb, failure)
        return None if _is_stale(answer) else answer


def _is_stale(answer: Message | None) -> bool:
    return isinstance(answer, Refused) and answer.code in STALE
