"""Send a robot's answers to the senders of commands, and its events to all subscribers."""

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
"""Queries that may wait for an answer at the same time. Beyond that the oldest gets no answer."""


class Answers:
    """Send answers and events.

    A command that was put is answered on a public key of its sender. A query is answered in private.

    Attributes:
        refused: Number of refusals, whether they were sent or not.
    """

    def __init__(self, pubsub: PubSub, robot: str) -> None:
        self._pubsub = pubsub
        self._robot = robot
        self._events = pubsub.topic(EVENT_KEY, _EVENT)
        self.refused = 0
        self._private: dict[str, tuple[str, Reply]] = {}
        """The sender's own turn and the way of the answer, by the name of the turn in this process."""

    def expect(self, turn: str, reply: Reply) -> str:
        """Note a query that will be answered in private. Return the name of its turn in this process. The
        name cannot be guessed, so no other sender can refer to it."""
        if len(self._private) >= _MAX_QUESTIONS:
            self.forget(next(iter(self._private)))
        name = f"{turn}{PRIVATE}{secrets.token_hex(16)}"
        self._private[name] = turn, reply
        return name

    def forget(self, turn: str) -> None:
        """Drop a query that gets no further answer."""
        self._private.pop(turn, None)

    def success(self, sender: str, turn: str, result: dict[str, Any], final: bool = True) -> None:
        self._put(sender, turn, Response("response", self._robot, turn, time.time(), result, final=final))

    def refuse(self, sender: str, turn: str, refused: Refused) -> None:
        """Send a refusal. A query is always answered.

        Args:
            sender: The sender of a command that was put; empty to send no public answer.
            turn: The turn of the command.
            refused: The refusal.
        """
        self.refused += 1
        if sender or PRIVATE in turn:
            refusal = Refusal(**msgspec.structs.asdict(refused))
            response = Response("error", self._robot, turn, time.time(), error=refused.text, refused=refusal)
            self._put(sender, turn, response)

    def _put(self, sender: str, turn: str, response: Response) -> None:
        if PRIVATE in turn:
            asked, reply = self._private.get(turn, ("", None))
            if reply is not None:
                reply(encode(msgspec.structs.replace(response, turn_id=asked)), response.final, _RESPONSE)
            if response.final:
                self.forget(turn)
            return
        self._pubsub.put(response_key(sender, self._robot, turn), encode(response), _RESPONSE)

    def event(self, event: str, **facts: Any) -> None:
        """Publish an event if there is a subscriber."""
        if self._events.wanted:
            self._events.put(encode({"peer_id": self._robot, "t": time.time(), "event": event, **facts}))


def told(report: StopReport) -> dict[str, Any]:
    """Return a stop's report as JSON."""
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
