"""Checks that refuse a setpoint before it reaches an RB-Y1. Pure: no I/O. No value is ever limited
silently."""

from __future__ import annotations

from collections.abc import Sequence

import msgspec

from strands_actors.contract.axis import Axis
from strands_actors.contract.axis_gates import past_range, stale
from strands_actors.contract.driver import Candidate, Condition, GateCheck, GateState, OnResume
from strands_actors.contract.sensors import number_of
from strands_actors.contract.wire import Observation
from strands_actors.drivers.common.kit.step_gates import refuse_lead, refuse_step
from strands_actors.kernel.messages import Refused

from . import refusals
from .protocol import Manager, name_of

CONTROLLER = "controller"
"""Key of ``Observation.faults`` for the reason why the robot no longer follows our targets."""

LEAD_S = 0.2
"""A target may lead the measured position by as far as the joint turns in this time [assumed: no
joint lags further behind]."""

_FAULTS = (Manager.MINOR_FAULT, Manager.MAJOR_FAULT)


def all_gates(axes: Sequence[Axis], state_ttl_s: float, period_s: float) -> tuple[GateCheck, ...]:
    """Return the gates (checks of a command) in the order in which they are applied. The first
    refusal is reported to the caller."""
    return stale(axes, state_ttl_s), past_own_range(axes), too_fast(axes, period_s), runs_ahead(axes)


# -- conditions for switching the power on, and for a motion


def refuse_pressed(pressed: bool) -> Refused | None:
    return refusals.emergency_stop() if pressed else None


def refuse_fault(manager: int) -> Refused | None:
    if manager not in _FAULTS:
        return None
    return refusals.manager_fault(name_of(Manager, manager))


def released(observation: Observation, now_ns: int) -> Refused | None:
    return refuse_pressed(number_of(observation.sensors, "emergency_stop") != 0)


def faultless(observation: Observation, now_ns: int) -> Refused | None:
    return refuse_fault(number_of(observation.sensors, "control_manager"))


def powered(observation: Observation, now_ns: int) -> Refused | None:
    power, ready = number_of(observation.sensors, "power"), number_of(observation.sensors, "joints_ready")
    if power != 1:
        return refusals.no_power()
    return None if ready == 1 else refusals.servos_off()


def enabled(observation: Observation, now_ns: int) -> Refused | None:
    """Refuse to move while the robot's control manager (its software that carries out commands) is
    not enabled."""
    manager = number_of(observation.sensors, "control_manager")
    if manager == Manager.ENABLED:
        return None
    return refusals.not_enabled(name_of(Manager, manager), name_of(Manager, Manager.ENABLED))


def obeying(observation: Observation, now_ns: int) -> Refused | None:
    """Refuse to move after the robot has dropped our command. It would not continue the motion by
    itself."""
    reason = observation.faults.get(CONTROLLER)
    return None if reason is None else refusals.command_dropped(reason)


CONDITIONS = (
    Condition(released, always=True),
    Condition(faultless, always=True),
    *(Condition(check, always=True, on_resume=OnResume.ARM_ANEW) for check in (powered, enabled, obeying)),
)


# -- gates: each checks one setpoint


def own_axes(axes: Sequence[Axis], observation: Observation) -> Sequence[Axis] | None:
    """Return the axes with the limits that the robot's own model contains; None if the observation
    has no limits."""
    names = ("range_low_rad", "range_high_rad", "speed_limit_rad_s")
    low, high, speed = (observation.sensors.get(name, ()) for name in names)
    if not len(low) == len(high) == len(speed) == len(axes):
        return None
    rows = zip(axes, low, high, speed, strict=True)
    return [
        msgspec.structs.replace(axis, low=low_rad, high=high_rad, speed=rad_s)
        for axis, low_rad, high_rad, rad_s in rows
    ]


def own_speeds(axes: Sequence[Axis], observation: Observation) -> list[float]:
    """Return the joints' speed limits in rad/s: from the robot's own model, or else from
    ``robots.toml``."""
    return [axis.speed for axis in own_axes(axes, observation) or axes]


def past_own_range(axes: Sequence[Axis]) -> GateCheck:
    """Return a gate that refuses a target outside the joint ranges of the robot's own model."""

    def past_own_range(candidate: Candidate, state: GateState) -> Refused | None:
        own = own_axes(axes, state.observation)
        if own is None:
            return refusals.unknown_limits(len(axes))
        return past_range(own)(candidate, state)

    return past_own_range


def too_fast(axes: Sequence[Axis], period_s: float) -> GateCheck:
    """Refuse a step from the last target that a joint cannot make in one control period. The robot
    is commanded to arrive within that period."""

    def too_fast(candidate: Candidate, state: GateState) -> Refused | None:
        return refuse_step(axes, candidate, state, state.target, own_speeds(axes, state.observation), period_s)

    return too_fast


def runs_ahead(axes: Sequence[Axis]) -> GateCheck:
    """Refuse targets that run ahead of the measured position, because they come faster than the
    joint can turn or because something blocks the joint."""

    def runs_ahead(candidate: Candidate, state: GateState) -> Refused | None:
        return refuse_lead(axes, candidate, state, own_speeds(axes, state.observation), LEAD_S)

    return runs_ahead
