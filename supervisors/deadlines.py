"""How long to wait for a stop.

A deadline is the time that a stop may take by the driver (``Timing.safe_s``) and some margin. If an
earlier request may still take effect, the wait for it is added (``settle_s``).

A robot may need long to be safe, as a drone that lands. Its wire must not be fenced meanwhile, since
the stop channel would begin the landing anew.
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
    """For the gate's reply to a stop."""
    attempt_s: float
    """For one attempt of a stop channel. One that takes longer hangs."""
    root_s: float
    """For the root's reply to a stop: it fences the wire and makes an attempt itself."""
    own_stop_s: float
    """For the wire's own stop when the root ends. Then the root fences it."""
    end_s: float
    """For the root's end."""

    @classmethod
    def of(cls, safe_s: float, late_s: float = 0.0) -> StopDeadlines:
        """Return the deadlines of a robot.

        Args:
            safe_s: ``Timing.safe_s``.
            late_s: ``Driver.late_s``. The results ``attempt_s`` and ``own_stop_s`` do not include it.
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
            # Once for the gate's own stop, and once more from the fence on.
            end_s=own_stop_s + attempt_s + 2 * settled_s + FENCE_ROOM_S,
        )


def settle_s(safe_s: float, late_s: float) -> float:
    """Return how much longer a stop takes if a request may still take effect for ``late_s``: that time
    and one more attempt."""
    return late_s + safe_s if late_s else 0.0
