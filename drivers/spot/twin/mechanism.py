"""Simulate Spot's body: it stands up, walks and sits, and its arm follows its goals."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

from strands_actors.drivers.common.physics.body import Commander
from strands_actors.drivers.spot.protocol import Motors
from strands_actors.drivers.spot.robots import ARM, CLAW

_STEP_S = 0.005
_LONGEST_S = 0.25
"""Longest time that is simulated at once after a pause. The rest of a longer pause is skipped."""

STOWED, DEPLOYED = 1, 2
"""Values of ``stow_state`` in the robot's state."""

REST = (0.0, 0.0, 0.0)
Twist = tuple[float, float, float]
JOINTS = (*ARM, CLAW)


class Mechanism:
    def __init__(self, table: Mapping[str, Any], now_s: Callable[[], float]) -> None:
        self._table = table
        self._now_s = now_s
        self._updated_s = now_s()
        self.time_s = 0.0
        self.reset()

    def reset(self) -> None:
        """Put the robot back at its start: sitting, motors off, the arm stowed."""
        self.commander = Commander.NONE
        self.motors = Motors.OFF
        self.up = 0.0
        """How far the robot has stood up: 0 sits, 1 stands."""
        self.wants_up = False
        self._cuts_when_down = False
        self._on_in_s = 0.0
        self.target_twist: Twist = REST
        self.present_twist: Twist = REST
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
        self.commander = Commander.NONE

    def settle(self) -> None:
        """Sit down, then switch the motors off."""
        self.pass_time()
        self.halt()
        self.wants_up, self._cuts_when_down = False, True
        if self.motors is not Motors.ON:
            self._switch_off()

    def stand(self, commander: Commander) -> None:
        self.pass_time()
        self.halt()
        self.wants_up, self._cuts_when_down = True, False
        self.commander = commander

    def sit(self) -> None:
        self.pass_time()
        self.halt()
        self.wants_up = False

    def halt(self) -> None:
        """Stop walking and stop the arm. The robot stands."""
        self.target_twist, self._ends_s = REST, math.inf
        self._goal = list(self.joints)

    def walk(self, twist: Twist, for_s: float, commander: Commander) -> None:
        """Walk with this twist for ``for_s`` seconds. A sitting robot stands up first."""
        self.pass_time()
        self.wants_up, self._cuts_when_down = True, False
        self.target_twist, self.commander = twist, commander
        self._ends_s = self.time_s + for_s

    def reach(self, goals_rad: Mapping[int, float], commander: Commander) -> None:
        """Move joints of the arm, by index. A goal outside a joint's range becomes the nearest
        limit."""
        self.pass_time()
        self.commander = commander
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

    def arm_state(self) -> dict[str, float]:
        """Return the message with the state of arm and gripper. The claw opens towards its lower limit."""
        *arm, claw = self.joints
        *home, _ = self._table["home_rad"]
        open_rad = next(reversed(self._table["joints_rad"].values()))[0]
        return {
            "stow_state": STOWED if arm == home else DEPLOYED,
            "gripper_open_percentage": 100.0 * claw / open_rad,
        }

    @property
    def walks(self) -> bool:
        """Return True if the robot is commanded to move, or still moves."""
        return self.target_twist != REST or any(abs(speed) > 1e-9 for speed in self.present_twist)

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
        """Advance the simulation to the present time."""
        now_s = self._now_s()
        passed_s, self._updated_s = now_s - self._updated_s, now_s
        late_s = passed_s - _LONGEST_S
        if late_s > 0:
            # Count the time of a long pause, so that a twist ends on time. The motion of the pause is left out.
            self.time_s += late_s
        self.run(min(passed_s, _LONGEST_S))

    def run(self, seconds: float) -> None:
        """Advance the simulation by ``seconds``."""
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
            self.target_twist, self._ends_s = REST, math.inf
            self.commander = Commander.NONE if self.commander is Commander.WIRE else self.commander
        if self.motors is Motors.ON and not self.stuck:
            rise_s = float(table["stand_s"] if self.wants_up else table["sit_s"])
            self.up = _towards(self.up, float(self.wants_up), step_s / rise_s)
            if self._cuts_when_down and self.up == 0.0:
                self._switch_off()
        moving = self.motors is Motors.ON and self.stands and not self.stuck
        goal_speeds = self.target_twist if moving else REST
        ramp = float(table["ramp_m_s2"]) * step_s
        vx, vy, wz = (_towards(run, goal, ramp) for run, goal in zip(self.present_twist, goal_speeds, strict=True))
        self.present_twist = vx, vy, wz
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
