"""Compute how long to wait for a stop.

A timeout is the longest duration of a stop that the driver declares (``Timing.safe_s``), plus a margin. A request
that was sent before the stop may still take effect after the stop. The time for this is added (``settle_s``).

A robot may need long until it is safe, such as a drone that lands. Its wire process must not be killed meanwhile,
since the next process would begin the landing again.
"""

from __future__ import annotations

from typing import NamedTuple

from strands_actors.contract.driver import Timing

ROOM_S = 0.5
"""Margin for messages and for a process that waits for a processor."""
FENCE_ROOM_S = 1.0
"""Time to kill a process and to see its end."""
OWN_STOP_S = 0.25
"""Time for the wire's own stop when the tree ends, for a robot with the usual ``safe_s``."""
USUAL_SAFE_S = Timing(control_hz=1.0, keepalive_s=1.0).safe_s


class StopDeadlines(NamedTuple):
    longer_s: float
    """How much longer than usual this robot needs until it is safe."""
    gate_s: float
    """Timeout for the gate's reply to a stop."""
    attempt_s: float
    """Timeout for one attempt of a stop channel. An attempt that takes longer counts as failed."""
    root_s: float
    """Timeout for the root's reply to a stop. The root kills the wire process and stops the robot itself."""
    own_stop_s: float
    """Timeout for the stop by the wire process when the tree ends. After it, the root kills the wire process."""
    end_s: float
    """Timeout for the end of the root process."""

    @classmethod
    def of(cls, safe_s: float, late_s: float = 0.0) -> StopDeadlines:
        """Return the timeouts of a robot.

        Args:
            safe_s: ``Timing.safe_s`` of the driver.
            late_s: ``Driver.late_s``. It is not included in ``attempt_s`` and ``own_stop_s``.
        """
        settled_s = settle_s(safe_s, late_s)
        attempt_s = safe_s + ROOM_S
        longer_s = max(0.0, safe_s - USUAL_SAFE_S)
        own_stop_s = OWN_STOP_S + longer_s
        return cls(
            longer_s=longer_s,
            gate_s=safe_s + settled_s + ROOM_S,
            attempt_s=attempt_s,
            root_s=attempt_s + settled_s + FENCE_ROOM_S,
            own_stop_s=own_stop_s,
            # The gate stops the robot once, and the root stops it once more after it has killed the wire process.
            end_s=own_stop_s + attempt_s + 2 * settled_s + FENCE_ROOM_S,
        )


def settle_s(safe_s: float, late_s: float) -> float:
    """Return how much longer a stop takes if an earlier request may still take effect for ``late_s`` seconds. This
    is the sum of ``late_s`` and the time of one more attempt to stop the robot."""
    return late_s + safe_s if late_s else 0.0
