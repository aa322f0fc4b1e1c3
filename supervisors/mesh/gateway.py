"""The gateway connects callers on other hosts to the gate. These callers send the same messages as local
ones.

The gateway makes only the checks that distance requires: the command has a deadline on the robot's clock
and is in time, its lease belongs to its sender, and the sender is within its rate. The gate decides on
everything else, as for every other writer. The certificate decides, below the interpreter, which peers
reach the gateway (``mesh/access.py``).

Frames wait in a ring below the interpreter, as JSON commands do (``commands.py``). A stop has a separate
key and waits for nothing.
"""

from __future__ import annotations

from collections.abc import Awaitable, Callable

import msgspec
import trio

from strands_actors.contract.driver import Driver, Reason
from strands_actors.contract.wire import Observation
from strands_actors.kernel.actor import Actor, Deferred
from strands_actors.kernel.channels.permissions import Channel
from strands_actors.kernel.channels.pubsub import PubSub, Received, Reply
from strands_actors.kernel.channels.zenoh_mesh import asked_key
from strands_actors.kernel.clock import NS
from strands_actors.kernel.health import busy
from strands_actors.kernel.messages import Message, Refused
from strands_actors.kernel.node import PREFIX, AskTimeout, Ref, Unreachable
from strands_actors.kernel.processes.guard import not_approved, unapproved
from strands_actors.kernel.refusals import Code
from strands_actors.kernel.router import Router
from strands_actors.supervisors import addresses
from strands_actors.supervisors import permissions as channels
from strands_actors.supervisors.deadlines import StopDeadlines
from strands_actors.supervisors.gate.gate import Gate
from strands_actors.supervisors.gate.messages import (
    ACQUIRE,
    GRANT_S,
    Accepted,
    Acquire,
    Beat,
    GetObservation,
    GetSafety,
    GetStatus,
    Lease,
    Perform,
    Performed,
    Release,
    Released,
    Resume,
    Resumed,
    Setpoint,
    Status,
    Stop,
    StopReport,
)
from strands_actors.supervisors.root.guardian import Guardian
from strands_actors.supervisors.root.messages import Describe, TreeReport
from strands_actors.supervisors.root.stopping import make_safe

from .command_rules import Limits, Shared
from .gateway_messages import Datable, Dated, Sync, Synced
from .lease_rules import refuse_by_mode

IDLE_S = 0.05
BUSY_S = 0.004
BUSY_FOR_S = 2.0
"""How long the ring is polled every ``BUSY_S`` after a frame. The next frame of a writer comes sooner."""
RING = 64
TAKEN_AT_ONCE = 16
"""Frames per poll. So a flood costs at most 4000 decoded frames a second."""

WRITES_PER_S = 1100
"""Limit for the holder of a lease: a stream at the highest rate of a rollout, and its heartbeats."""
COMMANDS_PER_S = 50
"""Limit for each caller, like ``READINGS_PER_S``, so that a flood from one does not get another's resume
refused."""
READINGS_PER_S = 500
ASK_S = 0.3
TREE_S = 0.5


class FromOutside:
    """The channel of frames from other hosts into the root's node. Only answers go back; the node sends
    no other messages to these hosts."""

    def __init__(self, node: Router, pubsub: PubSub, robot: str) -> None:
        at = addresses.of(robot)
        self.channel: Channel | None = channels.of_stops_elsewhere(robot)
        self._node = node
        self._pubsub = pubsub
        self._ring = pubsub.poll(RING, questions=asked_key(at.gateway, "*"))
        self._robot = robot
        pubsub.subscribe(at.gateway_stop, self._on_stop)
        for address in (at.gateway, at.gateway_stop):
            pubsub.declare_token(f"{address}/alive")

    def take(self) -> int:
        """Pass waiting frames to the node, and return how many."""
        with self._node.dispatch:
            for count in range(TAKEN_AT_ONCE):
                received = self._ring.take()
                if received is None:
                    return count
                channel = channels.of_elsewhere(self._robot, received.asker)
                self._node.receive_frame(received.payload, _Question(channel, received.reply))
        return TAKEN_AT_ONCE

    def _on_stop(self, received: Received) -> None:
        with self._node.dispatch:
            self._node.receive_frame(received.payload, self)

    def send(self, to: str, data: bytes, descriptors: tuple[int, ...] = (), urgent: bool = False) -> bool:
        return to.startswith(f"{PREFIX}/node/") and self._pubsub.put_frame(to, data)

    def send_at_once(self, data: bytes) -> bool:
        return False

    def announce(self, address: str, hosted: bool) -> None:
        """Do nothing, since the two keys are fixed."""


