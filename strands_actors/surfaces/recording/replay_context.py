"""Where a replayed actor believes it lives: it is given messages and times, and all it does is
written down.

Nothing leaves, and there is no clock: an actor that read one would fail here.
"""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from typing import Any

from strands_actors.kernel.actor import Actor, Context, Deferred
from strands_actors.kernel.clock import VirtualClock
from strands_actors.kernel.messages import Message
from strands_actors.kernel.node import Ref
from strands_actors.kernel.ticker import Ticker
from strands_actors.supervisors.instrument import Kind, encode, name_of

Effect = tuple[Kind, int, str, bytes]
"""What an actor did: kind, number of a deferral, to whom, and the encoded body."""


class ReplayDeferred(Deferred):
    __slots__ = ("_effects",)

    def __init__(self, effects: list[Effect], number: int) -> None:
        super().__init__(None, None, number)
        self._effects = effects

    def send(self, answer: Message | None) -> None:
        self._effects.append((Kind.SETTLED, self.number, "", encode(answer)))


class ReplayRef(Ref):
    __slots__ = ("_effects",)

    def __init__(self, effects: list[Effect], address: str) -> None:
        self.address = address
        self._effects = effects

    def tell(self, message: Message) -> None:
        self._effects.append((Kind.SENT, 0, name_of(self.address), encode(message)))


class ReplayTicker(Ticker):
    """No ticker runs in a replay, so none is put off."""

    def brought(self) -> None:
        """That a message stood for a tick follows from its number, and stands in the recording."""


class ReplayContext(Context):
    def __init__(self, address: str, effects: list[Effect]) -> None:
        self.address = address
        self.received_ns = 0
        self.deferrals = 0
        self.was_asked = False
        self._effects = effects

    @property
    def asked(self) -> bool:
        return self.was_asked

    @property
    def me(self) -> Ref:
        return ReplayRef(self._effects, self.address)

    def ref(self, address: str, protocol: type[Actor] | None = None) -> Ref:
        return ReplayRef(self._effects, address)

    def defer(self) -> Deferred:
        self.deferrals += 1
        return ReplayDeferred(self._effects, self.deferrals)

    def saw(self, value: object) -> None:
        self._effects.append((Kind.SAW, 0, "", encode(value)))

    def note(self, message: Message) -> None:
        """Is no decision."""

    def watch(self, address: str) -> None:
        """What it would be told stands in the recording."""

    def every(self, period_s: float, make: Callable[[int], Message]) -> Ticker:
        """Its ticks stand in the recording."""
        return ReplayTicker(VirtualClock(), period_s)

    def start_soon(self, task: Callable[..., Awaitable[Any]], *args: Any) -> None:
        """What a task does beside the actor is no decision of its own: the message that starts it
        is."""


def answer_effect(answer: object) -> list[Effect]:
    """As a journal has it."""
    if answer is None:
        return []
    if isinstance(answer, Deferred):
        return [(Kind.DEFERRED, answer.number, "", encode(None))]
    return [(Kind.ANSWERED, 0, "", encode(answer))]
