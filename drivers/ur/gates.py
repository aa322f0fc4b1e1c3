"""The gates in front of a UR controller. Each is a pure function of the candidate and the state. No value is
ever clipped."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from strands_actors.contract.axis import Axis
from strands_actors.contract.axis_gates import past_range, stale, too_fast
from strands_actors.contract.driver import Candidate, Condition, GateCheck, GateState, OnResume
from strands_actors.contract.sensors import number_of
from strands_actors.contract.wire import Observation
from strands_actors.drivers.common.kit.step_gates import refuse_lead
from strands_actors.drivers.ur.refusals import URCode
from strands_actors.kernel.clock import NS
from strands_actors.kernel.messages import Refused
from strands_actors.kernel.refusals import Code

from .protocol import MOVABLE_SAFETY, RobotMode, RuntimeState, SafetyMode, mode_name

CONTROL_HZ = 125.0
CONTROL_S = 1 / CONTROL_HZ
WATCHDOG_HZ = 10.0
"""Lowest rate at which the controller's watchdog has to be fed while our script runs."""

LOOKAHEAD_S = 0.1
"""servoJ spreads a step over this time, so a slower stream may not step further than the joint turns in
it."""

LEAD_S = 2 * LOOKAHEAD_S + 1 / WATCHDOG_HZ
"""How far a target may be ahead of the measured joint: the angle that the joint turns in this time, plus the
age of the sample. servoJ follows one look-ahead behind; the slowest stream steps another one; and for one
period of the watchdog a controller that receives nothing goes on as if all were well. A joint that is
further behind does not follow: the targets come faster than it turns, or an obstacle holds it back. The limit
is 0.94 rad at 180 deg/s. A stream at top speed is 0.2 rad ahead in the twin, and 0.3 [assumed] on an arm."""

START_S = 3.0
"""Longest time from the upload of the control script until it runs. A real controller takes a second or two to
start a program, and the network needs the rest [assumed]."""

PAUSED = (RuntimeState.PAUSING, RuntimeState.PAUSED, RuntimeState.RESUMING)
"""A paused script takes no command and feeds no watchdog. So a pause ends it."""

_UNLOCK: Mapping[int, str] = {
    SafetyMode.PROTECTIVE_STOP: "look at the arm, then unlock it on the pendant",
    SafetyMode.SAFEGUARD_STOP: "close the safeguard",
}


def all_gates(axes: Sequence[Axis], state_ttl_s: float, period_s: float = CONTROL_S) -> tuple[GateCheck, ...]:
    """Return the gates in the order of their checks: the first that refuses answers.

    A single command may step as far as the joint turns in ``period_s``, the period of its sender. servoJ has no
    speed of its own, so a far target would be a blow.
    """
    steps = too_fast(axes, tolerance=1.0, oneshot_s=period_s, longest_s=LOOKAHEAD_S, pause_counts=False)
    return stale(axes, state_ttl_s), paused, past_range(axes), steps, runs_ahead(axes)


def refuse_modes(robot: int, safety: int) -> Refused | None:
    """Refuse if the controller's modes do not allow the arm to move. Arming uses the same check."""
    if robot != RobotMode.RUNNING:
        name, required = mode_name(RobotMode, robot), mode_name(RobotMode, RobotMode.RUNNING)
        return Refused(Code.ROBOT_MODE, f"robot is {name}", "power on and release brakes", name, required)
    if safety not in MOVABLE_SAFETY:
        name, remedy = mode_name(SafetyMode, safety), _UNLOCK.get(safety, "clear it on the pendant")
        return Refused(URCode.SAFETY_MODE, name, remedy, name, "NORMAL (1) or REDUCED (2)")
    return None


# -- conditions for a motion to begin and to go on


def modes(observation: Observation, now_ns: int) -> Refused | None:
    robot = number_of(observation.sensors, "robot_mode", RobotMode.NO_CONTROLLER)
    return refuse_modes(robot, number_of(observation.sensors, "safety_mode", 0))


def program(observation: Observation, now_ns: int) -> Refused | None:
    """Refuse unless the control script runs, and was neither stopped nor paused since arming. So motion never
    continues by itself after a protective stop, or after the controller's watchdog has ended the script."""
    runs, remedy = number_of(observation.sensors, "runtime_state", 0), "call resume()"
    if runs in PAUSED:
        return Refused(URCode.PAUSED, "control script was paused on the pendant", remedy, limit="PLAYING")
    if number_of(observation.sensors, "control", 0) != 1 or runs != RuntimeState.PLAYING:
        why = observation.faults.get("controller", "")
        text = "control script is not running" + (f" ({why})" if why else "")
        return Refused(URCode.PROGRAM, text, remedy, limit="PLAYING")
    return None


CONDITIONS = (Condition(modes), Condition(program, on_resume=OnResume.ARM_ANEW))


def paused(candidate: Candidate, state: GateState) -> Refused | None:
    """Refuse a setpoint while the operator has scaled the arm's speed to zero."""
    if not state.observation.sensors.get("speed_scaling", (0.0,))[0] > 0.0:
        return Refused(URCode.PAUSED, "the arm's speed is scaled to 0", "raise the speed slider on the pendant")
    return None


def runs_ahead(axes: Sequence[Axis]) -> GateCheck:
    """Refuse small steps that come faster than a joint turns, or while an obstacle holds it back: servoJ has
    no speed limit, and would then follow in a blow."""
    speeds = [axis.speed for axis in axes]

    def runs_ahead(candidate: Candidate, state: GateState) -> Refused | None:
        age_s = (state.now_ns - min(state.observation.stamp_ns)) / NS
        return refuse_lead(axes, candidate, state, speeds, LEAD_S + age_s)

    return runs_ahead
