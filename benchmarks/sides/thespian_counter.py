"""The counting actor for Thespian. It needs a separate module, because Thespian's processes import the actor by
name.
"""

from __future__ import annotations

import msgspec
from thespian.actors import Actor

from .common import State


class Counter(Actor):  # type: ignore[misc]
    def __init__(self) -> None:
        super().__init__()
        self.n = 0

    def receiveMessage(self, message: object, sender: object) -> None:
        if isinstance(message, bytes):
            msgspec.msgpack.decode(message, type=State)
            self.n += 1
        elif message == "count":
            self.send(sender, self.n)
