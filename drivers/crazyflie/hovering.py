"""Setpoints that the driver makes by itself: the rise of a takeoff, and a hover without a command. Pure: no
I/O.

``Wire.feed`` sends each packet. It is called only while the driver's own tasks still respond. If they stop, the
packets stop, too, and the firmware's watchdog ends a takeoff or hover.
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
        risen_s: When the rise ends, on the drone's clock (``CrazyflieSession.robot_s``). If a later report does not
            show the drone in the air, it lies on the floor. An earlier report may be from before the rise.
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
