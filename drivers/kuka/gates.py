"""Conditions and gates: pure functions that refuse a setpoint before it reaches the arm.

They never change (clip) a value. A target has one position per joint in rad, followed by the time in seconds in
which the arm should reach it. A target without a time is the position at which the arm was last held, if no
setpoint was accepted since then.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

from strands_actors.contract.axis import Axis
from strands_actors.contract.axis_gates import past_range
from strands_actors.contract.driver import Candidate, Condition, ConditionCheck, GateCheck, GateState
from strands_actors.contract.sensors import number_of
from strands_actors.contract.wire import Observation
from strands_actors.drivers.common.kit.step_gates import refuse_step
from strands_actors.kernel.clock import NS
from strands_actors.kernel.messages import Refused

from . import refusals
from .protocol import JOINTS, ClientMode, ControlMode, Drive, Overlay, Quality, State, name_of

LONGEST_STEP_S = 0.1
"""A stream of targets with a longer period than this may not make larger steps."""


def span_s(state: GateState, oneshot_s: float) -> float:
    """Return the time in which the arm should make a step: the period of the stream, or ``oneshot_s``."""
    return min(state.period_s, LONGEST_STEP_S) if state.stream else oneshot_s


def last_target(state: GateState) -> tuple[float, ...]:
    """Return the position from which the size of the next step is measured, in rad.

    It is the last target. If there was no target since the arm was armed or held, it is the position that the
    controller commands now, because the program on the controller may have moved the arm.
    """
    if len(state.target) == JOINTS and state.observation.t_ns > state.target_ns:
        return state.observation.sensors.get("commanded_rad", state.target)
    return state.target[:JOINTS]


# -- conditions under which a motion may begin and continue


def conditions(axes: Sequence[Axis], state_ttl_s: float) -> tuple[Condition, ...]:
    """Return the conditions (checks that must pass while the arm is commanded), in the order in which they are
    checked. The first refusal is reported."""
    of_the_session = (session, client_mode, control_mode, overlay, quality)
    checks = map(Condition, (safety, drives(axes), *of_the_session))
    return Condition(stale(state_ttl_s), is_silence=True), *checks


def stale(ttl_s: float) -> ConditionCheck:
    ttl_ns = round(ttl_s * NS)

    def stale(observation: Observation, now_ns: int) -> Refused | None:
        age_ns = now_ns - min(observation.stamp_ns, default=0)
        if age_ns <= ttl_ns and all(map(math.isfinite, observation.position)):
            return None
        return refusals.no_message(age_ns / 1e6, ttl_s * 1e3)

    return stale


def safety(observation: Observation, now_ns: int) -> Refused | None:
    level = number_of(observation.sensors, "safety_state")
    return None if level == 0 else refusals.safety_stop(level)


def drives(axes: Sequence[Axis]) -> ConditionCheck:
    def drives(observation: Observation, now_ns: int) -> Refused | None:
        row = observation.sensors.get("drive_state", ())
        if not row:
            return refusals.drives_not_reported()
        # A controller may report only one state for the drives of all joints.
        for axis, number in zip(axes, row, strict=False):
            if number != Drive.ACTIVE:
                return refusals.drive_not_active(axis.key, name_of(Drive, round(number)))
        return None

    return drives


def session(observation: Observation, now_ns: int) -> Refused | None:
    return _refuse_unless(observation, "fri_state", State.COMMANDING_ACTIVE, refusals.wrong_session_state)


def client_mode(observation: Observation, now_ns: int) -> Refused | None:
    return _refuse_unless(observation, "client_mode", ClientMode.POSITION, refusals.wrong_client_mode)


def control_mode(observation: Observation, now_ns: int) -> Refused | None:
    """Refuse every mode except position control. In other modes it is unknown how the arm reacts to the end of
    the FRI session."""
    return _refuse_unless(observation, "control_mode", ControlMode.POSITION, refusals.wrong_control_mode)


def overlay(observation: Observation, now_ns: int) -> Refused | None:
    if number_of(observation.sensors, "overlay") != Overlay.NO_OVERLAY:
        return None
    return refusals.overlay_ended()


def quality(observation: Observation, now_ns: int) -> Refused | None:
    number = number_of(observation.sensors, "fri_quality")
    if number >= Quality.GOOD:
        return None
    return refusals.poor_quality(name_of(Quality, number))


# -- gates that check a setpoint


def gates(axes: Sequence[Axis], oneshot_s: float) -> tuple[GateCheck, ...]:
    """Return the gates in the order in which they check a setpoint. The first refusal is reported."""
    return (past_range(axes), too_fast(axes, oneshot_s))


def too_fast(axes: Sequence[Axis], oneshot_s: float) -> GateCheck:
    """Refuse a target that is further from the last target than a joint can turn in one period.

    For a stream this is the period of the stream. For a single command it is the control period.
    """

    def too_fast(candidate: Candidate, state: GateState) -> Refused | None:
        speeds = [axis.speed for axis in axes]
        return refuse_step(axes, candidate, state, last_target(state), speeds, span_s(state, oneshot_s))

    return too_fast


def _refuse_unless(
    observation: Observation,
    sensor: str,
    required: State | ClientMode | ControlMode,
    refuse: Callable[[str, str], Refused],
) -> Refused | None:
    number = number_of(observation.sensors, sensor)
    if number == required:
        return None
    return refuse(name_of(type(required), number), required.name)
