"""Carry out stop, e-stop and resume from the mesh, and publish the robot's state as events.

Every message on ``strands/safety/estop`` is an e-stop, even if it cannot be decoded. The access rules of the mesh
decide which peers may publish there. Each order leads to one stop, up to ``STOPS_PER_S`` stops a second. If more
orders come, one stop serves several of them. So a flood of orders cannot queue up and delay a resume.

The stop for an e-stop is sent from the zenoh thread that receives the order, so it does not wait for the event loop
of this process. The loop then waits for the result. It also sends the stops that the thread could not send.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import msgspec
import trio

from strands_actors.contract.driver import Driver, Reason
from strands_actors.kernel.actor import Actor
from strands_actors.kernel.answers import read_answer
from strands_actors.kernel.channels.pubsub import PubSub, Received
from strands_actors.kernel.health import busy
from strands_actors.kernel.messages import Message, Refused
from strands_actors.kernel.node import AskTimeout, Ref, Sent, Unreachable
from strands_actors.supervisors import addresses
from strands_actors.supervisors.deadlines import StopDeadlines
from strands_actors.supervisors.gate.gate import Gate
from strands_actors.supervisors.gate.messages import RESUME, Resume, Resumed, Stop
from strands_actors.supervisors.root.guardian import Guardian
from strands_actors.supervisors.root.messages import StateIs
from strands_actors.supervisors.root.stopping import make_safe

from . import refusals
from .answers import Answers, report_json
from .command_rules import Limit, Shared, read_command, read_envelope, read_sender
from .schemas import (
    BROADCAST_KEY,
    ESTOP_ANSWER_S,
    ESTOP_KEY,
    MAX_SAFETY_BYTES,
    MAX_TEXT,
    RESUME_KEY,
    SafetyOrder,
    command_key,
    is_name,
)
from .stop_rules import STOPS, read_loosely

STOPS_PER_S = 20
INTERIM_S = ESTOP_ANSWER_S - 0.07
"""After this time without a result, the sender gets an interim answer that the robot has not confirmed
yet. The final answer follows."""

UNNAMED = "an unnamed sender on the mesh"
MAX_TIME_S = 4e9
"""The latest time stamp that is passed on, in seconds: the year 2096."""
_WAITING = 64
_decode_order = msgspec.json.Decoder(SafetyOrder).decode


class Arrived(Message, frozen=True):
    """A message on one of the safety keys that has not been decoded yet."""

    lane = "urgent"

    key: str
    payload: bytes
    sent: Any = None  # the request to the gate (``Sent``), if zenoh's thread has sent it already; else None


class StopOrder(Message, frozen=True):
    """An order to stop the robot. ``sender`` and ``turn`` are empty if no sender can be answered. ``sent_s`` is the
    sender's wall-clock time; 0 if it is not known."""

    lane = "urgent"

    lock: bool
    by: str
    sender: str = ""
    turn: str = ""
    sent: Any = None  # the request to the gate (``Sent``), if zenoh's thread has sent it already; else None
    sent_s: float = 0.0


class ResumeOrder(Message, frozen=True):
    """An order to resume the robot. Its deadline has been checked."""

    lane = "urgent"

    by: str
    sender: str
    turn: str


