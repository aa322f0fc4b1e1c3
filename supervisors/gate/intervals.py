"""Count the times between the setpoints of a stream, for the metrics. Pure.

Only intervals within one stream count: the pause between two motions says nothing about the stream.
"""

from __future__ import annotations

import bisect

import msgspec

from strands_actors.kernel.clock import NS

BOUNDS_S = (0.002, 0.004, 0.008, 0.012, 0.016, 0.02, 0.025, 0.03, 0.04, 0.06, 0.1, 0.2, 0.5)
"""Upper bounds of the buckets. They are dense where streams are late: 500 Hz, 100 Hz, 50 Hz, 30 Hz."""


class Intervals(msgspec.Struct):
    """The intervals since the wire process was started.

    Attributes:
        counts: Number of intervals in each bucket. The last one has the longer ones.
        total_s: Sum of all intervals, in seconds.
        lease: The lease of the present stream; 0 without one.
        last_ns: Time of its last setpoint.
    """

    counts: list[int] = msgspec.field(default_factory=lambda: [0] * (len(BOUNDS_S) + 1))
    total_s: float = 0.0
    lease: int = 0
    last_ns: int = 0

    def note(self, lease: int, is_streamed: bool, now_ns: int) -> None:
        """Take an accepted setpoint.

        Args:
            lease: Its lease.
            is_streamed: True if it is part of a stream.
            now_ns: The time.
        """
        if is_streamed and lease == self.lease:
            interval_s = (now_ns - self.last_ns) / NS
            self.counts[bisect.bisect_left(BOUNDS_S, interval_s)] += 1
            self.total_s += interval_s
        self.lease, self.last_ns = (lease if is_streamed else 0), now_ns
