"""Has a peer process stopped answering, or has the machine stopped it?

A process that stands still must be noticed within ``ttl_s``. But on a machine whose processors are
all taken every process is silent now and then, and to end a healthy one for that would make a busy
machine look like a broken robot. Two things tell them apart:

* Our own ticks: the time since the one before counts for no more than ``MOST_TICKS`` periods. When
  the whole machine paused, everybody was late and nobody is frozen.
* The time the peer has stood in line for a processor, or its processor was taken from this virtual
  machine, which does not count as silence. A process that waits for a lock does not stand in line;
  one that spins mostly computes; one that is stopped stands nowhere, whatever the machine does. In
  all never longer than ``longest_s``: what a peer does not say cannot be told from what it cannot
  say for ever.

The peer is only looked at once half of its time is over: one that answers costs nothing.
"""

from __future__ import annotations

from collections.abc import Callable

import msgspec

from strands_actors.kernel.clock import NS

from .processor import Standing

LONGEST_S = 0.3
"""Silent for so long is silent, whatever the machine was doing."""
MOST_TICKS = 2
"""A tick that comes later than this many periods was held up, as the peer may have been."""


class Heard(msgspec.Struct, frozen=True):
    """What a ``FailureDetector`` remembers of its peer."""

    heard_ns: int
    ticks: int
    looked_ns: int
    before: Standing | None
    ticked_ns: int = 0
    counted_ns: int = 0


class FailureDetector:
    """Of one peer, asked every ``tick_s``. ``look`` asks how it stands with the processor; None
    where nobody can tell."""

    def __init__(self, ttl_s: float, tick_s: float, look: Callable[[], Standing | None] = lambda: None) -> None:
        self._own_ticks = round(ttl_s / tick_s)
        self._most_ns = round(MOST_TICKS * tick_s * NS)
        self._ttl_ns = round(ttl_s * NS)
        self._longest_ns = max(self._ttl_ns, round(LONGEST_S * NS))
        self._look = look
        self.heard_ns = 0
        self._ticks = 0
        self._ticked_ns = 0  # our own last tick
        self._counted_ns = 0  # of the silence, what counts by our own ticks
        self._looked_ns = 0
        self._before: Standing | None = None
        self._after: Standing | None = None

    def heard(self, word_ns: int) -> bool:
        """The peer's last word is from then; whether that is news."""
        if word_ns <= self.heard_ns:
            return False
        self.heard_ns = word_ns
        self._ticks = 0
        self._counted_ns = 0
        self._looked_ns = 0
        return True

    def memory(self) -> Heard:
        return Heard(self.heard_ns, self._ticks, self._looked_ns, self._before, self._ticked_ns, self._counted_ns)

    def recall(self, memory: Heard) -> None:
        self.heard_ns, self._ticks = memory.heard_ns, memory.ticks
        self._looked_ns, self._before = memory.looked_ns, memory.before
        self._ticked_ns, self._counted_ns = memory.ticked_ns, memory.counted_ns

    def tick(self, now_ns: int) -> bool:
        """Call at each own tick; True once the peer has been silent for too long. Never before its
        first word."""
        ticked_ns, self._ticked_ns = self._ticked_ns, now_ns
        if not self.heard_ns:
            return False
        self._ticks += 1
        silent_ns = now_ns - self.heard_ns
        self._counted_ns += min(now_ns - max(ticked_ns, self.heard_ns), self._most_ns)
        if silent_ns > self._ttl_ns // 2 and not self._looked_ns:
            self._looked_ns, self._before = now_ns, self._look()
        if silent_ns <= self._ttl_ns or self._ticks < self._own_ticks:
            return False
        self._after = self._look()
        return (
            silent_ns > self._longest_ns or min(silent_ns, self._counted_ns) - self._kept_ns(now_ns) > self._ttl_ns
        )

    def told(self, now_ns: int) -> str:
        """For people, after the tick that found it silent for too long: how long, and what it did
        since it was first looked at. A frozen one did nothing, one that spins computed, one that is
        starved stood in line."""
        text = f"silent for {(now_ns - self.heard_ns) / 1e6:.0f} ms"
        before, after = self._before, self._after
        if before is None or after is None:
            return text
        computed_ms = (after.computed_ns - before.computed_ns) / 1e6
        text += (
            f"; in the last {(now_ns - self._looked_ns) / 1e6:.0f} it computed for {computed_ms:.0f} "
            f"and stood in line for {self._stood_in_line_ns(now_ns, before, after) / 1e6:.0f}"
        )
        if after.stopped:
            return f"{text}: it is stopped"
        if stolen_ns := _stolen_ns(before, after):
            text += f"; this virtual machine lost a processor for {stolen_ns / 1e6:.0f}"
        return text

    def _kept_ns(self, now_ns: int) -> int:
        """So long since it was first looked at, it was kept from answering."""
        before, after = self._before, self._after
        if before is None or after is None or after.stopped:
            return 0
        return self._stood_in_line_ns(now_ns, before, after) + _stolen_ns(before, after)

    def _stood_in_line_ns(self, now_ns: int, before: Standing, after: Standing) -> int:
        waited_ns = after.waited_ns - before.waited_ns
        if after.ready:  # the wait it is in is not yet counted
            waited_ns = max(waited_ns, now_ns - self._looked_ns - (after.computed_ns - before.computed_ns))
        return waited_ns


def _stolen_ns(before: Standing, after: Standing) -> int:
    """From the processor that lost most: which one its timer is on, nobody tells."""
    return max((now - then for then, now in zip(before.stolen_ns, after.stolen_ns, strict=False)), default=0)
