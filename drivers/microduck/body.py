"""Simulate the duck behind the simulated daemon: a base that walks in the plane by a twist, a head and a mouth
that follow their goals, legs that step, and skills that play for a while.

Only its motion is simulated, not forces. The duck does what it is commanded, unless it is held, sits, is
relaxed or plays a skill. A relaxed duck sinks down [assumed: the real one collapses].
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from functools import cached_property
from typing import Any

from strands_actors.drivers.common.physics.body import TIMESTEP_S, Commander, Felt

from .protocol import HELD, SIT_TOGGLE
from .robots import AXES, HEAD, POSE, TWIST

DEADMAN_S = 0.5

_REST = (0.0, 0.0, 0.0)
_STEP_S = 0.01
_LONGEST_S = 0.25
"""Longest time that is simulated at once after a pause. The rest of a longer pause is skipped."""

_HIP_M, _LEG_M = 0.01, 0.11
"""From trunk to hip, and from hip to foot when stretched, as in ``model_rows``."""
_BENT_RAD, _FOLDED_RAD = 0.35, 0.785
_CADENCE_RAD_S, _STRIDE_RAD, _LIFT_RAD = 12.0, 0.25, 0.3
_MOUTH_RAD = 0.6


class Duck:
    """The simulated duck. ``applied`` is its present twist. A twist that is not repeated for ``deadman_s``
    seconds becomes zero; with ``deadman_s`` 0 it never does."""

    axes = AXES

    def __init__(self, table: Mapping[str, Any], deadman_s: float, now_s: Callable[[], float]) -> None:
        self._table = table
        self._deadman_s = deadman_s
        self._now_s = now_s
        self._updated_s = now_s()
        self.time_s = 0.0
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
        self.limited_by: tuple[str, ...] = ()
        self.head_rad: Sequence[float] = (0.0,) * len(HEAD)
        self.head_target: Sequence[float] = self.head_rad
        self.pose_target: Sequence[float] = (0.0,) * len(POSE)
        self.mouth = 0.0
        self.skill = ""
        self.x_m = self.y_m = self.yaw_rad = self._phase = 0.0
        self._commanded_s = self._now_s()
        self._skill_until_s = self._up_at_s = 0.0

    @property
    def policy(self) -> str:
        """Return the name of the present policy, as robotd reports it."""
        if not self.enabled or not self.powered or self._now_s() < self._up_at_s:
            return HELD
        if self.skill:
            return self.skill
        if self.sitting:
            return "sitstand"
        return "walk" if any(self.applied) else "stand"

    # -- commands

    def walk(self, twist: Sequence[float], commander: Commander) -> None:
        self.pass_time()
        self.requested, self._commanded_s = tuple(twist), self._now_s()
        self.commander = commander if any(twist) else Commander.NONE if commander is Commander.WIRE else commander

    def enable(self, on: bool) -> None:
        """Stand up if the duck is limp, and let a walking policy drive it. With ``on=False`` hold the pose."""
        self.pass_time()
        if on and not self.enabled:
            self._up_at_s = self._now_s() + float(self._table["rise_s"])
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
        if self.policy == HELD:
            return "no policy drives the robot: enable it first"
        if self.skill:
            return f"{self.skill} is playing"
        if skill == SIT_TOGGLE:
            self.sitting = not self.sitting
        elif self.sitting:
            return "the robot sits"
        self.skill, self._skill_until_s = skill, self._now_s() + float(self._table["skill_s"])
        return ""

    # -- time

    def pass_time(self) -> None:
        """Advance the simulation to the present time."""
        now_s = self._now_s()
        passed_s, self._updated_s = now_s - self._updated_s, now_s
        if self._deadman_s and self.commander is Commander.WIRE and now_s - self._commanded_s > self._deadman_s:
            self.requested, self.commander = _REST, Commander.NONE
        self.run(min(passed_s, _LONGEST_S))

    def run(self, seconds: float) -> None:
        while seconds > 0:
            step_s = min(seconds, _STEP_S)
            seconds -= step_s
            self._step(step_s)

    def _step(self, step_s: float) -> None:
        table = self._table
        self.time_s += step_s
        if self.skill and self._now_s() >= self._skill_until_s:
            self.skill = ""
        driven = self.commander is Commander.SIM or self.policy != HELD
        reason = self.skill or ("sitting" if self.sitting else "" if driven else HELD)
        goals = _REST if reason or self.stuck else self.requested
        self.limited_by = (reason,) if reason and any(self.requested) else ()
        most = (table["accel_m_s2"], table["accel_m_s2"], table["accel_rad_s2"])
        self.applied = tuple(
            now + max(-rate * step_s, min(rate * step_s, to - now))
            for now, to, rate in zip(self.applied, goals, most, strict=True)
        )
        vx, vy, vyaw = self.applied
        self.yaw_rad = math.remainder(self.yaw_rad + vyaw * step_s, 2 * math.pi)
        self.x_m += (vx * math.cos(self.yaw_rad) - vy * math.sin(self.yaw_rad)) * step_s
        self.y_m += (vx * math.sin(self.yaw_rad) + vy * math.cos(self.yaw_rad)) * step_s
        self._phase = (self._phase + _CADENCE_RAD_S * step_s) % (2 * math.pi) if any(self.applied) else 0.0
        if driven and not self.stuck:
            reach = float(table["head_rad_s"]) * step_s
            self.head_rad = tuple(
                now + max(-reach, min(reach, to - now))
                for now, to in zip(self.head_rad, self.head_target, strict=True)
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
        pace = min(1.0, math.hypot(*self.applied) / 0.3)
        lift = _LIFT_RAD * pace * max(0.0, math.sin(phase))
        swing = _STRIDE_RAD * pace * math.cos(phase) * (-1.0 if self.applied[0] < 0 else 1.0)
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
        position = (*self.applied, *self.head_rad, *self.pose_target, self.mouth)
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
