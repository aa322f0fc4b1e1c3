"""The counting actor for xoscar.

It needs a separate module, because xoscar's processes import the actor by name.
"""

from __future__ import annotations

import msgspec
import xoscar

from .common import State


class Counter(xoscar.Actor):  # type: ignore[misc]
    def __init__(self) -> None:
        super().__init__()
        self.n = 0

    def state(self, state: bytes) -> None:
        msgspec.msgpack.decode(state, type=State)
        self.n += 1

    def count(self) -> int:
        return self.n
