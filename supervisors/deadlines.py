"""How long those who order a stop wait: what the driver says that one may take (``Timing.safe_s``),
and some room; and, where something that was asked for before may still take effect, what they wait
for that (``settle_s``).

A wire that takes long because its robot does (a drone that lands) must not be fenced for it: the
stop channel would begin anew what the wire has begun.
"""

from __future__ import annotations

from typing import NamedTuple

from strands_actors.contract.driver import Timing

ROOM_S = 0.5
"""For messages, and a process that waits for a processor."""
FENCE_ROOM_S = 1.0
"""For a process to be killed, and its end to be seen."""
OWN_STOP_S = 0.25
"""A tree that ends gives the wire's own stop so long, of a robot that is safe as quickly as
most."""
USUAL_SAFE_S = Timing(control_hz=1.0, keepalive_s=1.0).safe_s


class StopDeadlines(NamedTuple):
    longer_s: float
    """How much longer than most robots this one needs until it is safe."""
    gate_s: float
    """Who asked the gate."""
    attempt_s: float
    """One attempt by a stop channel; who takes longer hangs."""
    root_s: float
    """Who asked the root, which fences the wire and makes an attempt of its own."""
    own_stop_s: float
    """The root that ends, for the wire's own stop, before it fences."""
    end_s: float
    """Who asked the root to end."""

    @classmethod
    def of(cls, safe_s: float, late_s: float = 0.0) -> StopDeadlines:
        """Return the deadlines of a robot.

        Args:
            safe_s: ``Timing.safe_s``.
            late_s: ``Driver.late_s``. ``attempt_s`` and ``own_stop_s`` are without it.
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
    """Return how much longer a stop takes when something may take effect for ``late_s`` more: until
    that time has passed, and one more attempt."""
    return late_s + safe_s if late_s else 0.0
