"""Send messages to the gate (the actor that checks commands) of a robot on another host. Each command gets a
deadline on the robot's clock."""

from __future__ import annotations

from typing import Any

import msgspec

from strands_actors.kernel.clock import NS
from strands_actors.kernel.messages import Message, Refused
from strands_actors.kernel.node import Node
from strands_actors.kernel.refusals import Code
from strands_actors.supervisors import addresses
from strands_actors.supervisors.gate.messages import Beat, Perform, Setpoint, Stop
from strands_actors.supervisors.mesh.gateway import Gateway, GatewayStop
from strands_actors.supervisors.mesh.gateway_messages import Datable, Dated, Sync, Synced

from . import refusals
from .robot_clock import RobotClock

COMMAND_S = 1.0
"""A command that has not reached the robot within this time is not carried out."""
BEAT_S = 0.5
"""A heartbeat that takes longer to arrive does not keep the lease."""


class GatewayRef:
    """A reference to the gate of a robot (the actor that checks commands). A robot that has restarted does not
    know the session from before, and refuses its commands. Then the clock is read again, and the command is
    sent once more."""

    def __init__(self, node: Node, robot: str, sender: str) -> None:
        actors = addresses.of(robot)
        self.address = actors.gateway
        self.clock = RobotClock()
        """The robot's last answer to ``Sync``."""
        self._now_ns = node.clock.now_ns
        self._gateway = node.ref(actors.gateway, Gateway, sender)
        self._stop = node.ref(actors.gateway_stop, GatewayStop, sender)
        self._session = ""

    # -- the robot's clock

    async def sync(self, deadline_s: float) -> Message | None:
        """Read the robot's clock. Raise the same exceptions as ``ask``."""
        requested_ns = self._now_ns()
        return self._synced(await self._gateway.ask(Sync(self._session), deadline_s), requested_ns)

    def _sync_here(self, deadline_s: float) -> Message | None:
        requested_ns = self._now_ns()
        return self._synced(self._gateway.ask_here(Sync(self._session), deadline_s), requested_ns)

    def _synced(self, answer: Message | None, requested_ns: int) -> Message | None:
        if isinstance(answer, Synced):
            if answer.session != self._session:
                self.clock.forget()
            self._session = answer.session
            self.clock.read(answer.robot_ns, requested_ns, self._now_ns())
        return answer

    # -- the methods of a Ref

    def tell(self, message: Message) -> None:
        outgoing = self._outgoing(message)
        if not isinstance(outgoing, Refused):
            self._gateway.tell(outgoing)

    async def ask(self, message: Message, deadline_s: float) -> Message | None:
        if isinstance(message, Stop):
            return await self._stop.ask(message, deadline_s)
        answer = await self._ask(message, deadline_s)
        if _wants_reading(answer):
            await self.sync(deadline_s)
            answer = await self._ask(message, deadline_s)
        return answer

    async def _ask(self, message: Message, deadline_s: float) -> Message | None:
        outgoing = self._outgoing(message)
        return outgoing if isinstance(outgoing, Refused) else await self._gateway.ask(outgoing, deadline_s)

    def ask_here(self, message: Message, deadline_s: float) -> Message | None:
        if isinstance(message, Stop):
            return self._stop.ask_here(message, deadline_s)
        answer = self._ask_here(message, deadline_s)
        if _wants_reading(answer):
            self._sync_here(deadline_s)
            answer = self._ask_here(message, deadline_s)
        return answer

    def _ask_here(self, message: Message, deadline_s: float) -> Message | None:
        outgoing = self._outgoing(message)
        return outgoing if isinstance(outgoing, Refused) else self._gateway.ask_here(outgoing, deadline_s)

    def _outgoing(self, message: Message) -> Message:
        """Return the message with its times converted to the robot's clock. Return a refusal if the robot's
        clock is not known."""
        if not isinstance(message, Datable):
            return message
        now_ns = self._now_ns()
        lifetime_s = BEAT_S if isinstance(message, Beat) else COMMAND_S
        deadline_ns = message.deadline_ns if isinstance(message, Setpoint) else now_ns + round(lifetime_s * NS)
        theirs_ns = self.clock.deadline(deadline_ns, now_ns)
        if theirs_ns is None:
            return refusals.clock_not_known()
        changed: dict[str, Any] = {}
        if isinstance(message, Setpoint):
            changed = {"deadline_ns": theirs_ns}
        elif isinstance(message, Perform) and message.first is not None:
            first_ns = theirs_ns + message.first.deadline_ns - deadline_ns
            changed = {"first": msgspec.structs.replace(message.first, deadline_ns=first_ns)}
        return Dated(self._session, theirs_ns, msgspec.structs.replace(message, **changed) if changed else message)


def _wants_reading(answer: Message | None) -> bool:
    return isinstance(answer, Refused) and answer.code == Code.CLOCK
