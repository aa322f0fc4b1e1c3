"""The verbs of teleoperation, as functions of a robot's tree."""

from __future__ import annotations

import logging
import math
from collections.abc import Callable, Mapping
from typing import Any

import msgspec

from strands_actors.caller.handle import envelopes as answers
from strands_actors.caller.handle.envelopes import Answer
from strands_actors.caller.handle.verbs import Verb
from strands_actors.caller.processes.twin_process import TwinProcessDown
from strands_actors.caller.session.tree import RobotTree
from strands_actors.contract.axis import finite
from strands_actors.contract.driver import Driver
from strands_actors.contract.plain_numbers import as_python
from strands_actors.contract.shown import closest, shown
from strands_actors.kernel.messages import Refused
from strands_actors.kernel.refusals import Code
from strands_actors.supervisors.root.messages import Operate

from .actor import GRIPPER, KEY
from .machine import Kind
from .teleoperator import Teleoperator, place_of_map

_log = logging.getLogger("strands_actors")

ACTOR = "strands_actors.teleoperation.actor:Teleoperation"
FOR_EVER_S = 1e9
DEADMEN = (KEY, GRIPPER)
RATES = "-1..1"
MOST_RATE = 1.01
"""Greatest accepted rate. A stick may report a little more than 1 (-32768 of 32767), which counts as 1."""
NOT_THE_DEADMAN = Refused(
    Code.GRIPPER_DEADMAN,
    "the dead-man of this teleoperation is the leader's gripper",
    'squeeze it twice, or begin again: attach_teleop(leader, deadman="key")',
    verb="operate",
)


def attach(
    driver: Driver,
    leader: object,
    hz: float,
    map_fn: Callable[..., Any] | None,
    deadman: str | None,
    max_speed: float | None,
    duration: float | None,
) -> Verb | Answer:
    """Return the verb, or a refusal. The arguments are those of ``RealRobot.attach_teleop``."""
    hz, max_speed, duration = map(as_python, (hz, max_speed, duration))
    try:
        if not isinstance(leader, Teleoperator):
            raise ValueError(f"the leader is {leader!r}. give a Teleoperator")
        chosen = _deadman(leader, deadman)
        _check(hz, "hz", 500.0)
        _check(max_speed, "max_speed", math.inf)
        _check(duration, "duration", math.inf)
        place = place_of_map(map_fn)
        if why := driver.ROLLOUTS or driver.TASKS:
            raise ValueError(f"{driver.robot}: {why}")
        if not driver.table:
            raise ValueError(f"{driver.robot} has no axes of its own to lead")
    except ValueError as failure:
        return answers.error(f"teleoperate: {failure}")
    speed = {} if max_speed is None else {"max_speed": float(max_speed)}

    async def run(tree: RobotTree) -> Answer:
        if tree.plan.at:
            why = f"{tree.robot} is run by another host"
            return answers.refused(
                Refused(Code.ELSEWHERE, why, "run the teleoperation on that host", verb="teleoperate")
            )
        try:
            source = await leader.source()
        except TwinProcessDown as down:
            return answers.error(f"teleoperate: {down}")
        options = {
            "source": source,
            "axes": msgspec.to_builtins(driver.table),
            "kind": str(leader.kind),
            "deadman": chosen,
            "map_fn": place,
            **speed,
        }
        begun = await tree.rollouts.start_task(
            ACTOR, options, f"teleoperation by {leader.name}", duration or FOR_EVER_S, hz, is_actor=True
        )
        if isinstance(begun, Refused):
            return answers.refused(begun)
        tree.rollouts.no_operator = NOT_THE_DEADMAN if chosen == GRIPPER else None
        for caveat in leader.caveats:
            _log.warning("%s leads %s: %s", leader.name, tree.robot, caveat)
        told = answers.task(begun)
        return answers.success({**told, "caveats": list(leader.caveats)} if leader.caveats else told)

    return run


def _deadman(leader: Teleoperator, given: str | None) -> str:
    if leader.kind is Kind.JOG:
        if given not in (None, KEY):
            raise ValueError(f"deadman is {given!r}, and {leader.name} has one of its own. leave it out")
        return KEY
    chosen = given or (GRIPPER if leader.is_arm else KEY)
    if chosen not in DEADMEN or (chosen == GRIPPER and not leader.is_arm):
        raise ValueError(f"deadman is {given!r}. use {', '.join(map(repr, DEADMEN if leader.is_arm else (KEY,)))}")
    return chosen


def _check(value: object, name: str, most: float) -> None:
    if value is None and name != "hz":
        return
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0 < value <= most or value == math.inf:
        limit = "" if most == math.inf else f" and at most {most:g}"
        raise ValueError(f"{name} is {value!r}. give a number above 0{limit}")


def operate(driver: Driver, held: object, rates: Mapping[str, object]) -> Verb | Answer:
    """Return the verb that sends an operator's input, or a refusal. A wrong rate moves nothing, and does not
    prevent a release of the dead-man."""
    is_held = as_python(held)
    if not isinstance(is_held, bool):  # The text "False" would hold the dead-man.
        return answers.refused(_wrong(Code.BAD_ARGUMENT, f"held is {shown(held)}", "True or False", held))
    told = _rates(driver, rates)
    if isinstance(told, Refused) and is_held:
        return answers.refused(told)

    async def run(tree: RobotTree) -> Answer:
        known = {} if isinstance(told, Refused) else told
        refused = tree.rollouts.operate(Operate(tree.clock.now_ns(), is_held, known))
        if refused is None and isinstance(told, Refused):
            refused = told
        return answers.success({"held": is_held}) if refused is None else answers.refused(refused)

    return run


def _rates(driver: Driver, given: Mapping[str, object]) -> dict[str, float] | Refused:
    checked: dict[str, float] = {}
    for key, rate in given.items():
        if key not in driver.axes:
            close = closest(key, driver.axes)
            hint = f" ({close[0]!r}?)" if close else ""
            why, known = f"{shown(key)} is no axis of {driver.robot}{hint}", ", ".join(driver.axes)
            return _wrong(Code.UNKNOWN_JOINT, why, f"one of {known or 'none'}", key)
        number = finite(as_python(rate))
        if number is None or abs(number) > MOST_RATE:
            return _wrong(Code.BAD_RATE, f"{key} is {shown(rate)}", f"how fast it is to go, {RATES}", rate)
        checked[key] = number
    return checked


def _wrong(code: str, why: str, accepted: str, offered: object) -> Refused:
    return Refused(code, why, f"give {accepted}", shown(offered), accepted, verb="operate")
