"""The conditions for walking (checks of the robot's state) and the checks of its commands, as pure functions."""

from __future__ import annotations

from collections.abc import Mapping

from strands_actors.contract.driver import Condition, OnResume
from strands_actors.contract.wire import Observation
from strands_actors.drivers.unitree import refusals
from strands_actors.drivers.unitree.gates import MODE_TTL_S, battery_above, battery_reported
from strands_actors.drivers.unitree.robots import Model
from strands_actors.kernel.clock import NS
from strands_actors.kernel.messages import Refused

from .dialect import Dialect
from .robots import BASE

GAIT_TTL_S = 0.3
"""Longest age of the mode. A robot sends SportModeState 300 times a second, and a simulated robot 50 times. The FSM
id is requested 20 times a second."""


def conditions(dialect: Dialect, floor_pct: float) -> tuple[Condition, ...]:
    """Return the conditions, in the order in which they are checked. A condition is a check of the robot's state
    that must pass while the robot is commanded. The first one that fails is reported.

    The robot stays armed after a refusal that one of its services can resolve, such as ``stand_up()``.
    """
    walks = Walks(dialect)
    return (
        Condition(released, on_resume=OnResume.STAY_ARMED),
        Condition(walks.mode_reported, is_silence=True, on_resume=OnResume.STAY_ARMED),
        Condition(walks.posture, on_resume=OnResume.STAY_ARMED),
        Condition(refused_by_robot, on_resume=OnResume.STAY_ARMED),
        Condition(battery_reported),
        Condition(battery_above(floor_pct)),
    )


def released(observation: Observation, now_ns: int) -> Refused | None:
    """Refuse if the onboard controller was switched off (released): the robot can then neither walk nor balance."""
    reported = observation.sensors.get("sport_mode_released")
    if reported is None or not reported[0] or now_ns / NS - reported[1] > MODE_TTL_S:
        return None
    return refusals.released_sport_mode()


class Walks:
    """Conditions for walking (checks that return a refusal, or None to pass) that depend on the mode that the
    robot reports."""

    def __init__(self, dialect: Dialect) -> None:
        self._dialect = dialect

    def mode_reported(self, observation: Observation, now_ns: int) -> Refused | None:
        reported = observation.sensors.get("sport_mode")
        if reported is None:
            return refusals.unreported_mode(self._dialect.mode_source)
        age_s = now_ns / NS - reported[1]
        if age_s <= GAIT_TTL_S:
            return None
        return refusals.stale_mode(self._dialect.mode_source, age_s, GAIT_TTL_S)

    def posture(self, observation: Observation, now_ns: int) -> Refused | None:
        """Refuse if the robot would ignore a velocity in its present mode. Its service would still answer
        success."""
        mode = round(observation.sensors["sport_mode"][0])
        if mode in self._dialect.walks:
            return None
        name, allowed = self._dialect.name(mode), ", ".join(map(self._dialect.name, sorted(self._dialect.walks)))
        service = next((call for call, posture in self._dialect.postures.items() if mode in posture.after), "")
        return refusals.posture_without_walking(name, allowed, service)


def refused_by_robot(observation: Observation, now_ns: int) -> Refused | None:
    error = observation.faults.get("move")
    if error is None:
        return None
    return refusals.refused_velocity(error)


def refuse_joints(model: Model, action: Mapping[str, object]) -> Refused | None:
    """Refuse an action that names joints, because the onboard controller commands them."""
    for key in action:
        name = str(key).removesuffix(".pos")
        if name in model.axes or name.removesuffix("_joint") in model.axes:
            return refusals.onboard_joint(name, ", ".join(BASE))
    return None
