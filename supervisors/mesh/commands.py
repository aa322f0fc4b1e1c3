"""Receive JSON commands from the mesh, check them, and pass them to the gate. The gate then checks them as it
checks the commands of every writer.

Zenoh stores received commands in a ring buffer outside Python, which keeps the newest ones. This actor takes a
limited number of them each second. So even a flood of commands uses little time of the root process and delays no
stop, since stops arrive on other keys. The ring is polled ten times a second, and a hundred times a second for a
while after each command.

A robot that holds must be resumed before a sender on the mesh gets a lease. So nothing moves when an interrupted
link is connected again.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import msgspec
import trio

from strands_actors.contract.driver import Driver
from strands_actors.contract.wire import Observation
from strands_actors.kernel.actor import Actor
from strands_actors.kernel.channels.pubsub import PubSub, Received
from strands_actors.kernel.clock import NS
from strands_actors.kernel.health import busy
from strands_actors.kernel.messages import Message, Refused
from strands_actors.kernel.node import AskTimeout, Ref, Unreachable
from strands_actors.kernel.processes.guard import not_approved, unapproved
from strands_actors.supervisors import addresses
from strands_actors.supervisors.deadlines import StopDeadlines
from strands_actors.supervisors.gate import messages
from strands_actors.supervisors.gate.gate import Gate
from strands_actors.supervisors.root.messages import TaskStatus

from . import refusals
from . import schemas as mesh_json
from .answers import Answers, report_json
from .command_rules import Limit, Limits, Shared, read_command, read_envelope, refuse_stale
from .lease_rules import refuse_by_mode
from .motion import NO_OPERATOR, Motion, holder_of, no_answer, task_json
from .readings import TELEOP, features, state_of, task_of, tool_of
from .safety import UNNAMED, ResumeOrder, Safety, StopOrder
from .schemas import Command, Envelope, plain
from .stop_rules import MessageOutline, read_loosely

IDLE_S = 0.1
BUSY_S = 0.01
BUSY_FOR_S = 2.0
"""How long the ring is polled every ``BUSY_S`` after a command. The next command of a stream comes sooner."""
RING = 64
BATCH_SIZE = 16
"""Commands per poll. So a flood costs at most 1600 decoded commands a second."""

COMMANDS_PER_S = 20
"""Limit for each sender of queries. All senders that put share one limit, since their names prove
nothing."""
PUT_BY = ""
MOVES_PER_S = 100
"""Limit for the holder of the lease."""
REFUSALS_PER_S = 20
MESH = "the mesh"
ASK_S = 0.1


class Poll(Message, frozen=True):
    """A message of this actor to itself: take commands from the ring buffer."""

    lane = "latest"


class Commands(Actor):
    """Carry out the JSON commands for one robot.

    Args:
        robot: Name of the robot.
        driver: Driver of the robot.
        pubsub: The session on the mesh.
        answers: Sends the answers to the senders of commands.
        shared: State that the actors on the mesh share.
        task: Returns the status of the robot's policy process.
    """

    def __init__(
        self,
        robot: str,
        driver: Driver,
        pubsub: PubSub,
        answers: Answers,
        shared: Shared,
        task: Callable[[], TaskStatus],
    ) -> None:
        self._task = task
        self._stop_s = StopDeadlines.of(driver.timing.safe_s).gate_s
        self._robot = robot
        self._driver = driver
        self._query_key = mesh_json.command_key(robot, refusals.SENDER)
        self._ring = pubsub.poll(RING, mesh_json.key(robot, "cmd"), mesh_json.command_key(robot, "*"))
        self._answers = answers
        self._shared = shared
        self._action_name = "what is no command"
        self._commands = Limits(COMMANDS_PER_S, COMMANDS_PER_S)
        self._moves = Limit(MOVES_PER_S, MOVES_PER_S // 5)
        self._refusals = Limit(REFUSALS_PER_S, REFUSALS_PER_S)
        self._holder = ""  # sender that got the last lease over the mesh; ``_lease`` is that lease
        self._lease = messages.Lease(0, 0)
        self._busy_until_ns = 0

    async def started(self) -> None:
        actors = addresses.of(self._robot)
        self._gate: Ref = self.context.ref(actors.gate, Gate)
        self._safety: Ref = self.context.ref(actors.safety, Safety)
        self._motion = Motion(self._robot, self._driver, self.context, self._task, self._shared)
        self.context.start_soon(self._look)

    async def _look(self) -> None:
        while True:
            busy = self.context.clock.now_ns() < self._busy_until_ns
            await trio.sleep(BUSY_S if busy else IDLE_S)
            self.context.me.tell(Poll())

    async def receive(self, message: Poll) -> None:
        for _ in range(BATCH_SIZE):
            received = self._ring.take()
            if received is None:
                return
            self._shared.received += 1
            await self._serve(received)

    async def _serve(self, received: Received) -> None:
        now_ns = self.context.clock.now_ns()
        self._busy_until_ns = now_ns + round(BUSY_FOR_S * NS)
        outline = read_loosely(received.payload, self._robot)
        if outline.stops:
            self._stop(outline, received)
            return
        envelope = read_envelope(received.payload)
        if isinstance(envelope, tuple):
            sender, refused = envelope
            self._action_name = "what is no command"
            self._refuse(sender.sender_id if sender else "", self._turn(outline.turn, received), refused)
            return
        is_query = received.reply is not None
        if is_query:
            sender_name = mesh_json.proven(received.asker, envelope.proof)
            envelope = msgspec.structs.replace(
                envelope, sender_id=sender_name, turn_id=self._turn(envelope.turn_id, received)
            )
        command = read_command(envelope)
        if isinstance(command, Command):
            if is_query and not mesh_json.is_name(plain(envelope.sender_id)):
                command = refusals.unnamed_sender(self._query_key)
            elif not is_query and not isinstance(command, mesh_json.PUT):
                command = refusals.published_command(command.action, self._query_key).about(command.action)
            elif not outline.means(self._robot):
                command = refusals.other_robot(outline.target[:64], self._robot).about(command.action)
        self._action_name = type(command).__name__.lower() if isinstance(command, Command) else "what is no command"
        refused_now = (
            command if isinstance(command, Refused) else self._check(envelope.sender_id, command, is_query)
        )
        if refused_now is not None:
            self._refuse(envelope.sender_id, envelope.turn_id, refused_now)
        elif isinstance(command, Command):
            await self._obey(envelope, command)

    def _stop(self, outline: MessageOutline, received: Received) -> None:
        """Stop the robot. A stop is never refused, even if it is malformed or names another robot. A sender that
        uses this robot's own key means this robot, and an unnecessary stop does no harm."""
        asker = received.asker if received.reply is not None else outline.sender
        by = outline.by or (asker if mesh_json.is_name(asker) else UNNAMED)
        self._safety.tell(StopOrder(outline.locks, by, asker, self._turn(outline.turn, received)))

    def _turn(self, turn: str, received: Received) -> str:
        return turn if received.reply is None else self._answers.expect(turn, received.reply)

    def _check(self, sender: str, command: Command, is_query: bool) -> Refused | None:
        now_ns = self.context.clock.now_ns()
        holds = isinstance(command, mesh_json.Leased) and (sender, command.lease) == (self._holder, self._lease.id)
        if holds:
            too_soon = self._moves.refuse(now_ns)
        else:
            too_soon = self._commands.refuse(sender if is_query else PUT_BY, now_ns)
        if too_soon is not None:
            return too_soon
        if isinstance(command, mesh_json.Leased) and not holds:
            return refusals.no_lease(plain(sender))
        return refuse_stale(self._shared.clocks, sender, command, now_ns)

    def _refuse(self, sender: str, turn: str, refused: Refused) -> None:
        """Count a refusal and send it. The number of public answers is limited, so that they do not flood the mesh.
        A query is always answered, since only its sender gets the answer."""
        admitted = self._refusals.admits(self.context.clock.now_ns())
        if admitted:
            self._shared.audit(plain(sender) or "somebody", self._action_name, f"refused: {refused.text}", MESH)
        self._answers.refuse(sender if admitted else "", turn, refused)

    async def _obey(self, envelope: Envelope, command: Command) -> None:
        sender, turn = envelope.sender_id, envelope.turn_id
        match command:
            case mesh_json.Resume():
                self._safety.tell(ResumeOrder(command.by or plain(sender), sender, turn))
                return
            case mesh_json.Beat():
                self._gate.tell(messages.Beat(command.lease, command.answered_ago_s))
                self._answers.forget(turn)
                return
            case mesh_json.Motion():
                self._shared.audit(plain(sender), command.action, "taken up", MESH)
                self._begin(sender, turn, command)
                return
            case mesh_json.Release():
                # Releasing may make the robot hold, which takes time. The next commands must not wait for that.
                self.context.start_soon(self._tell, sender, turn, command)
                return
        await self._tell(sender, turn, command)

    async def _tell(self, sender: str, turn: str, command: Command) -> None:
        """Carry out a command and send the result to its sender."""
        try:
            answer = await self._answer(sender, command)
        except (AskTimeout, Unreachable) as failure:
            answer = busy.with_load(refusals.silent_wire(failure))
        if isinstance(answer, Refused):
            self._refuse(sender, turn, answer.about(command.action))
        else:
            self._answers.success(sender, turn, answer)

    async def _answer(self, sender: str, command: Command) -> dict[str, Any] | Refused:
        match command:
            case mesh_json.Sync():
                now_ns = self.context.clock.now_ns()
                return {"clock": self._shared.clocks.read(sender, now_ns), "robot_ns": now_ns}
            case mesh_json.Move():
                return await self._move(command)
            case mesh_json.Acquire():
                return await self._acquire(sender)
            case mesh_json.Release():
                answer = await self._gate.ask(messages.Release(command.lease), self._stop_s)
                if not isinstance(answer, messages.Released):
                    return no_answer(answer)
                return {"released": command.lease, **report_json(answer.report)}
            case mesh_json.Observe():
                return await self._observe()
            case mesh_json.Ping():
                return {"pong": True, "peer_id": self._robot, "t": time.time()}
            case mesh_json.Features():
                return features(self._driver)
            case mesh_json.DescribeTool():
                return tool_of(self._robot, self._driver)
            case mesh_json.TeleopStatus():
                return dict(TELEOP)
            case mesh_json.State():
                return state_of(self._robot, self._driver, self._task(), await self._newest())
        return await self._status()

    async def _newest(self) -> messages.Status | None:
        """Ask the gate for its status and return it; None if the gate refuses or sends another reply."""
        answer = await self._gate.ask(messages.GetStatus(), ASK_S)
        return answer if isinstance(answer, messages.Status) else None

    # -- motions, which continue after their command was answered

    def _begin(self, sender: str, turn: str, command: mesh_json.Motion) -> None:
        """Start a motion in a task, since it may take seconds."""
        if not self._shared.turns.is_new(sender, plain(turn)):
            refused = refusals.repeated_turn(plain(sender), plain(turn))
            self._refuse(sender, turn, refused.about(command.action))
            return

        def answer(result: dict[str, Any] | Refused, final: bool) -> None:
            if isinstance(result, Refused):
                self._refuse(sender, turn, result)
            else:
                self._answers.success(sender, turn, result, final)

        own = self._lease if sender == self._holder else None
        self.context.start_soon(self._motion.do, sender, own, command, answer)

    # -- commands that need a lease

    async def _acquire(self, sender: str) -> dict[str, Any] | Refused:
        await self._motion.wait_for_hold()
        status = await self._gate.ask(messages.GetStatus(), ASK_S)
        if not isinstance(status, messages.Status):
            return no_answer(status)
        refused = refuse_by_mode(status, self._shared.resumed_epoch)
        if refused is not None:
            return refused
        own = self._lease.id if sender == self._holder else 0
        again = self._motion.kept_for(sender) or own
        lease = await self._gate.ask(messages.Acquire(holder_of(sender), again=again), messages.GRANT_S)
        if not isinstance(lease, messages.Lease):
            return no_answer(lease)
        self._holder, self._lease = sender, lease
        self._motion.forget(sender)
        timing = self._driver.timing
        return {
            "lease": lease.id,
            "epoch": lease.epoch,
            "axes": list(self._driver.axes),
            "unit": self._driver.unit,
            "control_hz": timing.control_hz,
            "stream_ttl_s": timing.stream_ttl_s,
            "oneshot_ttl_s": timing.oneshot_ttl_s,
        }

    async def _move(self, move: mesh_json.Move) -> dict[str, Any] | Refused:
        if move.epoch != self._lease.epoch:
            # The gate checks the epoch, too. But every peer can read the present epoch in the telemetry. So on the
            # mesh, a command must have the epoch in which its lease was given.
            return refusals.stale_lease(self._lease.epoch, move.epoch)
        if names := unapproved(self._driver.GUARDED, self._driver.to_approve(move.targets), self._driver.TOPICS):
            return not_approved(names, NO_OPERATOR, can_ask=False)
        setpoint = messages.Setpoint(
            move.lease, move.epoch, move.deadline_ns, move.targets, move.period_s, move.latched
        )
        answer = await self._gate.ask(setpoint, ASK_S)
        if not isinstance(answer, messages.Accepted):
            return no_answer(answer)
        return self._driver.accepted(move.targets, answer.values, answer.sensors)

    # -- commands that only read the robot

    async def _observe(self) -> dict[str, Any] | Refused:
        answer = await self._gate.ask(messages.GetObservation(), ASK_S)
        if not isinstance(answer, Observation):
            return no_answer(answer)
        age_s = (self.context.clock.now_ns() - answer.t_ns) / NS
        return {
            "joints": self._driver.as_telemetry(answer),
            "unit": self._driver.unit,
            "age_s": age_s,
        }

    async def _status(self) -> dict[str, Any] | Refused:
        status = await self._gate.ask(messages.GetStatus(), ASK_S)
        if not isinstance(status, messages.Status):
            return no_answer(status)
        return {
            "state": status.mode,
            "epoch": status.epoch,
            "connected": status.connected,
            "connect_error": status.connect_error,
            "locked_by": status.locked_by,
            "cause": status.cause,
            "last_stop_cause": status.last_stop_cause,
            "lease": status.holder,
            "age_s": status.age_s,
            "refusals": status.refusals,
            "last_refusal": status.last_refusal,
            "task": task_json(task_of(self._task(), status)),
        }
