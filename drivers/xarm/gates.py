"""Conditions and gates that refuse a setpoint before it reaches the controller.

Every gate is a pure function of the candidate and the state. Nothing is ever clipped.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from strands_actors.contract.axis import Axis
from strands_actors.contract.axis_gates import outside_reported_range, past_ranges, stale
from strands_actors.contract.driver import Candidate, Condition, GateCheck, GateState, OnResume
from strands_actors.contract.wire import Observation
from strands_actors.drivers.common.kit.step_gates import refuse_lead, refuse_step
from strands_actors.drivers.xarm.refusals import XArmCode
from strands_actors.kernel.messages import Refused
from strands_actors.kernel.refusals import Code

from .arms import Arm
from .protocol import Mode, State, error_words

LEAD_S = 0.1
"""A target may lead the measured position by as far as the joint turns in this time. Servo mode drives to
it at full speed, also after the arm was kept from following [assumed: no arm lags further behind]."""


_AGAIN = "see to its cause, then call resume()"

Axes = Sequence[Axis]


def all_gates(arm: Arm, axes: Axes, period_s: float, state_ttl_s: float) -> tuple[GateCheck, ...]:
    """Return the gates in the order of their checks. The first that refuses gives the answer."""
    return stale(axes, state_ttl_s), past_own_range(arm, axes), too_fast(arm, axes, period_s), runs_ahead(arm, axes)


# -- conditions for a motion to begin and to continue


def error_free(observation: Observation, now_ns: int) -> Refused | None:
    error = _sensor(observation, "error")
    if error == 0:
        return None
    words = "an unknown error" if error is None else f"error {error_words(error)}"
    return Refused(XArmCode.ERROR, f"controller holds {words}", "clear it at the arm, then resume()", words, "none")


def running(observation: Observation, now_ns: int) -> Refused | None:
    """Refuse to move an arm that any client paused or stopped. It does not continue by itself."""
    state = _sensor(observation, "state")
    if state in (State.MOVING, State.READY):
        return None
    word = {State.PAUSED.value: "paused", State.STOPPED.value: "stopped"}.get(state or 0, "not ready")
    return Refused(XArmCode.STATE, f"arm is {word} (state {state})", _AGAIN, f"{state}", "1 or 2")


def in_servo_mode(observation: Observation, now_ns: int) -> Refused | None:
    mode = _sensor(observation, "mode")
    if mode == Mode.SERVO:
        return None
    return Refused(Code.MODE, f"arm is in mode {mode}, not in servo mode (1)", _AGAIN, f"{mode}", "1")


CONDITIONS = (
    Condition(error_free, always=True),
    Condition(running, always=True, on_resume=OnResume.ARM_ANEW),
    Condition(in_servo_mode, always=True, on_resume=OnResume.ARM_ANEW),
)


# -- gates of one setpoint


def past_own_range(arm: Arm, axes: Axes) -> GateCheck:
    """Refuse a target outside the range of the arm's own type, which the wire observes with the
    positions. If the type is unknown, refuse a target outside the range of any type."""
    joints = zip(*(kind.range_rad for kind in arm.types), strict=True)
    of_all = past_ranges(axes, [(max(low for low, _ in ends), min(high for _, high in ends)) for ends in joints])
    return outside_reported_range(axes, "range_low_rad", "range_high_rad", untold=of_all)


def speed_limit(arm: Arm, state: GateState) -> float:
    """Return the joint speed limit in rad/s: the controller's own if it is known, and at most the table's."""
    reported = state.observation.sensors.get("speed_limit_rad_s", (math.nan,))[0]
    return min(reported, arm.speed_rad_s) if reported > 0.0 else arm.speed_rad_s


def too_fast(arm: Arm, axes: Axes, period_s: float) -> GateCheck:
    """Refuse a step from the last *commanded* target that is larger than a joint can turn in one period of
    the control loop. Servo mode has no speed: the arm goes to each target at once, however rarely one
    comes."""

    def too_fast(candidate: Candidate, state: GateState) -> Refused | None:
        return refuse_step(axes, candidate, state.target, [speed_limit(arm, state)] * len(axes), period_s)

    return too_fast


def runs_ahead(arm: Arm, axes: Axes) -> GateCheck:
    """Refuse small steps that come faster than the arm follows, or while something holds it back."""

    def runs_ahead(candidate: Candidate, state: GateState) -> Refused | None:
        return refuse_lead(axes, candidate, state, [speed_limit(arm, state)] * len(axes), LEAD_S)

    return runs_ahead


def _sensor(observation: Observation, name: str) -> int | None:
    row = observation.sensors.get(name)
    return round(row[0]) if row else None
