"""The gateway: the actor that connects callers on other hosts to the gate. These callers send the same messages as
local ones.

The gateway makes only the checks that are needed because the caller is on another host. The command must have a
deadline on the robot's clock and be in time, the lease must belong to the sender, and the sender must not send too
often. The gate makes all other checks. Zenoh's certificates decide which hosts can reach the gateway
(``mesh/access.py``).

Received frames wait in a ring buffer outside Python, as JSON commands do (``commands.py``). A stop has a separate
key and is handled at once.
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
from strands_actors.kernel.channels.zenoh_mesh import request_key
from strands_actors.kernel.clock import NS
from strands_actors.kernel.health import busy
from strands_actors.kernel.messages import Message, Refused
from strands_actors.kernel.node import PREFIX, AskTimeout, Ref, Unreachable
from strands_actors.kernel.processes.guard import not_approved, unapproved
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

from . import refusals
from .command_rules import Limits, Shared
from .gateway_messages import Datable, Dated, Sync, Synced
from .lease_rules import refuse_by_mode

IDLE_S = 0.05
BUSY_S = 0.004
BUSY_FOR_S = 2.0
"""How long the ring is polled every ``BUSY_S`` after a frame. The next frame of a writer comes sooner."""
RING = 64
BATCH_SIZE = 16
"""Largest number of frames per poll. So at most 4000 frames a second are decoded."""

WRITES_PER_S = 1100
"""Limit for the holder of a lease: a stream at the highest rate of a rollout, and its heartbeats."""
COMMANDS_PER_S = 50
"""Limit for each caller, like ``READINGS_PER_S``. If one caller sends too much, the resume of another caller is
still accepted."""
READINGS_PER_S = 500
ASK_S = 0.3
TREE_S = 0.5


class FromOutside:
    """The channel on which frames of other hosts reach the root process. The root sends only answers back on it."""

    def __init__(self, node: Router, pubsub: PubSub, robot: str) -> None:
        actors = addresses.of(robot)
        self.channel: Channel | None = channels.of_stops_elsewhere(robot)
        self._node = node
        self._pubsub = pubsub
        self._ring = pubsub.poll(RING, questions=request_key(actors.gateway, "*"))
        self._robot = robot
        pubsub.subscribe(actors.gateway_stop, self._on_stop)
        for address in (actors.gateway, actors.gateway_stop):
            pubsub.declare_token(f"{address}/alive")

    def take(self) -> int:
        """Pass the received frames that wait in the ring buffer to the actors of this process. Return their
        number."""
        with self._node.dispatch:
            for count in range(BATCH_SIZE):
                received = self._ring.take()
                if received is None:
                    return count
                channel = channels.of_elsewhere(self._robot, received.asker)
                self._node.receive_frame(received.payload, _Question(channel, received.reply))
        return BATCH_SIZE

    def _on_stop(self, received: Received) -> None:
        with self._node.dispatch:
            self._node.receive_frame(received.payload, self)

    def send(self, to: str, data: bytes, descriptors: tuple[int, ...] = (), urgent: bool = False) -> bool:
        return to.startswith(f"{PREFIX}/node/") and self._pubsub.put_frame(to, data)

    def send_at_once(self, data: bytes) -> bool:
        return False

    def announce(self, address: str, hosted: bool) -> None:
        """Tell other hosts nothing about the actor at ``address``. They need no addresses, since they use two
        fixed keys."""


class _Question:
    """The channel of one query from another host. Only the sender of the query gets the answer."""

    def __init__(self, channel: Channel, reply: Reply) -> None:
        self.channel: Channel | None = channel
        self._reply = reply

    def send(self, to: str, data: bytes, descriptors: tuple[int, ...] = (), urgent: bool = False) -> bool:
        return self._reply(data)

    def send_at_once(self, data: bytes) -> bool:
        return False

    def announce(self, address: str, hosted: bool) -> None:
        """Tell the other host nothing about the actor at ``address``, since this channel is used for one query
        only."""


class Gateway(Actor):
    """Pass requests and commands of callers on other hosts to the gate, and the answers back.

    Args:
        robot: Name of the robot.
        robot_type: Type of the robot, such as ``so101``.
        driver: Driver of the robot.
        pubsub: The session on the mesh.
        shared: State that the actors on the mesh share.
    """

    def __init__(self, robot: str, robot_type: str, driver: Driver, pubsub: PubSub, shared: Shared) -> None:
        self._robot = robot
        self._robot_type = robot_type
        self._driver = driver
        self._pubsub = pubsub
        self._shared = shared
        self._writes = Limits(WRITES_PER_S, WRITES_PER_S // 10)
        self._commands = Limits(COMMANDS_PER_S, COMMANDS_PER_S)
        self._readings = Limits(READINGS_PER_S, READINGS_PER_S // 5)
        self._busy_until_ns = 0

    async def started(self) -> None:
        actors, context = addresses.of(self._robot), self.context
        self._gate: Ref = context.ref(actors.gate, Gate)
        self._root: Ref = context.ref(actors.root)
        self._channel = FromOutside(context.node, self._pubsub, self._robot)
        context.start_soon(self._look)

    async def _look(self) -> None:
        while True:
            now_ns = self.context.clock.now_ns()
            await trio.sleep(BUSY_S if now_ns < self._busy_until_ns else IDLE_S)
            if self._channel.take():
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
        self._shared.received += 1
        if isinstance(message, Dated):
            refused = self._refuse(message, now_ns)
            if refused is not None:
                message_type = type(message.message).__name__.lower()
                self._shared.audit(message.channel, message_type, f"refused: {refused.text}", "another host")
            return refused or self._obey(message)
        refusal = self._readings.refuse(message.channel, now_ns)
        if refusal is not None:
            return refusal
        match message:
            case Sync():
                session = self._shared.sessions.sync(message.session, message.channel, now_ns)
                return Synced(session, self.context.clock.now_ns(), self._robot_type, tuple(self._driver.axes))
            case Describe():
                return self._soon(lambda: self._root.ask(message, TREE_S))
        return self._soon(lambda: self._gate.ask(message, ASK_S))

    # -- checks that are needed because the caller is on another host

    def _refuse(self, dated: Dated, now_ns: int) -> Refused | None:
        message, sessions = dated.message, self._shared.sessions
        if isinstance(message, Acquire | Resume) and not self.context.expects_answer:
            # Without a reply, the caller would not learn its lease, and no other caller could get one for a second.
            verb = type(message).__name__.lower()
            return refusals.no_reply_requested().about(verb)
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
        """Return a refusal for a motion or service that needs a person's approval. It cannot be approved, since the
        caller is on another host."""
        verb, service = (message.service, (message.service,)) if isinstance(message, Perform) else ("move", ())
        first = message.first if isinstance(message, Perform) else message
        action = first.action if isinstance(first, Setpoint) else {}
        names_to_approve = (*service, *self._driver.to_approve(action))
        names = unapproved(self._driver.GUARDED, names_to_approve, self._driver.TOPICS)
        if not names:
            return None
        return not_approved(names, "a caller on another host cannot be asked", can_ask=False).about(verb)

    def _obey(self, dated: Dated) -> Deferred | None:
        message = dated.message
        if not self.context.expects_answer:
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

    async def _acquire(self, session: str, client: str, message: Acquire) -> Message | None:
        """Acquire a lease for a caller. A rollout must name a lease that was acquired over this gateway."""
        status = await self._gate.ask(GetStatus(), ASK_S)
        if not isinstance(status, Status):
            return status
        refusal = None if message.over else refuse_by_mode(status, self._shared.resumed_epoch)
        if refusal is not None:
            return refusal.about(ACQUIRE)
        # A caller may replace only a lease that it acquired in this session.
        again = 0 if self._shared.sessions.refuse_lease(session, message.again) else message.again
        holder = f"{message.holder} ({client})"
        elsewhere = msgspec.structs.replace(message, holder=holder, pid=0, again=again)
        lease = await self._gate.ask(elsewhere, GRANT_S)
        if isinstance(lease, Lease):
            self._shared.sessions.grant(session, lease.id)
        return lease

    async def _release(self, message: Release) -> Message | None:
        """Release a lease. If the robot holds because of this, note that this hold needs no resume.

        A rollout ends with an intended hold, so the next caller can get a lease without a resume. This is only so
        if the release caused the hold. If the lease had already ended, or the robot already held, a resume is
        needed.
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
                deferred.send(busy.with_load(refusals.silent_wire_elsewhere(failure)))

        self.context.start_soon(run)
        return deferred


class GatewayStop(Actor):
    """Stop the robot for every caller on another host. It needs no lease, and the number of stops is not
    limited."""

    def __init__(self, robot: str, deadlines: StopDeadlines) -> None:
        self._actors = addresses.of(robot)
        self._deadlines = deadlines

    async def started(self) -> None:
        self._gate: Ref = self.context.ref(self._actors.gate, Gate)
        self._guardian: Ref = self.context.ref(self._actors.guardian, Guardian)

    def receive(self, message: Stop) -> StopReport | Refused | Deferred:
        deferred = self.context.defer()
        self.context.start_soon(self._stop, message, deferred)
        return deferred

    async def _stop(self, message: Stop, deferred: Deferred) -> None:
        deferred.send(await make_safe(self._gate, self._guardian, message.as_ordered(), self._deadlines))


__all__ = ["Datable", "FromOutside", "Gateway", "GatewayStop"]
