"""How the guardian uses the wire group and the standby. In tests they run in the same process, otherwise in
separate processes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

from strands_actors.kernel.health.processor import ProcessorUse
from strands_actors.kernel.messages import Refused


class GuardedWire(Protocol):
    """The wire group (gate, watchdog and transport), which talks to the robot. It runs in a separate process, or in
    this one in tests."""

    @property
    def alive(self) -> bool:
        """True while the wire group can still write to the robot."""
        ...

    @property
    def ended_safe(self) -> bool:
        """True if the wire process has ended by itself with a confirmed stop of every motor, and accepted no order
        after that.

        The exit code shows this. A message is not enough, since it can be forged.
        """
        ...

    async def ended(self) -> str:
        """Wait until the wire group has ended by itself, and return the reason."""
        ...

    def dying(self) -> bool:
        """Return True if the process was killed or is exiting, so that it runs no more of its code.

        The system frees the memory of a process before it reports its end, which takes 5 to 20 ms.
        """
        ...

    async def fence(self) -> bool:
        """Kill the wire process, so that it can never write to the robot again. Return True if its end was
        observed.

        Its earlier messages have been handled when this returns. If the end was not observed within a second, the
        process runs no more of its code, but one of its system calls may still run.
        """
        ...

    def close_link(self) -> None:
        """Close the link to the wire process. It then stops the robot if necessary, and exits."""
        ...

    def processor_use(self) -> ProcessorUse | None:
        """Return how much processor time the process uses; None where the system does not report it."""
        ...


class GuardedStandby(Protocol):
    """The keeper of the standby process. The standby is a third process, which stops the robot when root and wire
    have ended."""

    async def guard(self, descriptors: Sequence[int]) -> Refused | None:
        """Give the standby a stop channel. Return None when the channel is ready, or a refusal."""
        ...

    async def release_channel(self) -> None:
        """Wait until the standby has closed its stop channel, or has ended."""
        ...
