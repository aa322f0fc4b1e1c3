"""The interfaces of the guardian to the wire group and the standby, independent of where these run."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

from strands_actors.kernel.health.processor import Standing
from strands_actors.kernel.messages import Refused


class GuardedWire(Protocol):
    """The wire group, in a separate process or in this one (tests)."""

    @property
    def alive(self) -> bool:
        """True while it can still write."""
        ...

    @property
    def left_safe(self) -> bool:
        """True if it has ended by itself, after it had read back every motor, and has accepted no order since.

        The exit code shows this. A message does not count, since it can be forged.
        """
        ...

    async def ended(self) -> str:
        """Wait until it has ended by itself, and return the reason."""
        ...

    def dying(self) -> bool:
        """Return True if it was killed or is exiting, so that it runs no more of its code.

        The system frees its memory before it reports its end, which takes 5 to 20 ms.
        """
        ...

    async def fence(self) -> bool:
        """Make sure that it can never write again. Return True if its end was seen.

        Its earlier messages have been handled by then. If its end was not seen within a second, it runs no more
        of its code, but one of its system calls may still run.
        """
        ...

    def let_go(self) -> None:
        """Close its link. It then stops the robot if necessary, and exits."""
        ...

    def standing(self) -> Standing | None:
        """Return its use of the processor, or None where the system does not report it."""
        ...


class GuardedStandby(Protocol):
    """The keeper of the standby: a third process, which stops the robot when root and wire are gone."""

    async def guard(self, descriptors: Sequence[int]) -> Refused | None:
        """Give the standby a stop channel. Return None when that is ready, else a refusal."""
        ...

    async def let_go(self) -> None:
        """Wait until the standby has closed its stop channel, or has ended."""
        ...
