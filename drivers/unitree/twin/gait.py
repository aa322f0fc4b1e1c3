"""How the onboard controller of a robot walks and changes its posture, as its service shows it: modes,
velocity and odometry. It knows no network and no physics. ``sport.py`` and ``loco.py`` take the
requests of the two services.

As the robot does, it answers success to a velocity that it ignores: sitting, lying, with locked
joints, while it gets up.
"""

from __future__ import annotations

import json
import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from enum import Enum
from typing import Any

POSTURE_S = 1.0
"""How long a posture takes."""
REST = (0.0, 0.0, 0.0)


class Pose(Enum):
    """What the controller does with the body."""

    UP = "up"
    DOWN = "down"
    BRAKED = "braked"
    LIMP = "limp"


class Gait(ABC):
    """``note(kind, text)`` hears of ``twist``, and of a change of mode."""

    def __init__(self, note: Callable[[str, str], None], keeps_s: float) -> None:
        """``keeps_s``: a velocity ends by itself after so long; 0: never."""
        self._note = note
        self._keeps_s = keeps_s
        self.reset()

    def reset(self) -> None:
        self.mode = self.first_mode
        self.twist = REST
        self.position = [0.0, 0.0]
        self.heading_rad = 0.0
        self._until_s = math.inf
        self._next: tuple[float, int] | None = None  # when which mode begins
        self._now_s = 0.0

    @property
    @abstractmethod
    def first_mode(self) -> int:
        """The mode that it wakes up in."""

    @property
    @abstractmethod
    def walks(self) -> bool:
        """Whether its mode carries out a velocity."""

    @property
    @abstractmethod
    def pose(self) -> Pose:
        """What it does with the body, or is about to."""

    @abstractmethod
    def order(self, api: int, parameter: dict[str, Any]) -> tuple[int, Any]:
        """Return code and data of the answer. Raise ``KeyError`` or ``TypeError`` for a parameter
        that is none."""

    @abstractmethod
    def become(self, mode: int) -> None:
        """Be in a mode, at once, and note it when it is another."""

    @property
    def next_mode(self) -> int:
        """The mode that it is in, or on its way to."""
        return self.mode if self._next is None else self._next[1]

    @property
    def share(self) -> float:
        """How far it is on its way there."""
        return 1.0 if self._next is None else 1.0 - max(0.0, self._next[0] - self._now_s) / POSTURE_S

    def advance(self, now_s: float) -> float:
        """Let time pass. Return for how long it has walked."""
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
        """Return whether it walks so. ``duration_s``: as the request has it."""
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
