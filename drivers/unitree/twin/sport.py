"""Simulate the sport service of a Go2 or a B2."""

from __future__ import annotations

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

from .gait import POSTURE_S, REST, Gait, Pose

_WAYS: dict[int, tuple[frozenset[int], int]] = {
    rpc.BALANCE_STAND: (STANDING, BALANCE),
    rpc.STAND_UP: (STANDING | ON_THE_FLOOR, LOCK),
    rpc.STAND_DOWN: (STANDING, LIE),
    rpc.RECOVERY_STAND: (STANDING | ON_THE_FLOOR, BALANCE),
    rpc.SIT: (STANDING, SIT),
    rpc.RISE_SIT: (frozenset((SIT,)), BALANCE),
}
"""Request -> the modes in which it is carried out, and the mode in which the robot is afterwards."""


class SportGait(Gait):
    """The simulated service. It reports each new mode to ``note``, as ``gait`` with the name."""

    def __init__(self, note: Callable[[str, str], None], keeps_s: float, sits: bool) -> None:
        self._sits = sits
        super().__init__(note, keeps_s)

    @property
    def first_mode(self) -> int:
        return BALANCE

    @property
    def walks(self) -> bool:
        return self.mode in WALKING

    @property
    def pose(self) -> Pose:
        if self.next_mode == DAMPING:
            return Pose.BRAKED
        return Pose.DOWN if self.next_mode in (LIE, SIT) else Pose.UP

    def order(self, api: int, parameter: dict[str, Any]) -> tuple[int, Any]:
        if api == rpc.MOVE:
            twist = float(parameter["x"]), float(parameter["y"]), float(parameter["z"])
            if self._move(twist) and any(twist):
                self.become(LOCOMOTION)
        elif api == rpc.STOP_MOVE:
            self._move(REST)
            if self.mode == LOCOMOTION:
                self.become(BALANCE)
        elif api == rpc.DAMP:
            self._next = None
            self._turn(REST)
            self.become(DAMPING)
        elif api in _WAYS and (self._sits or api not in (rpc.SIT, rpc.RISE_SIT)):
            modes, then = _WAYS[api]
            if self.mode in modes and self._next is None and self.mode != then:
                self._turn(REST)
                self._begin(then)
        else:
            return rpc.NOT_IMPLEMENTED, None
        return rpc.OK, None

    def _begin(self, mode: int) -> None:
        """Begin to change to a mode. Getting up or down takes ``POSTURE_S``. Other changes take no time."""
        floor = frozenset((LIE, DAMPING, SIT))
        if (mode in floor) == (self.mode in floor):
            self.become(mode)
            return
        self._next = self._now_s + POSTURE_S, mode
        if mode == BALANCE:
            self.become(RECOVERY)

    def become(self, mode: int) -> None:
        if mode != self.mode:
            self.mode = mode
            self._note("gait", SPORT_MODES[mode])