class Safety(Actor):
    """Stop the robot for every peer on the mesh, and resume it for operators."""

    def __init__(self, robot: str, driver: Driver, pubsub: PubSub, answers: Answers, shared: Shared) -> None:
        self._robot = robot
        self._arm_s = driver.timing.arm_s + 2.0
        self._deadlines = StopDeadlines.of(driver.timing.safe_s, driver.late_s)
        self._pubsub = pubsub
        self._answers = answers
        self._shared = shared
        self._limit = Limit(STOPS_PER_S, STOPS_PER_S)
        self._refusals = Limit(STOPS_PER_S, STOPS_PER_S)
        self._waiting: list[StopOrder] = []
        self._later_is_due = False
        self._resuming = False

    async def started(self) -> None:
        actors = addresses.of(self._robot)
        self._gate: Ref = self.context.ref(actors.gate, Gate)
        self._guardian: Ref = self.context.ref(actors.guardian, Guardian)
        me, turn = self.context.me, self.context.node.dispatch

        def arrived(received: Received) -> None:
            # Handle the message now, so that the stop need not wait until the event loop is free.
            with turn:
                me.tell(Arrived(received.key, received.payload, received.done))

        self._pubsub.subscribe(ESTOP_KEY, arrived, at_once=self._estop_at_once)
        for key in (BROADCAST_KEY, RESUME_KEY):
            self._pubsub.subscribe(key, arrived)

    def receive(self, message: Arrived | StopOrder | ResumeOrder | StateIs) -> None:
        match message:
            case Arrived(key=key, payload=payload, sent=sent):
                if key == ESTOP_KEY:
                    self._on_estop(payload, sent)
                elif key == BROADCAST_KEY:
                    self._on_broadcast(payload)
                else:
                    self._on_resume(payload)
            case StopOrder():
                self._stop(message)
            case ResumeOrder():
                self._resume(message)
            case StateIs():
                self._answers.event(
                    "state",
                    state=message.mode,
                    epoch=message.epoch,
                    locked_by=message.locked_by,
                    cause=message.cause,
                )

    # -- orders from the mesh

    def _estop_at_once(self, received: Received) -> Sent | None:
        """Send the stop from zenoh's thread. Two threads count the limit without a lock, so one more stop than
        ``STOPS_PER_S`` may be sent."""
        order = _order(received.payload)
        if not self._is_for_this_robot(order) or not self._limit.admits(self.context.clock.now_ns()):
            return None
        return self._gate.ask_at_once(Stop(Reason.ESTOP, _by(order), True))

    def _is_for_this_robot(self, order: SafetyOrder) -> bool:
        return order.target_id in ("", "*", self._robot)

    def _on_estop(self, payload: bytes, sent: Sent | None) -> None:
        order = _order(payload)
        if not self._is_for_this_robot(order):
            return
        self._stop(StopOrder(True, _by(order), *_sender_and_turn(order), sent, _seconds(order.timestamp)))

    def _on_broadcast(self, payload: bytes) -> None:
        outline = read_loosely(payload, self._robot)
        if not outline.means(self._robot):
            return
        if outline.stops:
            self._stop(
                StopOrder(outline.locks, outline.by or outline.sender or UNNAMED, outline.sender, outline.turn)
            )
            return
        envelope = read_envelope(payload, MAX_SAFETY_BYTES)
        if isinstance(envelope, tuple):
            sender, refused = envelope
            self._refuse(sender.sender_id if sender else "", sender.turn_id if sender else "", refused)
            return
        command = read_command(envelope, tuple(STOPS))
        if isinstance(command, Refused):
            self._refuse(envelope.sender_id, envelope.turn_id, command)

    def _on_resume(self, payload: bytes) -> None:
        order = _order(payload)
        if self._is_for_this_robot(order):
            refused = refusals.published_resume(command_key(self._robot, refusals.SENDER))
            self._refuse(*_sender_and_turn(order), refused.about(RESUME))

    def _refuse(self, sender: str, turn: str, refused: Refused) -> None:
        admitted = self._refusals.admits(self.context.clock.now_ns())
        if admitted:
            self._shared.audit(sender or "somebody", "stop or resume", f"refused: {refused.text}", "the mesh")
        self._answers.refuse(sender if admitted else "", turn, refused)

    # -- orders to stop the robot

    def _stop(self, order: StopOrder) -> None:
        if order.sent is not None:
            self.context.start_soon(self._make_safe, [order])
            return
        # If the list of waiting orders is full, add only an e-stop, and only if no other e-stop waits.
        if len(self._waiting) < _WAITING or (order.lock and not any(waiting.lock for waiting in self._waiting)):
            self._waiting.append(order)
        if self._later_is_due:
            return
        if self._limit.admits(self.context.clock.now_ns()):
            self._stop_for_all()
        else:
            self._later_is_due = True
            self.context.start_soon(self._stop_later)

    async def _stop_later(self) -> None:
        await trio.sleep(1.0 / STOPS_PER_S)
        self._later_is_due = False
        self._stop_for_all()

    def _stop_for_all(self) -> None:
        orders, self._waiting = self._waiting, []
        self.context.start_soon(self._make_safe, orders)

    async def _make_safe(self, orders: Sequence[StopOrder]) -> None:
        first = next((order for order in orders if order.lock), orders[0])
        reason = Reason.ESTOP if first.lock else Reason.STOP
        async with trio.open_nursery() as nursery:
            nursery.start_soon(self._tell_interim, orders)
            stop = Stop(reason, first.by, first.lock)
            report = await make_safe(self._gate, self._guardian, stop, self._deadlines, first.sent)
            nursery.cancel_scope.cancel()
        result = _unconfirmed(report.text) if isinstance(report, Refused) else report_json(report)
        turns = {"sender": first.sender, "turn": first.turn, "sent_s": first.sent_s}
        self._answers.event(str(reason), by=first.by, **turns, **result)
        self._tell(orders, result, final=True)

    async def _tell_interim(self, orders: Sequence[StopOrder]) -> None:
        await trio.sleep(INTERIM_S)
        within_s = self._deadlines.gate_s + self._deadlines.root_s
        self._tell(orders, {**_unconfirmed("not confirmed yet"), "within_s": within_s}, final=False)

    def _tell(self, orders: Sequence[StopOrder], result: dict[str, Any], final: bool) -> None:
        for order in orders:
            if order.sender:
                self._answers.success(order.sender, order.turn, {**result, "locked": order.lock}, final)

    # -- orders to resume the robot

    def _resume(self, order: ResumeOrder) -> None:
        if self._resuming:
            self._refuse(order.sender, order.turn, refusals.resume_under_way().about(RESUME))
            return
        self._resuming = True
        self.context.start_soon(self._ask_resume, order)

    async def _ask_resume(self, order: ResumeOrder) -> None:
        try:
            answer = await self._gate.ask(Resume(order.by), self._arm_s)
        except (AskTimeout, Unreachable) as failure:
            answer = busy.with_load(refusals.silent_wire_at_resume(failure)).about(RESUME)
        finally:
            self._resuming = False
        resumed = read_answer(answer, Resumed, RESUME)
        if isinstance(resumed, Resumed):
            self._shared.resumed_epoch = resumed.epoch
            self._answers.event("resume", by=order.by, epoch=resumed.epoch)
            self._answers.success(order.sender, order.turn, {"armed": True, "epoch": resumed.epoch})
        else:
            self._answers.refuse(order.sender, order.turn, resumed)


def _unconfirmed(detail: str) -> dict[str, Any]:
    return {"outcome": "unconfirmed", "detail": detail}


def _by(order: SafetyOrder) -> str:
    named = order.by[:MAX_TEXT] if isinstance(order.by, str) else ""
    return named or order.sender_id or UNNAMED


def _seconds(timestamp: object) -> float:
    """Return a time stamp of a message; 0 if it is not one."""
    return float(timestamp) if isinstance(timestamp, int | float) and 0 < timestamp <= MAX_TIME_S else 0.0


def _sender_and_turn(order: SafetyOrder) -> tuple[str, str]:
    """Return the sender and its turn id. Both are empty if one of them is not a valid name."""
    named = is_name(order.sender_id) and is_name(order.turn_id)
    return (order.sender_id, order.turn_id) if named else ("", "")


def _order(payload: bytes) -> SafetyOrder:
    if len(payload) <= MAX_SAFETY_BYTES:
        try:
            return _decode_order(payload)
        except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError):
            # An e-stop needs no fields. A resume without its fields is refused later.
            pass
        # Send the result to the sender, if the sender can be read.
        if (sender := read_sender(payload)) is not None:
            return SafetyOrder(sender.sender_id, sender.turn_id)
    return SafetyOrder()
