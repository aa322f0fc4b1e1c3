"""Decide whether a peer process is frozen, or was only kept from running by a busy machine.

Theory. A frozen process must be noticed within ``ttl_s``. But on a machine with all processors taken, every
process is silent now and then. A detector that ended a healthy process for that would make a busy machine look
like a broken robot. Two measurements tell the cases apart:

* Our own ticks. The time since the previous tick counts for at most ``MOST_TICKS`` periods. When the whole
  machine paused, all processes were late and no process is frozen.
* The peer's use of the processor. Time does not count as silence while the peer waited for a processor, or
  while its processor was taken from this virtual machine. A process that waits for a lock does not wait for a
  processor. One that spins mostly computes. One that is stopped never waits for a processor, at any load.

A silence of more than ``LONGEST_S`` (or ``ttl_s``, if that is longer) always counts. After that time a late
message cannot be distinguished from one that never comes.

The detector looks at the peer's use of the processor only after half of ``ttl_s``, so a peer that answers costs
nothing.
"""

from __future__ import annotations

from collections.abc import Callable

import msgspec

from strands_actors.kernel.clock import NS

from .processor import ProcessorUse

LONGEST_S = 0.3
"""A silence of so many seconds always counts, also on a busy machine."""
MOST_TICKS = 2
"""Periods of silence that one tick counts at most. If a tick comes later, this process was delayed, and the
peer may have been, too."""


class DetectorState(msgspec.Struct, frozen=True):
    """The state of a ``FailureDetector``, so that it can be saved and restored."""

    last_received_ns: int = msgspec.field(name="heard_ns")
    ticks: int
    looked_ns: int
    before: ProcessorUse | None
    ticked_ns: int = 0
    counted_ns: int = 0


class FailureDetector:
    """Decides whether one peer process has been silent for too long.

    Args:
        ttl_s: The longest silence.
        tick_s: The period in which ``tick`` is called.
        look: Returns how the peer uses the processor; None where the system does not report it.
    """

    def __init__(self, ttl_s: float, tick_s: float, look: Callable[[], ProcessorUse | None] = lambda: None) -> None:
        self._own_ticks = round(ttl_s / tick_s)
        self._most_ns = round(MOST_TICKS * tick_s * NS)
        self._ttl_ns = round(ttl_s * NS)
        self._longest_ns = max(self._ttl_ns, round(LONGEST_S * NS))
        self._look = look
        self.last_received_ns = 0
        self._ticks = 0
        # Time of the last tick of this process.
        self._ticked_ns = 0
        # Silence of the peer, counted by the ticks of this process.
        self._counted_ns = 0
        self._looked_ns = 0
        self._before: ProcessorUse | None = None
        self._after: ProcessorUse | None = None

    def note_heartbeat(self, heartbeat_ns: int) -> bool:
        """Note the time of the peer's last heartbeat. Return True if it is newer than the previous one."""
        if heartbeat_ns <= self.last_received_ns:
            return False
        self.last_received_ns = heartbeat_ns
        self._ticks = 0
        self._counted_ns = 0
        self._looked_ns = 0
        return True

    def memory(self) -> DetectorState:
        return DetectorState(
            self.last_received_ns, self._ticks, self._looked_ns, self._before, self._ticked_ns, self._counted_ns
        )

    def recall(self, memory: DetectorState) -> None:
        self.last_received_ns, self._ticks = memory.last_received_ns, memory.ticks
        self._looked_ns, self._before = memory.looked_ns, memory.before
        self._ticked_ns, self._counted_ns = memory.ticked_ns, memory.counted_ns

    def tick(self, now_ns: int) -> bool:
        """Return True once the peer has been silent for too long. Call it at each tick.

        It returns False before the first heartbeat of the peer.
        """
        ticked_ns, self._ticked_ns = self._ticked_ns, now_ns
        if not self.last_received_ns:
            return False
        self._ticks += 1
        silent_ns = now_ns - self.last_received_ns
        self._counted_ns += min(now_ns - max(ticked_ns, self.last_received_ns), self._most_ns)
        if silent_ns > self._ttl_ns // 2 and not self._looked_ns:
            self._looked_ns, self._before = now_ns, self._look()
        if silent_ns <= self._ttl_ns or self._ticks < self._own_ticks:
            return False
        self._after = self._look()
        return (
            silent_ns > self._longest_ns or min(silent_ns, self._counted_ns) - self._kept_ns(now_ns) > self._ttl_ns
        )

    def describe_silence(self, now_ns: int) -> str:
        """Describe the silence and its cause for people. Call it after ``tick`` has returned True.

        The text has the time that the peer computed and waited for a processor since ``look`` was first called.
        A frozen peer did neither. A peer that spins computed. A peer without a processor waited.
        """
        text = f"silent for {(now_ns - self.last_received_ns) / 1e6:.0f} ms"
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
        """Return how long the machine kept the peer from running since ``look`` was first called."""
        before, after = self._before, self._after
        if before is None or after is None or after.stopped:
            return 0
        return self._stood_in_line_ns(now_ns, before, after) + _stolen_ns(before, after)

    def _stood_in_line_ns(self, now_ns: int, before: ProcessorUse, after: ProcessorUse) -> int:
        waited_ns = after.waited_ns - before.waited_ns
        # The system counts a wait only when it has ended, so compute the present wait here.
        if after.ready:
            waited_ns = max(waited_ns, now_ns - self._looked_ns - (after.computed_ns - before.computed_ns))
        return waited_ns


def _stolen_ns(before: ProcessorUse, after: ProcessorUse) -> int:
    """Return the greatest time that the hypervisor took from one processor.

    The system does not report which processor wakes the peer, so the worst one counts.
    """
    return max((now - then for then, now in zip(before.stolen_ns, after.stolen_ns, strict=False)), default=0)
