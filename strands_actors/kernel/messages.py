"""Messages: frozen structs that name their lane.

``urgent``   stop, e-stop, lifecycle: handled before anything else that waits.
``command``  bounded first-in-first-out: a full queue refuses, it never grows.
``latest``   conflating: of one sender and one type only the newest waits (setpoints, observations).

On the wire between actors a message is msgpack, array-like, tagged with its class name: 0.8 us for
encode and decode of a seven-joint state.
"""

from __future__ import annotations

from typing import ClassVar, Literal

import msgspec

Lane = Literal["urgent", "command", "latest"]

MAX_MESSAGE_BYTES = 64 * 1024


class Message(msgspec.Struct, frozen=True, array_like=True, tag=True, gc=False):
    """Base of everything that travels between actors."""

    lane: ClassVar[Lane] = "command"


class Refused(Message, frozen=True):
    """A typed no: what was wrong, what was offered, what would be accepted. Nothing was written.

    ``code`` is stable and for programs; ``reason`` and ``remedy`` are sentences for people, and no
    program reads them. ``verb``: what was refused. Whoever answers an order names it: a rule that
    refuses knows only why. ``because``: the ``Reason`` of the stop in which the robot is.
    """

    code: str
    reason: str
    remedy: str = ""
    offered: str = ""
    limit: str = ""
    verb: str = ""
    because: str = ""

    @property
    def text(self) -> str:
        """Return it for people, as ``verb: reason. remedy``."""
        verb = f"{self.verb}: " if self.verb else ""
        remedy = f". {self.remedy}" if self.remedy else ""
        return f"{verb}{self.reason}{remedy}"

    def about(self, verb: str) -> Refused:
        """Return it as the answer to ``verb``."""
        return msgspec.structs.replace(self, verb=verb)
