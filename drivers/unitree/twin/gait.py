"""The onboard controller of a Go2 or a B2 as its sport service shows it: modes, postures, velocity and
odometry. It knows no network and no physics.

As the robot does, it answers success to a velocity that it ignores: sitting, lying, with locked
joints, while it gets up.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from typing import Any

from strands_actors.drivers.unitree import rpc
from strands_actors.drivers.unitree.walking.sport import (
    BALANCE,
    DAMPING,
    LIE,
    LOCK,
    LOCOMOTION,
    ON_THE_FLOOR,
    RECOVERY,
    SIT,
    SPORT_MODES,
    STANDING,
    WALKING,
)

POSTURE_S = 1.0
"""How long a posture takes."""
REST = (0.0, 0.0, 0.0)

_WAYS: dict[int, tuple[frozenset[int], int]] = {
    rpc.BALANCE_STAND: (STANDING, BALANCE),
    rpc.STAND_UP: (STANDING | ON_THE_FLOOR, LOCK),
    rpc.STAND_DOWN: (STANDING, LIE),
    rpc.RECOVERY_STAND: (STANDING | ON_THE_FLOOR, BALANCE),
    rpc.SIT: (STANDING, SIT),
    rpc.RISE_SIT: (frozenset((SIT,)), BALANCE),
}
"""Request to the modes in which it is not ignored, and what it ends in."""


class Gait:
    """``note(kind, text)`` hears of ``gait`` (a mode, by its name) and ``twist``."""

    def __init__(self, note: Callable[[str, str], None], keeps_s: float, sits: bool) -> None:
        """``keeps_s``: a velocity ends by itself after so long; 0: never."""
        self._note = note
        self._keeps_s = keeps_s
        self._sits = sits
        self.reset()

    def reset(self) -> None:
        self.mode = BALANCE
        self.twist = REST
        self.position = [0.0, 0.0]
        self.heading_rad = 0.0
        self._until_s = math.inf
        self._next: tuple[float, int] | None = None  # when which mode begins
        self._now_s = 0.0

    @property
    def next_mode(self) -> int:
        """The mode that it is in, or on its way to."""
        return self.mode if self._next is None else self._next[1]

    @property
    def share(self) -> float:
        """How far it is on its way there."""
        return 1.0 if self._next is None else 1.0 - max(0.0, self._next[0] - self._now_s) / POSTURE_S

    def order(self, api: int, parameter: dict[str, Any]) -> tuple[int, Any]:
        """Return code and data of the answer. Raise ``KeyError`` or ``TypeError`` for a parameter
        that is none."""
        if api == rpc.MOVE:
            self._move((float(parameter["x"]), float(parameter["y"]), float(parameter["z"])))
        elif api == rpc.STOP_MOVE:
            self._move(REST)
            if self.mode == LOCOMOTION:
                self._become(BALANCE)
        elif api == rpc.DAMP:
            self._next = None
            self._turn(REST)
            self._become(DAMPING)
        elif api in _WAYS and (self._sits or api not in (rpc.SIT, rpc.RISE_SIT)):
            modes, then = _WAYS[api]
            if self.mode in modes and self._next is None and self.mode != then:
                self._turn(REST)
                self._begin(then)
        else:
            return rpc.NOT_IMPLEMENTED, None
        return rpc.OK, None

    def advance(self, now_s: float) -> float:
        """Let time pass. Return for how long it has walked."""
        passed_s = min(now_s - self._now_s, 0.25) if self._now_s else 0.0
        self._now_s = now_s
        if self._next is not None and now_s >= self._next[0]:
            _, mode = self._next
            self._next = None
            self._become(mode)
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

    def _move(self, twist: tuple[float, float, float]) -> None:
        if self.mode not in WALKING or self._next is not None:
            return
        self._until_s = self._now_s + self._keeps_s if self._keeps_s and any(twist) else math.inf
        self._turn(twist)
        if any(twist):
            self._become(LOCOMOTION)

    def _turn(self, twist: tuple[float, float, float]) -> None:
        if twist != self.twist:
            self._note("twist", json.dumps(twist))
        self.twist = twist
        if twist == REST:
            self._until_s = math.inf

    def _begin(self, mode: int) -> None:
        """Unlocking the joints takes no time; getting up and down does."""
        floor = frozenset((LIE, DAMPING, SIT))
        if (mode in floor) == (self.mode in floor):
            self._become(mode)
            return
        self._next = self._now_s + POSTURE_S, mode
        if mode == BALANCE:
            self._become(RECOVERY)

    def _become(self, mode: int) -> None:
        if mode != self.mode:
            self.mode = mode
            self._note("gait", SPORT_MODES[mode])
