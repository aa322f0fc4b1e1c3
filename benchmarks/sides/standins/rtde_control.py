"""A fake of ur-rtde's control interface. It stores the time and the elbow's value of every setpoint in memory."""

from __future__ import annotations

import time
from collections.abc import Sequence

FRAMES: list[tuple[int, float]] = []
STOPS: list[int] = []


class RTDEControlInterface:
    def __init__(self, host: str, frequency: float | None = None) -> None:
        pass

    # The name of the method is the one in the SDK.
    def servoJ(
        self, q: Sequence[float], speed: float, acceleration: float, period: float, lookahead: float, gain: float
    ) -> bool:
        FRAMES.append((time.monotonic_ns(), q[2]))
        return True

    def servoStop(self, deceleration: float = 10.0) -> bool:
        STOPS.append(time.monotonic_ns())
        return True

    def disconnect(self) -> None:
        pass
