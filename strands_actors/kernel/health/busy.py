"""Explain missed deadlines by the load of this computer.

A deadline is missed for two reasons: the peer does not answer, or this computer had no time. A message that
does not name the second cause makes its reader look for a loose cable.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator

import msgspec

from strands_actors.kernel.messages import Refused

from .processor import pressure

LOAD_PER_CORE = 1.5
"""Runnable threads per core from which on a robot's processes wait for each other."""
PRESSURE = 0.3
"""Share of the last ten seconds in which a thread waited for a processor."""


class Machine(msgspec.Struct, frozen=True):
    """The load of this computer.

    Attributes:
        load: Runnable threads, averaged over a minute.
        cores: Cores that this process may run on.
        pressure: Share of the last ten seconds in which a thread waited for a processor, 0 to 1. None where the
            system does not report it.
    """

    load: float
    cores: int
    pressure: float | None = None

    @property
    def busy(self) -> bool:
        if self.pressure is not None and self.pressure >= PRESSURE:
            return True
        return self.load >= LOAD_PER_CORE * self.cores

    @property
    def text(self) -> str:
        """Describe the load for people, even if the computer is not busy."""
        waited = "" if self.pressure is None else f", {100 * self.pressure:.0f} % of the last 10 s waited for one"
        return f"load {self.load:.0f} on {self.cores} core{'s' * (self.cores != 1)}{waited}"


_assumed: Machine | None = None


@contextlib.contextmanager
def assumed(load: Machine) -> Iterator[None]:
    """Assume this load within the block, for tests and for virtual time."""
    global _assumed
    before, _assumed = _assumed, load
    try:
        yield
    finally:
        _assumed = before


def machine() -> Machine:
    """Measure the load of this computer. It takes some 20 us."""
    if _assumed is not None:
        return _assumed
    try:
        load = os.getloadavg()[0]
    except OSError:  # the system does not report it
        load = 0.0
    return Machine(load, _cores(), pressure())


def _cores() -> int:
    """Return how many cores this process may run on."""
    affinity = getattr(os, "sched_getaffinity", None)
    return len(affinity(0)) if affinity is not None else os.cpu_count() or 1


IDLE = Machine(0.0, 2)
_BUSY = "this computer is busy"


def explained(reason: str) -> str:
    """Return the cause of a missed deadline. If this computer is busy, add its load.

    The load is inserted after the first sentence, which describes the event, and before the remedy.
    """
    measured = machine()
    if not measured.busy or _BUSY in reason:
        return reason
    happened, stop, remedy = reason.partition(". ")
    return f"{happened} ({_BUSY}: {measured.text}){stop}{remedy}"


def with_load(refusal: Refused) -> Refused:
    """Return the refusal after a missed deadline. If this computer is busy, its reason includes the load."""
    return msgspec.structs.replace(refusal, reason=explained(refusal.reason))
