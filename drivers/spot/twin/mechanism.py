"""Simulate the body behind the twin's services: it stands up, walks and sits, and its arm follows."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

from strands_actors.drivers.common.physics.body import Hand
from strands_actors.drivers.spot.protocol import Motors
from strands_actors.drivers.spot.robots import ARM, CLAW

_STEP_S = 0.005
_LONGEST_S = 0.25
"""Longest time that is simulated at once after a pause. The rest of a longer pause is skipped."""

REST = (0.0, 0.0, 0.0)
Twist = tuple[float, float, float]
JOINTS = (*ARM, CLAW)


class Mechanism:
    def __init__(self, table: Mapping[str, Any], now_s: Callable[[], float]) -> None:
        self._table = table
        self._now_s = now_s
        self._seen_s = now_s()
        self.time_s = 0.0
        self.reset()

    def reset(self) -> None:
        """Put the robot where it began: sitting, motors off, the arm stowed."""
        self.hand = Hand.NONE
        self.motors = Motors.OFF
        self.up = 0.0
        """How far the robot has stood up: 0 sits, 1 stands."""
        self.wants_up = False
        self._cuts_when_down = False
        self._on_in_s = 0.0
        self.told: Twist = REST
        self.runs: Twist = REST
        self._ends_s = math.inf
        self.x_m = self.y_m = self.yaw_rad = 0.0
        self.joints = [float(value) for value in self._table["home_rad"]]
        self.speeds = [0.0] * len(self.joints)
        self._goal = list(self.joints)
        self.stuck = False

    # -- commands

    def power_on(self, at_once: bool = False) -> None:
        self.pass_time()
        if self.motors is Motors.OFF:
            self.motors = Motors.ON if at_once else Motors.POWERING_ON
            self._on_in_s = float(self._table["power_on_s"])

    def cut(self) -> None:
        """Switch motors off at once, in any pose. A standing robot falls."""
        self.pass_time()
        self._switch_off()

    def _switch_off(self) -> None:
        self.motors = Motors.OFF
        self.halt()
        self.up, self.wants_up, self._cuts_when_down = 0.0, False, False
        self.hand = Hand.NONE

    def settle(self) -> None:
        """Sit, then switch motors off."""
        self.pass_time()
        self.halt()
        self.wants_up, self._cuts_when_down = False, True
        if self.motors is not Motors.ON:
            self._switch_off()

    def stand(self, hand: Hand) -> None:
        self.pass_time()
        self.halt()
        self.wants_up, self._cuts_when_down = True, False
        self.hand = hand

    def sit(self) -> None:
        self.pass_time()
        self.halt()
        self.wants_up = False

    def halt(self) -> None:
        """Stand still, with the arm at rest."""
        self.told, self._ends_s = REST, math.inf
        self._goal = list(self.joints)

    def walk(self, twist: Twist, for_s: float, hand: Hand) -> None:
        """Walk with this twist for ``for_s`` seconds. A sitting robot stands up first."""
        self.pass_time()
        self.wants_up, self._cuts_when_down = True, False
        self.told, self.hand = twist, hand
        self._ends_s = self.time_s + for_s

    def reach(self, goals_rad: Mapping[int, float], hand: Hand) -> None:
        """Move joints of the arm, by index. A goal outside a range is limited to the range."""
        self.pass_time()
        self.hand = hand
        ranges = list(self._table["joints_rad"].values())
        for index, goal in goals_rad.items():
            low, high = ranges[index]
            self._goal[index] = min(max(goal, low), high)

    # -- state

    @property
    def stands(self) -> bool:
        return self.up >= 1.0

    @property
    def arrived(self) -> bool:
        """Return True if the arm is at its goal."""
        return self.joints == self._goal

    @property
    def walks(self) -> bool:
        """Return True if the robot is commanded to move, or still moves."""
        return self.told != REST or any(abs(speed) > 1e-9 for speed in self.runs)

    @property
    def height_m(self) -> float:
        low, high = float(self._table["sit_m"]), float(self._table["stand_m"])
        return low + (high - low) * self.up

    @property
    def leg_rad(self) -> tuple[float, float, float]:
        """Return the angles of each leg: two of the hip, one of the knee."""
        low, high = self._table["sit_leg_rad"], self._table["stand_leg_rad"]
        hx, hy, kn = (a + (b - a) * self.up for a, b in zip(low, high, strict=True))
        return hx, hy, kn

    def pass_time(self) -> None:
        """Advance to the present time."""
        now_s = self._now_s()
        passed_s, self._seen_s = now_s - self._seen_s, now_s
        late_s = passed_s - _LONGEST_S
        if late_s > 0:
            self.time_s += late_s  # A twist ends on time, even during a pause.
        self.run(min(passed_s, _LONGEST_S))

    def run(self, seconds: float) -> None:
        """Advance by so many seconds."""
        while seconds > 0:
            step_s = min(seconds, _STEP_S)
            seconds -= step_s
            self._step(step_s)

    def _step(self, step_s: float) -> None:
        self.time_s += step_s
        table = self._table
        if self.motors is Motors.POWERING_ON:
            self._on_in_s -= step_s
            if self._on_in_s <= 0:
                self.motors = Motors.ON
        if self.time_s >= self._ends_s:
            self.told, self._ends_s = REST, math.inf
            self.hand = Hand.NONE if self.hand is Hand.WIRE else self.hand
        if self.motors is Motors.ON and not self.stuck:
            rise_s = float(table["stand_s"] if self.wants_up else table["sit_s"])
            self.up = _towards(self.up, float(self.wants_up), step_s / rise_s)
            if self._cuts_when_down and self.up == 0.0:
                self._switch_off()
        moving = self.motors is Motors.ON and self.stands and not self.stuck
        goal_speeds = self.told if moving else REST
        ramp = float(table["ramp_m_s2"]) * step_s
        vx, vy, wz = (_towards(run, goal, ramp) for run, goal in zip(self.runs, goal_speeds, strict=True))
        self.runs = vx, vy, wz
        ahead, across = math.cos(self.yaw_rad), math.sin(self.yaw_rad)
        self.x_m += (vx * ahead - vy * across) * step_s
        self.y_m += (vx * across + vy * ahead) * step_s
        self.yaw_rad += wz * step_s
        most = float(table["arm_rad_s"]) * step_s if self.motors is Motors.ON and not self.stuck else 0.0
        for index, goal in enumerate(self._goal):
            before = self.joints[index]
            self.joints[index] = _towards(before, goal, most)
            self.speeds[index] = (self.joints[index] - before) / step_s


def _towards(now: float, goal: float, most: float) -> float:
    return now + max(-most, min(most, goal - now))
