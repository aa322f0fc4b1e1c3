"""What the guardian needs of those it guards: the wire group, and the standby, wherever they live."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

from strands_actors.kernel.health.processor import Standing
from strands_actors.kernel.messages import Refused


class GuardedWire(Protocol):
    """Where the wire group lives: a process of its own, or this one (tests)."""

    @property
    def alive(self) -> bool:
        """Return whether it can still write."""
        ...

    @property
    def left_safe(self) -> bool:
        """Return whether it has ended by itself, after it had read back every motor and obeyed
        nobody since. Not by its own word in a message: a message can be forged."""
        ...

    async def ended(self) -> str:
        """Return when it has ended by itself, with the reason."""
        ...

    def dying(self) -> bool:
        """Return whether it has been killed, or ends: it runs no code of its own any more. The system takes
        its memory before it tells of its end, which lasts 5 to 20 ms."""
        ...

    async def fence(self) -> bool:
        """Return when it can never write again, and what it said before has been heard; whether its
        end was seen. After a second in which it was not it runs no code of its own, but a system
        call of its may not be over."""
        ...

    def let_go(self) -> None:
        """Close its link: it makes safe what is not, and ends."""
        ...

    def standing(self) -> Standing | None:
        """Return how its process stands with the processor; None where nobody can tell."""
        ...


class GuardedStandby(Protocol):
    """Who keeps the standby: a third process, which makes safe when root and wire are gone."""

    async def guard(self, descriptors: Sequence[int]) -> Refused | None:
        """Give it a way to the hardware; None when it could use that at once."""
        ...

    async def let_go(self) -> None:
        """Return when it has closed that, or is gone."""
        ...
