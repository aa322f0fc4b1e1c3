"""The surroundings of an actor in a replay. The context supplies recorded messages and times, and collects all
effects.

No message leaves the replay. There is no clock, so an actor that reads one fails.
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
"""An effect of an actor: kind, number of a deferral, receiver, and the encoded body."""


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
    """A ticker that never ticks, since its ticks are recorded messages."""

    def brought(self) -> None:
        """Do nothing. On the robot, this call delays the next tick, but a replay has no ticks."""


class ReplayContext(Context):
    def __init__(self, address: str, effects: list[Effect]) -> None:
        self.address = address
        self.received_ns = 0
        self.deferrals = 0
        self.is_request = False
        self._effects = effects

    @property
    def expects_answer(self) -> bool:
        return self.is_request

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
        """Do nothing, since a note in the journal is not a decision."""

    def watch(self, address: str) -> None:
        """Do nothing. If the watched actor has ended, the message ``Down`` is recorded."""

    def every(self, period_s: float, make: Callable[[int], Message]) -> Ticker:
        """Return a ticker that never ticks, since its ticks are recorded messages."""
        return ReplayTicker(VirtualClock(), period_s)

    def start_soon(self, task: Callable[..., Awaitable[Any]], *args: Any) -> None:
        """Do nothing. A background task makes no decisions, so its work is not replayed."""


def answer_effect(answer: object) -> list[Effect]:
    """Return the effect of an answer, in the same form as in the journal."""
    if answer is None:
        return []
    if isinstance(answer, Deferred):
        return [(Kind.DEFERRED, answer.number, "", encode(None))]
    return [(Kind.ANSWERED, 0, "", encode(answer))]
