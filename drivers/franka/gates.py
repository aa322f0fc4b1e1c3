"""Conditions and gates: pure functions that refuse a setpoint before it reaches the controller.

They never change (clip) a value.
"""

from __future__ import annotations

from strands_actors.contract.axis import Axis
from strands_actors.contract.axis_gates import past_range, stale
from strands_actors.contract.driver import Candidate, Condition, GateCheck, GateState, OnResume
from strands_actors.contract.sensors import number_of
from strands_actors.contract.wire import Observation
from strands_actors.kernel.messages import Refused

from . import refusals
from .protocol import RobotMode

MOVABLE = (RobotMode.IDLE, RobotMode.MOVE)

POOR, TOO_POOR = 0.8, 0.5
"""Shares of the last 100 commands that reached the controller in time. Below ``POOR`` the status has a warning.
Below ``TOO_POOR`` a new target is refused [assumed]."""

REASONS = "reasons"
"""Key of ``Observation.faults`` for the controller's errors."""
LOST = "motion"
"""Key of ``Observation.faults`` for the reason why the controller ended the motion of this driver."""


def all_gates(axes: tuple[Axis, ...], state_ttl_s: float) -> tuple[GateCheck, ...]:
    """Return the gates in the order in which they check a setpoint. The first refusal is reported."""
    return stale(axes, state_ttl_s), all_joints(axes), past_range(axes), reaches_it


def refuse_mode(mode: int, reasons: str) -> Refused | None:
    """Refuse if the controller is in a mode in which it accepts no motion. Arming makes the same check."""
    return None if mode in MOVABLE else refusals.wrong_mode(mode, reasons)


# -- conditions under which a motion may begin and continue


def movable(observation: Observation, now_ns: int) -> Refused | None:
    return refuse_mode(number_of(observation.sensors, "robot_mode", 0), observation.faults.get(REASONS, ""))


def not_lost(observation: Observation, now_ns: int) -> Refused | None:
    """Refuse a setpoint after the controller has ended our motion, until the caller resumes. Motion never restarts
    by itself."""
    reason = observation.faults.get(LOST)
    return None if reason is None else refusals.motion_ended(reason)


CONDITIONS = (Condition(movable), Condition(not_lost, on_resume=OnResume.ARM_ANEW))


# -- gates that check a new target


def all_joints(axes: tuple[Axis, ...]) -> GateCheck:
    """Refuse an action that does not name every joint, because a motion always moves the whole arm."""
    keys = ", ".join(axis.key for axis in axes)

    def all_joints(candidate: Candidate, state: GateState) -> Refused | None:
        missing = ", ".join(axis.key for index, axis in enumerate(axes) if index not in candidate.named)
        if not missing or not candidate.named:  # An action that names no joint moves the hand alone.
            return None
        named = ", ".join(axes[index].key for index in candidate.named)
        return refusals.not_all_joints(missing, named, keys, len(axes))

    return all_joints


def reaches_it(candidate: Candidate, state: GateState) -> Refused | None:
    """Refuse a new target while too few commands reach the controller in time. The controller would soon
    end the motion.

    The controller measures this share of commands only during a motion, so without a motion nothing is refused.
    """
    rate = state.observation.sensors.get("success_rate", (1.0,))[0]
    if number_of(state.observation.sensors, "robot_mode", 0) != RobotMode.MOVE or rate >= TOO_POOR:
        return None
    return refusals.low_success_rate(rate, TOO_POOR)