class _Question:
    """The channel of one query. Its answer goes to its sender only."""

    def __init__(self, channel: Channel, reply: Reply) -> None:
        self.channel: Channel | None = channel
        self._reply = reply

    def send(self, to: str, data: bytes, descriptors: tuple[int, ...] = (), urgent: bool = False) -> bool:
        return self._reply(data)

    def send_at_once(self, data: bytes) -> bool:
        return False

    def announce(self, address: str, hosted: bool) -> None:
        """Do nothing, since the channel carries one frame."""


class Gateway(Actor):
    """Pass readings and commands of callers on other hosts to the gate, and the answers back.

    Args:
        robot: The name of the robot.
        kind: The kind of the robot.
        driver: Its driver.
        pubsub: The session on the mesh.
        shared: State that the actors on the mesh share.
    """

    def __init__(self, robot: str, kind: str, driver: Driver, pubsub: PubSub, shared: Shared) -> None:
        self._robot = robot
        self._kind = kind
        self._driver = driver
        self._pubsub = pubsub
        self._shared = shared
        self._writes = Limits(WRITES_PER_S, WRITES_PER_S // 10)
        self._commands = Limits(COMMANDS_PER_S, COMMANDS_PER_S)
        self._readings = Limits(READINGS_PER_S, READINGS_PER_S // 5)
        self._busy_until_ns = 0

    async def started(self) -> None:
        at, context = addresses.of(self._robot), self.context
        self._gate: Ref = context.ref(at.gate, Gate)
        self._root: Ref = context.ref(at.root)
        self._way = FromOutside(context.node, self._pubsub, self._robot)
        context.start_soon(self._look)

    async def _look(self) -> None:
        while True:
            now_ns = self.context.clock.now_ns()
            await trio.sleep(BUSY_S if now_ns < self._busy_until_ns else IDLE_S)
            if self._way.take():
                self._busy_until_ns = now_ns + round(BUSY_FOR_S * NS)

    def receive(
        self, message: Sync | Dated | GetObservation | GetSafety | GetStatus | Describe
    ) -> (
        Synced
        | Accepted
        | Lease
        | Resumed
        | Released
        | StopReport
        | Observation
        | Status
        | Performed
        | TreeReport
        | Refused
        | Deferred
        | None
    ):
        now_ns = self.context.received_ns
        self._shared.taken += 1
        if isinstance(message, Dated):
            refused = self._refuse(message, now_ns)
            if refused is not None:
                what = type(message.message).__name__.lower()
                self._shared.audit(message.channel, what, f"refused: {refused.text}", "another host")
            return refused or self._obey(message)
        refusal = self._readings.refuse(message.channel, now_ns)
        if refusal is not None:
            return refusal
        match message:
            case Sync():
                session = self._shared.sessions.sync(message.session, message.channel, now_ns)
                return Synced(session, self.context.clock.now_ns(), self._kind, tuple(self._driver.axes))
            case Describe():
                return self._soon(lambda: self._root.ask(message, TREE_S))
        return self._soon(lambda: self._gate.ask(message, ASK_S))

    # -- checks that distance requires

    def _refuse(self, dated: Dated, now_ns: int) -> Refused | None:
        message, sessions = dated.message, self._shared.sessions
        if isinstance(message, Acquire | Resume) and not self.context.asked:
            # Without an answer, no caller would learn of the lease, and it would exclude all others for a
            # second.
            verb = type(message).__name__.lower()
            return Refused(Code.TOLD, "it was told, and nobody waits for the answer", "ask it", verb=verb)
        refusal = sessions.refuse(dated.session, dated.channel, dated.deadline_ns, now_ns)
        if refusal is not None:
            return refusal
        if isinstance(message, Setpoint | Beat | Release | Perform):
            refusal = sessions.refuse_lease(dated.session, message.lease)
            return refusal or (self._writes.refuse(dated.channel, now_ns) or self._refuse_guarded(message))
        if isinstance(message, Acquire) and message.over:
            refusal = sessions.refuse_lease(dated.session, message.over)
        return refusal or self._commands.refuse(dated.channel, now_ns)

    def _refuse_guarded(self, message: Message) -> Refused | None:
        """Return a refusal for a motion or service that needs an approval and has none. For a caller on
        another host there is no operator here to ask."""
        verb, service = (message.service, (message.service,)) if isinstance(message, Perform) else ("move", ())
        first = message.first if isinstance(message, Perform) else message
        action = first.action if isinstance(first, Setpoint) else {}
        asked = (*service, *self._driver.to_approve(action))
        names = unapproved(self._driver.GUARDED, asked, self._driver.TOPICS)
        if not names:
            return None
        return not_approved(names, "from another host there is nobody to ask", can_ask=False).about(verb)

    def _obey(self, dated: Dated) -> Deferred | None:
        message = dated.message
        if not self.context.asked:
            self._gate.tell(message)
            return None
        match message:
            case Acquire():
                return self._soon(lambda: self._acquire(dated.session, dated.channel, message))
            case Release():
                return self._soon(lambda: self._release(message))
            case Resume():
                return self._soon(lambda: self._resume(message))
            case Perform():
                service = self._driver.SERVICES.get(message.service)
                within_s = ASK_S if service is None else service.within_s + ASK_S
                return self._soon(lambda: self._gate.ask(message, within_s))
        return self._soon(lambda: self._gate.ask(message, ASK_S))

    async def _acquire(self, session: str, who: str, message: Acquire) -> Message | None:
        """Acquire a lease for a caller. A rollout writes under a lease that its caller acquired here."""
        status = await self._gate.ask(GetStatus(), ASK_S)
        if not isinstance(status, Status):
            return status
        refusal = None if message.over else refuse_by_mode(status, self._shared.resumed_epoch)
        if refusal is not None:
            return refusal.about(ACQUIRE)
        # A lease that was not acquired in this session gives no right to replace it.
        again = 0 if self._shared.sessions.refuse_lease(session, message.again) else message.again
        holder = f"{message.holder} ({who})"
        elsewhere = msgspec.structs.replace(message, holder=holder, pid=0, again=again)
        lease = await self._gate.ask(elsewhere, GRANT_S)
        if isinstance(lease, Lease):
            self._shared.sessions.grant(session, lease.id)
        return lease

    async def _release(self, message: Release) -> Message | None:
        """Release a lease, and note a hold that needs no resume.

        A rollout ends with a hold that its writer intends, so the next lease needs no resume. This counts
        only if the release caused the hold, and not if the lease had lapsed or the robot held already.
        """
        answer = await self._gate.ask(message, ASK_S)
        if isinstance(answer, Released) and answer.holds and answer.report.reason is Reason.POLICY:
            self._shared.resumed_epoch = answer.report.epoch
        return answer

    async def _resume(self, message: Resume) -> Message | None:
        answer = await self._gate.ask(message, self._driver.timing.arm_s + 2.0)
        if isinstance(answer, Resumed):
            self._shared.resumed_epoch = answer.epoch
        return answer

    def _soon(self, ask: Callable[[], Awaitable[Message | None]]) -> Deferred:
        deferred = self.context.defer()

        async def run() -> None:
            try:
                deferred.send(await ask())
            except (AskTimeout, Unreachable) as failure:
                why = busy.explained(f"the wire does not answer: {failure}")
                deferred.send(Refused(Code.UNREACHABLE, why, "resume it"))

        self.context.start_soon(run)
        return deferred


class GatewayStop(Actor):
    """Stop the robot for every caller that reaches the gateway, with or without a lease, and without a
    limit of the rate."""

    def __init__(self, robot: str, deadlines: StopDeadlines) -> None:
        self._at = addresses.of(robot)
        self._deadlines = deadlines

    async def started(self) -> None:
        self._gate: Ref = self.context.ref(self._at.gate, Gate)
        self._guardian: Ref = self.context.ref(self._at.guardian, Guardian)

    def receive(self, message: Stop) -> StopReport | Refused | Deferred:
        deferred = self.context.defer()
        self.context.start_soon(self._stop, message, deferred)
        return deferred

    async def _stop(self, message: Stop, deferred: Deferred) -> None:
        deferred.send(await make_safe(self._gate, self._guardian, message.as_ordered(), self._deadlines))


__all__ = ["Datable", "FromOutside", "Gateway", "GatewayStop"]
