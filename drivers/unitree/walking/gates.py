"""The conditions under which a robot may walk, and the gates of a command. Pure."""

from __future__ import annotations

from collections.abc import Mapping

from strands_actors.contract.driver import Condition, OnResume
from strands_actors.contract.wire import Observation
from strands_actors.drivers.unitree.gates import MODE_TTL_S, battery_above, battery_known
from strands_actors.drivers.unitree.refusals import UnitreeCode
from strands_actors.drivers.unitree.robots import Model
from strands_actors.kernel.clock import NS
from strands_actors.kernel.messages import Refused
from strands_actors.kernel.refusals import Code

from .dialect import Dialect
from .robots import BASE

GAIT_TTL_S = 0.3
"""Longest age of the mode. A robot sends SportModeState 300 times a second, a twin 50 times. The FSM id is
asked for 20 times a second."""

JOINTS_ELSEWHERE = "make it with level='low' to command its joints"
WALKS_ELSEWHERE = "make it with level='sport' to walk"


def conditions(dialect: Dialect, floor_pct: float) -> tuple[Condition, ...]:
    """Return the conditions in the order of their checks: the first that refuses answers. The robot stays
    armed if one of its services can mend the condition."""
    walks = Walks(dialect)
    return (
        Condition(released, on_resume=OnResume.STAY_ARMED),
        Condition(walks.mode_known, is_silence=True, on_resume=OnResume.STAY_ARMED),
        Condition(walks.posture, on_resume=OnResume.STAY_ARMED),
        Condition(refused_by_robot, on_resume=OnResume.STAY_ARMED),
        Condition(battery_known),
        Condition(battery_above(floor_pct)),
    )


def released(observation: Observation, now_ns: int) -> Refused | None:
    """Refuse if the onboard controller has released the joints, which are then commanded one by one."""
    reported = observation.sensors.get("sport_mode_released")
    if reported is None or not reported[0] or now_ns / NS - reported[1] > MODE_TTL_S:
        return None
    why = "the sport mode is released: the joints are commanded one by one, and the robot does not balance"
    return Refused(
        UnitreeCode.SPORT_MODE_RELEASED, why, "end what commands them, then call select_sport_mode()", "released"
    )


class Walks:
    """Conditions that depend on the robot's modes."""

    def __init__(self, dialect: Dialect) -> None:
        self._dialect = dialect

    def mode_known(self, observation: Observation, now_ns: int) -> Refused | None:
        reported = observation.sensors.get("sport_mode")
        if reported is None:
            why = f"no {self._dialect.mode_source} yet"
            return Refused(Code.MODE_UNKNOWN, why, "check that its sport service runs")
        age_s = now_ns / NS - reported[1]
        if age_s <= GAIT_TTL_S:
            return None
        age, limit = f"{age_s:.1f} s", f"{GAIT_TTL_S:g} s"
        why = f"the last {self._dialect.mode_source} is {age} old (limit {limit})"
        return Refused(Code.MODE_STALE, why, "check the robot and the network", age, limit)

    def posture(self, observation: Observation, now_ns: int) -> Refused | None:
        """Refuse a mode in which the robot ignores a velocity, since its service answers success even then."""
        mode = round(observation.sensors["sport_mode"][0])
        if mode in self._dialect.walks:
            return None
        name, allowed = self._dialect.name(mode), ", ".join(map(self._dialect.name, sorted(self._dialect.walks)))
        service = next((call for call, one in self._dialect.postures.items() if mode in one.after), "")
        remedy = f"call {service}() first" if service else "wait until that is over"
        return Refused(UnitreeCode.POSTURE, f"the robot is {name}", remedy, name, allowed)


def refused_by_robot(observation: Observation, now_ns: int) -> Refused | None:
    why = observation.faults.get("move")
    if why is None:
        return None
    return Refused(Code.REFUSED_BY_ROBOT, f"the robot refuses: {why}", "look at the robot, then try again", why)


def refuse_joints(model: Model, action: Mapping[str, object]) -> Refused | None:
    """Refuse joints, which belong to the onboard controller."""
    for key in action:
        name = str(key).removesuffix(".pos")
        if name in model.axes or name.removesuffix("_joint") in model.axes:
            why = f"{name} belongs to the sport mode"
            return Refused(Code.LEVEL, why, JOINTS_ELSEWHERE, name, ", ".join(BASE))
    return None
