"""The body behind the twin's services: it stands up, walks and sits, and its arm follows."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

from strands_actors.drivers.common.simulation_control.body import Hand
from strands_actors.drivers.spot.protocol import Motors
from strands_actors.drivers.spot.robots import ARM, CLAW

_STEP_S = 0.005
_LONGEST_S = 0.25
"""Time that nobody looked at is passed when somebody does, up to this: a longer stall is
dropped."""

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
        """Sitting where it began, motors off, the arm stowed."""
        self.hand = Hand.NONE
        self.motors = Motors.OFF
        self.up = 0.0
        """How far it stands: 0 sits, 1 stands."""
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

    # -- what it is told

    def power_on(self, at_once: bool = False) -> None:
        self.pass_time()
        if self.motors is Motors.OFF:
            self.motors = Motors.ON if at_once else Motors.POWERING_ON
            self._on_in_s = float(self._table["power_on_s"])

    def cut(self) -> None:
        """Motors off at once, wherever it is: what stands falls."""
        self.pass_time()
        self._switch_off()

    def _switch_off(self) -> None:
        self.motors = Motors.OFF
        self.halt()
        self.up, self.wants_up, self._cuts_when_down = 0.0, False, False
        self.hand = Hand.NONE

    def settle(self) -> None:
        """Sit, then motors off."""
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
        """Stand still, arm and all."""
        self.told, self._ends_s = REST, math.inf
        self._goal = list(self.joints)

    def walk(self, twist: Twist, for_s: float, hand: Hand) -> None:
        """Walk so, for so long; a robot that sits stands up for it."""
        self.pass_time()
        self.wants_up, self._cuts_when_down = True, False
        self.told, self.hand = twist, hand
        self._ends_s = self.time_s + for_s

    def reach(self, goals_rad: Mapping[int, float], hand: Hand) -> None:
        """Move joints of the arm, by index; what is past a range stays at its end."""
        self.pass_time()
        self.hand = hand
        ranges = list(self._table["joints_rad"].values())
        for at, goal in goals_rad.items():
            low, high = ranges[at]
            self._goal[at] = min(max(goal, low), high)

    # -- what it is

    @property
    def stands(self) -> bool:
        return self.up >= 1.0

    @property
    def arrived(self) -> bool:
        """Whether the arm is where it was told to be."""
        return self.joints == self._goal

    @property
    def walks(self) -> bool:
        """Whether it is told to move, or still does."""
        return self.told != REST or any(abs(speed) > 1e-9 for speed in self.runs)

    @property
    def height_m(self) -> float:
        low, high = float(self._table["sit_m"]), float(self._table["stand_m"])
        return low + (high - low) * self.up

    @property
    def leg_rad(self) -> tuple[float, float, float]:
        """Hip twice, and knee, of each leg."""
        low, high = self._table["sit_leg_rad"], self._table["stand_leg_rad"]
        hx, hy, kn = (a + (b - a) * self.up for a, b in zip(low, high, strict=True))
        return hx, hy, kn

    def pass_time(self) -> None:
        """Until now."""
        now_s = self._now_s()
        passed_s, self._seen_s = now_s - self._seen_s, now_s
        late_s = passed_s - _LONGEST_S
        if late_s > 0:
            self.time_s += late_s  # a twist ends although nobody looked
        self.run(min(passed_s, _LONGEST_S))

    def run(self, seconds: float) -> None:
        """Let so much time pass."""
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
        wanted = self.told if moving else REST
        ramp = float(table["ramp_m_s2"]) * step_s
        vx, vy, wz = (_towards(run, want, ramp) for run, want in zip(self.runs, wanted, strict=True))
        self.runs = vx, vy, wz
        ahead, across = math.cos(self.yaw_rad), math.sin(self.yaw_rad)
        self.x_m += (vx * ahead - vy * across) * step_s
        self.y_m += (vx * across + vy * ahead) * step_s
        self.yaw_rad += wz * step_s
        most = float(table["arm_rad_s"]) * step_s if self.motors is Motors.ON and not self.stuck else 0.0
        for at, goal in enumerate(self._goal):
            before = self.joints[at]
            self.joints[at] = _towards(before, goal, most)
            self.speeds[at] = (self.joints[at] - before) / step_s


def _towards(now: float, wanted: float, most: float) -> float:
    return now + max(-most, min(most, wanted - now))
