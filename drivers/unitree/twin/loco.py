"""Simulate the locomotion service of a G1 or an H1: a state machine with a number for each state.

As on a real robot, a request changes the number at once, although the body still moves into the new posture. A
request for a state that cannot follow the present one is ignored, but answered with success. Each request for a
velocity contains its duration.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from strands_actors.drivers.unitree import rpc
from strands_actors.drivers.unitree.walking.loco import DAMP, ZERO_TORQUE, LocoDialect

from .gait import POSTURE_S, REST, Gait, Pose
from .requests import ASK_BALANCE


class LocoGait(Gait):
    """The simulated service. It reports each new state to ``note``, as ``fsm`` with the number."""

    def __init__(self, note: Callable[[str, str], None], keeps_s: float, words: LocoDialect) -> None:
        self._words = words
        super().__init__(note, keeps_s)

    def reset(self) -> None:
        super().reset()
        self.tells_pose = (
            not self._words.opening_orders
        )  # True if the service answers requests for the robot's pose.
        self.balance_mode = 0

    @property
    def first_mode(self) -> int:
        return max(self._words.walks)

    @property
    def walks(self) -> bool:
        return self.mode in self._words.walks

    @property
    def pose(self) -> Pose:
        if self.mode == ZERO_TORQUE:
            return Pose.LIMP
        if self.mode in self._words.down:
            return Pose.DOWN
        return Pose.UP if self.walks or self.mode == self._words.stand else Pose.BRAKED

    def become(self, mode: int) -> None:
        if mode == self.mode:
            return
        self.mode = mode
        self._turn(REST)
        self._next = None
        self._note("fsm", str(mode))

    def order(self, api: int, parameter: dict[str, Any]) -> tuple[int, Any]:
        words = self._words
        if api == words.ask_mode:
            return rpc.OK, {"data": self.mode}
        if api == words.set_mode:
            return self._set(int(parameter["data"])), None
        if api == words.set_velocity:
            vx, vy, wz = map(float, parameter["velocity"])
            self._move((vx, vy, wz), float(parameter["duration"]))
            return rpc.OK, None
        if api == words.set_balance:
            self.balance_mode = int(parameter["data"])
            return rpc.OK, None
        if api == ASK_BALANCE[words.set_balance]:
            return rpc.OK, {"data": self.balance_mode}
        if words.ask_odometry and api == words.ask_odometry and self.tells_pose:
            heading = math.remainder(self.heading_rad, math.tau)
            return rpc.OK, {"x": self.position[0], "y": self.position[1], "z": heading}
        if any(api == order.api for order in words.opening_orders):
            self.tells_pose = True
            return rpc.OK, None
        return rpc.NOT_IMPLEMENTED, None

    def _set(self, mode: int) -> int:
        words = self._words
        if mode not in words.names:
            return rpc.NO_SUCH_FSM
        if mode == self.mode or not self._goes_to(mode):
            return rpc.OK
        self.become(mode)
        if mode == words.stand or mode in words.down:
            self._next = self._now_s + POSTURE_S, mode
        return rpc.OK

    def _goes_to(self, mode: int) -> bool:
        words = self._words
        if mode in (ZERO_TORQUE, DAMP):
            return True
        if mode in words.walks:
            return self.walks or (self.mode == words.stand and self._next is None)
        return self.mode != ZERO_TORQUE and (mode == words.stand or mode in words.down)
