"""Simulate the duck behind the simulated daemon: a base that walks in the plane by a twist, a head and a mouth
that follow their goals, legs that step, and skills that play for a while.

Only its motion is simulated, not forces. The duck does what it is commanded, unless it is held, sits, has fallen,
is relaxed or plays a skill. A relaxed duck sinks down [assumed: the real one collapses].

robotd smooths each twist before its policy gets it, and reports the smoothed twist as applied, also while no
policy drives the duck. So after a stop it approaches zero, and does not reach it for a minute.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from functools import cached_property
from typing import Any

from strands_actors.drivers.common.physics.body import TIMESTEP_S, Commander, Felt
from strands_actors.drivers.common.physics.stepped import PlanarBase, towards

from .protocol import HELD, HOMING, SIT_TOGGLE
from .robots import AXES, HEAD, POSE, TWIST

DEADMAN_S = 0.5

TICK_S, SMOOTHING = 0.02, 0.2
"""Period of robotd's loop, and the share of the way to a new twist that one of its ticks takes."""
STANDS = 0.05
"""Magnitude of a twist up to which the policy for standing drives the duck."""
ACTUATOR_RAD = math.pi
"""robotd limits the target of a joint to one turn, and reports it. It knows no narrower limits."""

_REST = (0.0, 0.0, 0.0)

_HIP_M, _LEG_M = 0.01, 0.11
"""From trunk to hip, and from hip to foot when stretched, as in ``model_rows``."""
_BENT_RAD, _FOLDED_RAD = 0.35, 0.785
_CADENCE_RAD_S, _STRIDE_RAD, _LIFT_RAD = 12.0, 0.25, 0.3
_MOUTH_RAD = 0.6


