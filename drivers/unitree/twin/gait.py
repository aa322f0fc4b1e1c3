"""The gait of a robot's onboard controller, as its service shows it: modes, velocity and odometry. It knows
no network and no physics. ``sport.py`` and ``loco.py`` handle the requests of the two services.

Like the robot, it answers success to a velocity that it ignores: while it sits, lies, gets up, or stands with
locked joints.
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
    """How the controller drives the body."""

    UP = "up"
    DOWN = "down"
    BRAKED = "braked"
    LIMP = "limp"


class Gait(ABC):
    """The base of both gaits. ``note(kind, text)`` is called with ``twist``, and with a change of mode."""

    def __init__(self, note: Callable[[str, str], None], keeps_s: float) -> None:
        """``keeps_s``: a velocity ends by itself after this time; 0: never."""
        self._note = note
        self._keeps_s = keeps_s
        self.reset()

    def reset(self) -> None:
        self.mode = self.first_mode
        self.twist = REST
        self.position = [0.0, 0.0]
        self.heading_rad = 0.0
        self._until_s = math.inf
        self._next: tuple[float, int] | None = None  # when the next mode begins, and which one
        self._now_s = 0.0

    @property
    @abstractmethod
    def first_mode(self) -> int:
        """The mode after a start."""

    @property
    @abstractmethod
    def walks(self) -> bool:
        """True if the present mode carries out a velocity."""

    @property
    @abstractmethod
    def pose(self) -> Pose:
        """How it drives the body, or is about to."""

    @abstractmethod
    def order(self, api: int, parameter: dict[str, Any]) -> tuple[int, Any]:
        """Carry out a request. Return code and data of the answer.

        Raises:
            KeyError: The parameter lacks a key.
            TypeError: The parameter has a wrong type.
        """

    @abstractmethod
    def become(self, mode: int) -> None:
        """Change to a mode at once, and note it if it is another one."""

    @property
    def next_mode(self) -> int:
        """The mode to which it is changing, or else the present one."""
        return self.mode if self._next is None else self._next[1]

    @property
    def share(self) -> float:
        """The share of the present change that is done, 0 to 1."""
        return 1.0 if self._next is None else 1.0 - max(0.0, self._next[0] - self._now_s) / POSTURE_S

    def advance(self, now_s: float) -> float:
        """Let time pass. Return for how many seconds it has walked."""
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
        """Begin a velocity. Return False if it is ignored. ``duration_s``: from the request."""
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
