"""Simulate how an onboard controller walks, as seen by its clients: modes, velocity and odometry.

This module has no network and no physics. ``sport.py`` and ``loco.py`` handle the requests of the two services.

A real robot ignores a velocity while it sits, lies, gets up, or stands with locked joints, but still answers
success. So does this simulation.
"""

from __future__ import annotations

import json
import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from enum import Enum
from typing import Any

POSTURE_S = 1.0
"""Duration of a change of posture."""
REST = (0.0, 0.0, 0.0)


class Pose(Enum):
    """What the onboard controller does with the body: holds it up or down, brakes the joints, or lets them go."""

    UP = "up"
    DOWN = "down"
    BRAKED = "braked"
    LIMP = "limp"


class Gait(ABC):
    """The common base of the two simulated walking services.

    It calls ``note(kind, text)`` at each new velocity (kind ``twist``) and at each change of mode.
    """

    def __init__(self, note: Callable[[str, str], None], keeps_s: float) -> None:
        """Start in the mode ``first_mode``. A velocity ends by itself after ``keeps_s`` seconds (0 for never)."""
        self._note = note
        self._keeps_s = keeps_s
        self.reset()

    def reset(self) -> None:
        self.mode = self.first_mode
        self.twist = REST
        self.position = [0.0, 0.0]
        self.heading_rad = 0.0
        self._until_s = math.inf
        self._next: tuple[float, int] | None = None  # Time at which the mode changes, and the next mode.
        self._now_s = 0.0

    @property
    @abstractmethod
    def first_mode(self) -> int:
        """The mode in which the controller starts."""

    @property
    @abstractmethod
    def walks(self) -> bool:
        """True if the robot walks at a velocity that it receives in the present mode."""

    @property
    @abstractmethod
    def pose(self) -> Pose:
        """The pose into which the controller has brought the body, or is bringing it."""

    @abstractmethod
    def order(self, api: int, parameter: dict[str, Any]) -> tuple[int, Any]:
        """Carry out a request. Return the code and the data of the answer.

        Raises:
            KeyError: The parameter lacks a key.
            TypeError: The parameter has a wrong type.
        """

    @abstractmethod
    def become(self, mode: int) -> None:
        """Change to a mode at once. Report it to ``note`` if it differs from the present mode."""

    @property
    def next_mode(self) -> int:
        """The mode at the end of the present change of posture. Without a change, the present mode."""
        return self.mode if self._next is None else self._next[1]

    @property
    def share(self) -> float:
        """Progress of the present change of posture, 0 to 1. Without a change it is 1."""
        return 1.0 if self._next is None else 1.0 - max(0.0, self._next[0] - self._now_s) / POSTURE_S

    def advance(self, now_s: float) -> float:
        """Advance to the time ``now_s``. Return for how many seconds the robot has walked since the last call."""
        passed_s = min(now_s - self._now_s, 0.25) if self._now_s else 0.0
        self._now_s = now_s
        if self._next is not None and now_s >= self._next[0]:
            _, mode = self._next
            self._next = None
            self.become(mode)
        if now_s >= self._until_s:
            self._turn(REST)
        if self.twist == REST:
            return 0.0
        vx, vy, wz = self.twist
        cos, sin = math.cos(self.heading_rad), math.sin(self.heading_rad)
        self.position[0] += (cos * vx - sin * vy) * passed_s
        self.position[1] += (sin * vx + cos * vy) * passed_s
        self.heading_rad += wz * passed_s
        return passed_s

    def _move(self, twist: tuple[float, float, float], duration_s: float = math.inf) -> bool:
        """Begin to walk at a velocity, for at most ``duration_s``. Return False if the mode does not allow it."""
        if not self.walks or self._next is not None:
            return False
        lasts_s = min(duration_s, self._keeps_s) if self._keeps_s else math.inf
        self._until_s = self._now_s + lasts_s
        self._turn(twist)
        return True

    def _turn(self, twist: tuple[float, float, float]) -> None:
        if twist != self.twist:
            self._note("twist", json.dumps(twist))
        self.twist = twist
        if twist == REST:
            self._until_s = math.inf
