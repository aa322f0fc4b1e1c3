"""Conditions and gates that refuse a setpoint before it reaches the arm. All are pure; nothing is ever
clipped.

A target has one position per joint in radians, followed by the time in seconds over which the wire spreads
it. A target without that time is the position at which the arm was held: no setpoint was accepted since.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from strands_actors.contract.axis import Axis
from strands_actors.contract.axis_gates import past_range
from strands_actors.contract.driver import Candidate, Condition, ConditionCheck, GateCheck, GateState
from strands_actors.contract.sensors import number_of
from strands_actors.contract.wire import Observation
from strands_actors.drivers.common.kit.step_gates import refuse_step
from strands_actors.drivers.kuka.refusals import KukaCode
from strands_actors.kernel.clock import NS
from strands_actors.kernel.messages import Refused
from strands_actors.kernel.refusals import Code

from .protocol import JOINTS, ClientMode, ControlMode, Drive, Overlay, Quality, State, name_of

LONGEST_STEP_S = 0.1
"""Longest period for which a stream's step is allowed to grow. A slower stream gets no larger steps."""

_ON_THE_PENDANT = "clear it on the pendant"


def span_s(state: GateState, oneshot_s: float) -> float:
    """Return the time over which a step may be spread: the period of its stream."""
    return min(state.period_s, LONGEST_STEP_S) if state.stream else oneshot_s


def last_target(state: GateState) -> tuple[float, ...]:
    """Return the position from which a step is counted. Before the first target this is the position that
    the arm is commanded to now: the robot's own program may have moved it since it was armed or held."""
    if len(state.target) == JOINTS and state.observation.t_ns > state.target_ns:
        return state.observation.sensors.get("commanded_rad", state.target)
    return state.target[:JOINTS]


# -- conditions for a motion to begin and to continue


def conditions(axes: Sequence[Axis], state_ttl_s: float) -> tuple[Condition, ...]:
    """Return the conditions in the order of their checks. The first that refuses gives the answer."""
    of_the_session = (session, client_mode, control_mode, overlay, quality)
    checks = map(Condition, (safety, drives(axes), *of_the_session))
    return Condition(stale(state_ttl_s), is_silence=True), *checks


def stale(ttl_s: float) -> ConditionCheck:
    ttl_ns = round(ttl_s * NS)
    limit = f"{ttl_s * 1e3:.0f} ms"

    def stale(observation: Observation, now_ns: int) -> Refused | None:
        age_ns = now_ns - min(observation.stamp_ns, default=0)
        if age_ns <= ttl_ns and all(map(math.isfinite, observation.position)):
            return None
        age = f"{age_ns / 1e6:.0f} ms"
        why = f"no FRI message for {age}"
        return Refused(Code.STALE, why, "check the controller, its FRI session and the network", age, limit)

    return stale


def safety(observation: Observation, now_ns: int) -> Refused | None:
    level = number_of(observation.sensors, "safety_state")
    if level == 0:
        return None
    return Refused(KukaCode.SAFETY, f"safety stop, level {level}", _ON_THE_PENDANT, f"{level}", "0")


def drives(axes: Sequence[Axis]) -> ConditionCheck:
    def drives(observation: Observation, now_ns: int) -> Refused | None:
        row = observation.sensors.get("drive_state", ())
        if not row:
            return Refused(KukaCode.DRIVES, "the state of the drives is not known", _ON_THE_PENDANT, "", "ACTIVE")
        # A controller may send one number for all joints.
        for axis, number in zip(axes, row, strict=False):
            if number != Drive.ACTIVE:
                name = name_of(Drive, round(number))
                return Refused(KukaCode.DRIVES, f"drive of {axis.key} is {name}", _ON_THE_PENDANT, name, "ACTIVE")
        return None

    return drives


def session(observation: Observation, now_ns: int) -> Refused | None:
    return _refuse_other(
        observation, KukaCode.FRI_STATE, State.COMMANDING_ACTIVE, "FRI session", "start the motion on the pendant"
    )


def client_mode(observation: Observation, now_ns: int) -> Refused | None:
    remedy = "let the robot program command positions: ClientCommandMode.POSITION"
    return _refuse_other(observation, KukaCode.CLIENT_MODE, ClientMode.POSITION, "FRI client command mode", remedy)


def control_mode(observation: Observation, now_ns: int) -> Refused | None:
    """Refuse other modes than position control. Only for this mode is it known what the arm does when the
    session ends."""
    remedy = "use PositionControlMode in the robot program"
    return _refuse_other(observation, KukaCode.CONTROL_MODE, ControlMode.POSITION, "control mode", remedy)


def overlay(observation: Observation, now_ns: int) -> Refused | None:
    if number_of(observation.sensors, "overlay") != Overlay.NO_OVERLAY:
        return None
    remedy = "start the robot program's motion again, with the FRI overlay"
    return Refused(KukaCode.OVERLAY, "the overlay is lost", remedy, "NO_OVERLAY", "JOINT")


def quality(observation: Observation, now_ns: int) -> Refused | None:
    number = number_of(observation.sensors, "fri_quality")
    if number >= Quality.GOOD:
        return None
    name = name_of(Quality, number)
    remedy = "wait until it is GOOD; check the network and the load of this machine"
    return Refused(KukaCode.QUALITY, f"FRI connection quality is {name}", remedy, name, "GOOD")


# -- gates of one setpoint


def gates(axes: Sequence[Axis], oneshot_s: float) -> tuple[GateCheck, ...]:
    """Return the gates in the order of their checks. The first that refuses gives the answer."""
    return (past_range(axes), too_fast(axes, oneshot_s))


def too_fast(axes: Sequence[Axis], oneshot_s: float) -> GateCheck:
    """Refuse a step from the last target that is larger than a joint turns in one period of the stream. The
    period of a single command is that of the control loop."""

    def too_fast(candidate: Candidate, state: GateState) -> Refused | None:
        speeds = [axis.speed for axis in axes]
        return refuse_step(axes, candidate, last_target(state), speeds, span_s(state, oneshot_s))

    return too_fast


def _refuse_other(
    observation: Observation, sensor: KukaCode, wanted: State | ClientMode | ControlMode, what: str, remedy: str
) -> Refused | None:
    number = number_of(observation.sensors, sensor)
    if number == wanted:
        return None
    name = name_of(type(wanted), number)
    return Refused(sensor, f"{what} is {name}", remedy, name, wanted.name)