class Duck(PlanarBase):
    """The simulated duck. ``requested`` is the last twist, ``applied`` the smoothed one, and ``moves`` the duck's
    motion. A twist that is not repeated for ``deadman_s`` seconds counts as zero; with ``deadman_s`` 0 it never
    does."""

    axes = AXES

    def __init__(self, table: Mapping[str, Any], deadman_s: float, now_s: Callable[[], float]) -> None:
        self._table = table
        super().__init__(deadman_s, now_s)
        self.reset()

    def reset(self) -> None:
        """Restart as after switching the duck on: on its stand, powered, and driven by no policy."""
        self.commander = Commander.NONE
        self.mode = "walk"
        self.enabled = False
        self.powered = True
        self.sitting = False
        self.stuck = False
        self.requested: Sequence[float] = _REST
        self.applied: Sequence[float] = _REST
        self.moves: Sequence[float] = _REST
        self.fallen = self.picked_up = False
        self.head_rad: Sequence[float] = (0.0,) * len(HEAD)
        self.head_target: Sequence[float] = self.head_rad
        self.pose_target: Sequence[float] = (0.0,) * len(POSE)
        self.mouth = 0.0
        self.skill = ""
        self.x_m = self.y_m = self.yaw_rad = self._phase = 0.0
        self._commanded_s = self.now_s()
        self._skill_until_s = self._up_at_s = 0.0

    @property
    def policy(self) -> str:
        """Return the name of the present policy, as robotd reports it."""
        if not self.enabled or not self.powered:
            return HELD
        if self.now_s() < self._up_at_s:
            return HOMING
        if self.sitting:
            return "sit"
        if self.skill:
            return "rise" if self.skill == SIT_TOGGLE else self.skill
        return "walk" if math.hypot(*self.applied) > STANDS else "stand"

    @property
    def is_driven(self) -> bool:
        return self.policy not in (HELD, HOMING)

    @property
    def limited_by(self) -> list[str]:
        """Return why robotd does not do what was commanded, in its words."""
        limits = {
            "deadman": self.is_overdue,
            "range": any(abs(rad) > ACTUATOR_RAD for rad in self.head_target),
            "fallen": self.fallen,
        }
        return [word for word, holds in limits.items() if holds]

    @property
    def is_overdue(self) -> bool:
        # Also without a commander: after a twist of zero.
        return self.commander is not Commander.SIM and 0 < self._watchdog_s < self.now_s() - self._commanded_s

    # -- commands

    def walk(self, twist: Sequence[float], commander: Commander) -> None:
        self.pass_time()
        self.requested, self._commanded_s = tuple(twist), self.now_s()
        self.commander = commander if any(twist) else Commander.NONE if commander is Commander.WIRE else commander

    def enable(self, on: bool) -> None:
        """Stand up if the duck is limp, and let a walking policy drive it. With ``on=False`` hold the pose."""
        self.pass_time()
        if on and not self.enabled:
            self._up_at_s = self.now_s() + float(self._table["rise_s"])
            self.powered = True
        self.enabled = on

    def power(self, on: bool) -> None:
        self.pass_time()
        self.powered = on
        if not on:
            self.enabled = self.sitting = False
            self.skill = ""

    def do(self, skill: str) -> str:
        """Begin a skill. Return the reason if it cannot begin, otherwise an empty text."""
        self.pass_time()
        if not self.is_driven:
            return "no policy drives the robot: enable it first"
        if self.skill:
            return "already standing up" if self.skill == SIT_TOGGLE else f"{self.skill} is playing"
        if skill == SIT_TOGGLE:
            self.sitting = not self.sitting
            if self.sitting:
                # It may stand up again at any time.
                return ""
        elif self.sitting:
            return "the robot sits"
        self.skill, self._skill_until_s = skill, self.now_s() + float(self._table["skill_s"])
        return ""

    # -- time

    def pass_time(self) -> None:
        if self.is_overdue:
            self.commander = Commander.NONE
        super().pass_time()

    def _step(self, step_s: float) -> None:
        table = self._table
        if self.skill and self.now_s() >= self._skill_until_s:
            self.skill = ""
        by_simulation = self.commander is Commander.SIM
        driven = (by_simulation or self.is_driven) and not (self.fallen or self.stuck)
        gated = _REST if self.is_overdue else self.requested
        self.applied = self._ramped(gated, step_s) if by_simulation else _smoothed(self.applied, gated, step_s)
        stands = not by_simulation and self.mode == "walk" and math.hypot(*self.applied) <= STANDS
        goes = driven and not (self.skill or self.sitting or stands)
        self.moves = self.applied if goes else _REST
        vx, vy, vyaw = self.moves
        self._roll(vx, vy, vyaw, step_s)
        self.yaw_rad = math.remainder(self.yaw_rad, 2 * math.pi)
        self._phase = (self._phase + _CADENCE_RAD_S * step_s) % (2 * math.pi) if any(self.moves) else 0.0
        if driven:
            reach = float(table["head_rad_s"]) * step_s
            ends = [table["axes"][key][1:3] for key in HEAD]
            self.head_rad = tuple(
                towards(now, max(low, min(high, to)), reach)
                for now, to, (low, high) in zip(self.head_rad, self.head_target, ends, strict=True)
            )

    def _ramped(self, goals: Sequence[float], step_s: float) -> Sequence[float]:
        """Return the twist of a local simulation, which has an acceleration and no smoothing."""
        linear, angular = self._table["accel_m_s2"], self._table["accel_rad_s2"]
        return tuple(
            towards(now, to, rate * step_s)
            for now, to, rate in zip(self.applied, goals, (linear, linear, angular), strict=True)
        )

    # -- appearance

    @property
    def body_pose(self) -> Sequence[float]:
        """Return z, roll and pitch while a pose is active."""
        z, roll, pitch, active = self.pose_target
        return (z, roll, pitch) if active else _REST

    @property
    def joints_rad(self) -> list[float]:
        """Return the positions of all joints, in robotd's order."""
        return [*self._leg(0.0), *self.head_rad, self.mouth * _MOUTH_RAD, *self._leg(math.pi)]

    @property
    def height_m(self) -> float:
        return _HIP_M + _LEG_M * math.cos(self._bend_rad)

    @property
    def _bend_rad(self) -> float:
        if self.sitting or not self.powered:
            return _FOLDED_RAD
        straight = math.cos(_BENT_RAD) + self.body_pose[0] / _LEG_M
        return math.acos(max(math.cos(_FOLDED_RAD), min(1.0, straight)))

    def _leg(self, lag_rad: float) -> list[float]:
        """Return the five joint angles of a leg (yaw, roll, pitch, knee, ankle). The leg is bent with a flat
        foot. While walking it swings and lifts."""
        bend, phase = self._bend_rad, self._phase + lag_rad
        pace = min(1.0, math.hypot(*self.moves) / 0.3)
        lift = _LIFT_RAD * pace * max(0.0, math.sin(phase))
        swing = _STRIDE_RAD * pace * math.cos(phase) * (-1.0 if self.moves[0] < 0 else 1.0)
        return [
            0.0,
            0.0,
            swing - bend - lift,
            min(1.5, 2 * bend + 2 * lift),
            -swing - bend - lift + max(0.0, 2 * bend + 2 * lift - 1.5),
        ]

    # -- methods for a local simulation

    @cached_property
    def spec(self) -> Any:
        # Import MuJoCo only here. It only draws the duck.
        from strands_actors.drivers.common.physics.model_rows import build

        return build(self._table)

    @property
    def commanders(self) -> Sequence[Commander]:
        return (self.commander,) * len(AXES)

    def felt(self) -> Felt:
        still = (0.0,) * len(AXES)
        position = (*self.moves, *self.head_rad, *self.pose_target, self.mouth)
        return Felt(self.time_s, position, still, still, self.commanders)

    def pose(self) -> Sequence[float]:
        _, roll, pitch = self.body_pose
        left, head, right = self.joints_rad[:5], self.joints_rad[5:10], self.joints_rad[10:]
        return [self.x_m, self.y_m, self.height_m, self.yaw_rad, pitch, roll, *left, *head, *right]

    def energise(self, on: bool) -> None:
        if self.commander is (Commander.NONE if on else Commander.SIM):
            self.commander, self.requested = (Commander.SIM if on else Commander.NONE), _REST

    def set_targets(self, values: Sequence[float]) -> None:
        if self.commander is Commander.SIM:
            self.requested = tuple(values[: len(TWIST)])
            self.head_target = tuple(values[3:7])
            self.pose_target = tuple(values[7:11])
            self.mouth = values[11]

    def hold(self) -> None:
        if self.commander is Commander.SIM:
            self.requested = _REST

    def step(self, steps: int) -> None:
        self.run(steps * TIMESTEP_S)


def _smoothed(now: Sequence[float], goals: Sequence[float], step_s: float) -> Sequence[float]:
    share = 1.0 - (1.0 - SMOOTHING) ** (step_s / TICK_S)
    return tuple(value + share * (goal - value) for value, goal in zip(now, goals, strict=True))
