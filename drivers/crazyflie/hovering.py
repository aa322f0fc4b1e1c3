"""Setpoints of a drone that flies without a command: a rise, then a hover. Pure: no I/O.

``Wire.feed`` sends each packet, and is called only while gate and transport reply. So the firmware's own watchdog
stays in force during a takeoff and a hover.
"""

from __future__ import annotations

import msgspec

from strands_actors.kernel.clock import NS

from . import protocol as p


class Hover(msgspec.Struct, frozen=True):
    """A flight from one height to another, then a hover.

    Attributes:
        began_ns: Start of the flight.
        to_m: The height of the hover.
        from_m: The height at the start.
        duration_s: Duration of the flight; 0 for a hover at once.
        risen_s: Time in ``CrazyflieSession.robot_s`` of the end of the rise. If a later row does not show the
            drone in the air, it lies on the floor. An earlier row may be from before it rose.
    """

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
        """Return the duration of the hover so far, seconds."""
        return max(0.0, (now_ns - self.began_ns) / NS - self.duration_s)
