"""Record the requests to the tree and its answers, with their senders and times.

They are read from the frames between processes.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

import msgspec

from strands_actors.kernel.frames import ASK, REPLY, TELL, decode_frame
from strands_actors.kernel.messages import Message, Refused
from strands_actors.supervisors.gate.messages import (
    Accepted,
    Lease,
    Perform,
    Performed,
    Release,
    Resume,
    Resumed,
    Setpoint,
    Stop,
    StopReport,
)
from strands_actors.supervisors.root.messages import Fence, Shutdown, StartTask, StopTask, TaskStatus

Question = Setpoint | Perform | Stop | Resume | Release | Fence | Shutdown | StartTask | StopTask
Reply = Accepted | Performed | Refused | StopReport | Resumed | Lease | TaskStatus

_question = msgspec.msgpack.Decoder(Question)
_reply = msgspec.msgpack.Decoder(Reply)


@dataclass
class Asked:
    """A request to the tree, and its answer.

    Attributes:
        answered_s: When the answer was sent; infinity if there was no answer.
    """

    at_s: float
    who: str
    pid: int
    message: Message
    answer: Message | None = None
    answered_s: float = float("inf")

    @property
    def refused(self) -> bool:
        return isinstance(self.answer, Refused)


class Told(NamedTuple):
    """The envelope that the script received for a verb, as a user reads it."""

    asked_s: float
    answered_s: float
    verb: str
    success: bool
    pid: int


@dataclass
class Conversation:
    asked: list[Asked] = field(default_factory=list)
    told: list[Told] = field(default_factory=list)
    setpoints: list[Asked] = field(default_factory=list)
    _open: dict[tuple[str, int], Asked] = field(default_factory=dict)

    def hear(self, now_s: float, who: str, pid: int, data: bytes) -> None:
        """Record a frame that ``who`` sends."""
        head = decode_frame(data)
        if head.kind not in (TELL, ASK, REPLY):
            return
        try:
            if head.kind == REPLY:
                asked = self._open.pop((head.to, head.cid), None)
                if asked is not None:
                    asked.answer, asked.answered_s = _reply.decode(head.body), now_s
                return
            message = _question.decode(head.body)
        except msgspec.ValidationError:
            return  # No invariant reads other messages.
        asked = Asked(now_s, who, pid, message)
        if head.kind == ASK:
            self._open[head.reply_to, head.cid] = asked
        (self.setpoints if isinstance(message, Setpoint) else self.asked).append(asked)

    def of(self, kind: type[Message]) -> list[Asked]:
        return [asked for asked in self.asked if isinstance(asked.message, kind)]


def type_name(data: bytes) -> str:
    """Return the name of the type of the message in a frame; empty if the frame carries no message."""
    head = decode_frame(data)
    if head.kind not in (TELL, ASK, REPLY):
        return ""
    body = msgspec.msgpack.decode(head.body)
    return str(body[0]) if isinstance(body, list) and body else ""
