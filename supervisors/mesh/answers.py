"""Send answers to the peers that sent a command over the mesh, and events to all subscribers."""

from __future__ import annotations

import secrets
import time
from typing import Any

import msgspec

from strands_actors.kernel.channels.pubsub import PubSub, Reply
from strands_actors.kernel.messages import Refused
from strands_actors.supervisors.gate.messages import StopReport

from .schemas import EVENT_KEY, PRIVATE, Refusal, Response, encode, response_key, schema

_RESPONSE = schema("response")
_EVENT = schema("event")
_MAX_QUESTIONS = 256
"""Largest number of queries that wait for an answer. If there are more, the oldest query gets no answer."""


class Answers:
    """Send the robot's answers and events over the mesh.

    A command that was published (zenoh put) is answered on a zenoh key of its sender, which other peers can
    read. A query (zenoh get) gets a reply that only its sender can read.

    Attributes:
        refused: Number of refusals, whether they were sent or not.
    """

    def __init__(self, pubsub: PubSub, robot: str) -> None:
        self._pubsub = pubsub
        self._robot = robot
        self._events = pubsub.topic(EVENT_KEY, _EVENT)
        self.refused = 0
        self._private: dict[str, tuple[str, Reply]] = {}
        """For each name from ``expect``, the sender's own turn id and the function that sends the reply."""

    def expect(self, turn: str, reply: Reply) -> str:
        """Store the reply function of a query until the command is answered. Return a name for the query, to be
        used in place of its turn id. The name cannot be guessed, so no other sender can use it."""
        if len(self._private) >= _MAX_QUESTIONS:
            self.forget(next(iter(self._private)))
        name = f"{turn}{PRIVATE}{secrets.token_hex(16)}"
        self._private[name] = turn, reply
        return name

    def forget(self, turn: str) -> None:
        """Discard the reply function of a query that gets no further answer."""
        self._private.pop(turn, None)

    def success(self, sender: str, turn: str, result: dict[str, Any], final: bool = True) -> None:
        self._put(sender, turn, Response("response", self._robot, turn, time.time(), result, final=final))

    def refuse(self, sender: str, turn: str, refused: Refused) -> None:
        """Send a refusal. A query always gets one.

        Args:
            sender: The sender of a published command; empty to send no public answer.
            turn: The turn id of the command, or the name from ``expect``.
            refused: The refusal.
        """
        self.refused += 1
        if sender or PRIVATE in turn:
            refusal = Refusal(**msgspec.structs.asdict(refused))
            response = Response("error", self._robot, turn, time.time(), error=refused.text, refused=refusal)
            self._put(sender, turn, response)

    def _put(self, sender: str, turn: str, response: Response) -> None:
        if PRIVATE in turn:
            turn_id, reply = self._private.get(turn, ("", None))
            if reply is not None:
                reply(encode(msgspec.structs.replace(response, turn_id=turn_id)), response.final, _RESPONSE)
            if response.final:
                self.forget(turn)
            return
        self._pubsub.put(response_key(sender, self._robot, turn), encode(response), _RESPONSE)

    def event(self, event: str, **facts: Any) -> None:
        """Publish an event if there is a subscriber."""
        if self._events.has_subscribers:
            self._events.put(encode({"peer_id": self._robot, "t": time.time(), "event": event, **facts}))


def report_json(report: StopReport) -> dict[str, Any]:
    """Return the report of a stop as a mapping for JSON."""
    return {
        "outcome": "safe" if report.confirmed else "unconfirmed",
        "safe_state": str(report.safe_state),
        "epoch": report.epoch,
        "path": report.path,
        "took_ms": round(report.took_ms, 2),
        "note": report.note,
        "motors": [
            {"axis": motor.axis, "id": motor.id, "safe": motor.safe, "detail": motor.detail}
            for motor in report.motors
        ],
    }
