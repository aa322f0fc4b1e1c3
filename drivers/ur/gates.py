"""Conditions and gates: pure functions that refuse a setpoint before it reaches a UR controller.

They never change (clip) a value.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from msgspec import structs

from strands_actors.contract.axis import Axis
from strands_actors.contract.axis_gates import past_range, stale, too_fast
from strands_actors.contract.driver import Candidate, Condition, GateCheck, GateState, OnResume
from strands_actors.contract.sensors import number_of
from strands_actors.contract.wire import Observation
from strands_actors.drivers.common.kit.step_gates import refuse_lead
from strands_actors.kernel.clock import NS
from strands_actors.kernel.messages import Refused

from . import refusals
from .arms import JOINTS
from .protocol import MOVABLE_SAFETY, RobotMode, RuntimeState

CONTROL_HZ = 125.0
CONTROL_S = 1 / CONTROL_HZ
WATCHDOG_HZ = 10.0
"""Lowest rate at which the controller's watchdog must be fed while the control script runs."""

LOOKAHEAD_S = 0.1
"""Look-ahead time of servoJ, over which it spreads a step. A step may be at most as large as the joint turns in
this time."""

LEAD_S = 2 * LOOKAHEAD_S + 1 / WATCHDOG_HZ
"""How far a target may be ahead of the measured joint: as far as the joint turns in this time plus the age of the
sample. The time is the sum of three parts. servoJ lags by one look-ahead time. The slowest stream steps ahead by
another one. And it may take one period of the watchdog until a lost connection is noticed.

If a joint is further behind, it cannot follow: the targets come too fast, or an obstacle holds the arm back. At
180 deg/s the limit is 0.94 rad. A stream at top speed is 0.2 rad ahead in the simulated robot, and 0.3 rad
[assumed] on a real arm."""

START_S = 3.0
"""Longest time from the upload of the control script until it runs. A real controller takes a second or two to
start a program, and the network needs the rest [assumed]."""

PAUSED = (RuntimeState.PAUSING, RuntimeState.PAUSED, RuntimeState.RESUMING)
"""States of a paused program. A paused control script accepts no command, so a pause counts as its end."""


def all_gates(axes: Sequence[Axis], state_ttl_s: float, period_s: float = CONTROL_S) -> tuple[GateCheck, ...]:
    """Return the gates in the order in which they check a setpoint. The first refusal is reported.

    A single command may move a joint at most as far as it turns in ``period_s``, the period of the sender. servoJ
    does not limit the speed, so with a far target the arm would move dangerously fast. A gripper limits its own
    speed, so its steps may have any length.
    """
    free = [axis if axis.unit == "rad" else structs.replace(axis, speed=math.inf) for axis in axes]
    steps = too_fast(free, tolerance=1.0, oneshot_s=period_s, longest_s=LOOKAHEAD_S, pause_counts=False)
    return stale(axes, state_ttl_s), paused, past_range(axes), steps, runs_ahead(free)


def refuse_modes(robot: int, safety: int) -> Refused | None:
    """Refuse if the robot mode or the safety mode does not allow the arm to move. Arming makes the same check."""
    if robot != RobotMode.RUNNING:
        return refusals.wrong_robot_mode(robot)
    return None if safety in MOVABLE_SAFETY else refusals.wrong_safety_mode(safety)


# -- conditions under which a motion may begin and continue


def modes(observation: Observation, now_ns: int) -> Refused | None:
    robot = number_of(observation.sensors, "robot_mode", RobotMode.NO_CONTROLLER)
    return refuse_modes(robot, number_of(observation.sensors, "safety_mode", 0))


def program(observation: Observation, now_ns: int) -> Refused | None:
    """Refuse unless the control script has been running without a stop or pause since the robot was armed.

    So motion never continues by itself after a protective stop, or after the controller's watchdog has ended the
    script.
    """
    runs = number_of(observation.sensors, "runtime_state", 0)
    if runs in PAUSED:
        return refusals.script_paused()
    if number_of(observation.sensors, "control", 0) != 1 or runs != RuntimeState.PLAYING:
        return refusals.script_not_running(observation.faults.get("controller", ""))
    return None


CONDITIONS = (Condition(modes), Condition(program, on_resume=OnResume.ARM_ANEW))


def paused(candidate: Candidate, state: GateState) -> Refused | None:
    """Refuse a setpoint while the speed scaling is zero, for example by the speed slider on the pendant."""
    if not state.observation.sensors.get("speed_scaling", (0.0,))[0] > 0.0:
        return refusals.speed_scaled_to_zero()
    return None


def runs_ahead(axes: Sequence[Axis]) -> GateCheck:
    """Refuse a target that is too far ahead of the measured joint.

    This happens if small steps come faster than the joint can turn, or if an obstacle holds the arm back. servoJ
    has no speed limit, so the arm would then jump to the target.
    """
    speeds = [axis.speed for axis in axes]

    def runs_ahead(candidate: Candidate, state: GateState) -> Refused | None:
        age_s = (state.now_ns - min(state.observation.stamp_ns[: len(JOINTS)])) / NS
        return refuse_lead(axes, candidate, state, speeds, LEAD_S + age_s)

    return runs_ahead
