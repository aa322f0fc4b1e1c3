"""Say in one sentence that this computer has more to do than it can do.

Deadlines are missed for two reasons: the peer does not answer, or this computer had no time. Who
reads that a deadline was missed must be told of the second, or looks for a loose cable.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator

import msgspec

from .processor import pressure

LOAD_PER_CORE = 1.5
"""Runnable threads per core, from which on a robot's processes wait for each other."""
PRESSURE = 0.3
"""Share of the last ten seconds in which something stood in line for a processor."""


class Machine(msgspec.Struct, frozen=True):
    """How busy this computer is. ``load``: runnable threads, averaged over a minute. ``pressure``: the
    share of the last ten seconds in which something waited for a processor, 0 to 1; None where the
    system does not tell."""

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
        """For people, whether it is busy or not."""
        waited = "" if self.pressure is None else f", {100 * self.pressure:.0f} % of the last 10 s waited for one"
        return f"load {self.load:.0f} on {self.cores} core{'s' * (self.cores != 1)}{waited}"


_assumed: Machine | None = None


@contextlib.contextmanager
def assumed(seen: Machine) -> Iterator[None]:
    """Within the block this computer is as busy as ``seen``: for tests, and for virtual time, in which
    no computer is busy."""
    global _assumed
    before, _assumed = _assumed, seen
    try:
        yield
    finally:
        _assumed = before


def machine() -> Machine:
    """Look at this computer, which takes some 20 us."""
    if _assumed is not None:
        return _assumed
    try:
        load = os.getloadavg()[0]
    except OSError:  # the system does not tell
        load = 0.0
    return Machine(load, _cores(), pressure())


def _cores() -> int:
    """Return how many cores this process may run on."""
    affinity = getattr(os, "sched_getaffinity", None)
    return len(affinity(0)) if affinity is not None else os.cpu_count() or 1


IDLE = Machine(0.0, 2)
_SAID = "this computer is busy"


def explained(why: str) -> str:
    """Return why a deadline was missed. A computer that is too busy is named behind what happened,
    before what to do."""
    seen = machine()
    if not seen.busy or _SAID in why:
        return why
    happened, stop, remedy = why.partition(". ")
    return f"{happened} ({_SAID}: {seen.text}){stop}{remedy}"
