"""What a Crazyflie is told while nobody commands it in the air: to rise, then to stay. Pure.

Each packet is sent by ``Wire.feed``, which is called only while gate and transport answer: so the
firmware's own watchdog stays in force through a takeoff and a hover.
"""

from __future__ import annotations

import msgspec

from strands_actors.kernel.clock import NS

from . import protocol as p


class Hover(msgspec.Struct, frozen=True):
    """From one height to another in ``duration_s``, then still there. ``duration_s`` 0: still at
    once. ``risen_s``: who is not in the air after that, by ``CrazyflieSession.robot_s``, lies on the floor; a row
    from before may show it as it was before it rose."""

    began_ns: int
    to_m: float
    from_m: float = 0.0
    duration_s: float = 0.0
    risen_s: float = 0.0

    def packet(self, now_ns: int) -> bytes:
        passed_s = (now_ns - self.began_ns) / NS
        if passed_s >= self.duration_s:
            return p.hover_still(self.to_m)
        share = max(0.0, passed_s / self.duration_s)
        return p.hover(0.0, 0.0, 0.0, self.from_m + share * (self.to_m - self.from_m))

    def rises(self, now_ns: int) -> bool:
        return now_ns - self.began_ns < self.duration_s * NS

    def still_s(self, now_ns: int) -> float:
        """Return for how long it has been still."""
        return max(0.0, (now_ns - self.began_ns) / NS - self.duration_s)
