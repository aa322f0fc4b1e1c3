"""Make the verbs of teleoperation. A verb is a function that is called with the robot's tree (its processes)."""

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
from strands_actors.contract.pose_keys import POSE_KEYS
from strands_actors.contract.shown import closest
from strands_actors.kernel.messages import Refused
from strands_actors.supervisors.root.messages import Operate

from . import refusals
from .actor import GRIPPER, KEY, first_status
from .leaders import Leaders, prefixed
from .machine import Kind
from .teleoperator import Teleoperator, place_of_map

_log = logging.getLogger("strands_actors")

ACTOR = "strands_actors.teleoperation.actor:Teleoperation"
FOR_EVER_S = 1e9
DEADMEN = (KEY, GRIPPER)
MOST_RATE = 1.01
"""Greatest accepted rate. A stick may report a little more than 1 (-32768 of 32767), which counts as 1."""


_TOOL_KEYWORDS = {key.replace(".", "_"): key for key in POSE_KEYS}


def attach(
    driver: Driver,
    leader: object,
    hz: float,
    map_fn: Callable[..., Any] | None,
    deadman: str | None,
    max_speed: float | None,
    duration: float | None,
) -> Verb | Answer:
    """Return the verb (a function of the robot's processes) that starts a teleoperation, or the refusal of a
    wrong argument. ``RealRobot.attach_teleop`` describes the arguments.
    """
    hz, max_speed, duration = map(as_python, (hz, max_speed, duration))
    try:
        if isinstance(leader, Mapping):
            leader = Leaders(leader)
        if not isinstance(leader, Teleoperator):
            raise ValueError(f"the leader is {leader!r}. Give a Teleoperator")
        if isinstance(leader, Leaders):
            leader.check(driver)
        chosen = _deadman(leader, deadman)
        _check(hz, "hz", 500.0)
        _check(max_speed, "max_speed", math.inf)
        _check(duration, "duration", math.inf)
        place = place_of_map(map_fn)
        if problem := driver.ROLLOUTS or driver.TASKS:
            raise ValueError(f"{driver.robot}: {problem}")
        if not driver.table:
            raise ValueError(f"{driver.robot} has no axes that a leader could move")
    except (ValueError, TypeError) as failure:
        return answers.error(f"teleoperate: {failure}")
    speed = {} if max_speed is None else {"max_speed": float(max_speed)}

    async def run(tree: RobotTree) -> Answer:
        if tree.plan.host_address:
            return answers.refused(refusals.runs_elsewhere(tree.robot))
        try:
            source = await leader.source()
        except TwinProcessDown as down:
            return answers.error(f"teleoperate: {down}")
        if isinstance(leader, Leaders):
            source = prefixed(source, driver)
        options = {
            "source": source,
            "axes": msgspec.to_builtins(driver.table),
            "kind": str(leader.kind),
            "deadman": chosen,
            "map_fn": place,
            "has_tool": leader.kind is Kind.JOG and driver.arm_model({}) is not None,
            **speed,
        }
        instruction, first = f"teleoperation by {leader.name}", first_status(driver.table, leader.kind)
        begun = await tree.rollouts.start_task(
            ACTOR, options, instruction, duration or FOR_EVER_S, hz, is_actor=True, teleop=first
        )
        if isinstance(begun, Refused):
            return answers.refused(begun)
        tree.rollouts.no_operator = refusals.not_the_deadman() if chosen == GRIPPER else None
        for caveat in leader.caveats:
            _log.warning("%s leads %s: %s", leader.name, tree.robot, caveat)
        status = answers.task(begun)
        return answers.success({**status, "caveats": list(leader.caveats)} if leader.caveats else status)

    return run


def _deadman(leader: Teleoperator, requested: str | None) -> str:
    if leader.kind is Kind.JOG:
        if requested not in (None, KEY):
            raise ValueError(f"deadman is {requested!r}, but {leader.name} has its own dead-man. Leave deadman out")
        return KEY
    chosen = requested or (GRIPPER if leader.is_arm else KEY)
    if chosen not in DEADMEN or (chosen == GRIPPER and not leader.is_arm):
        raise ValueError(
            f"deadman is {requested!r}. Use {', '.join(map(repr, DEADMEN if leader.is_arm else (KEY,)))}"
        )
    return chosen


def _check(value: object, name: str, most: float) -> None:
    if value is None and name != "hz":
        return
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0 < value <= most or value == math.inf:
        limit = "" if most == math.inf else f" and at most {most:g}"
        raise ValueError(f"{name} is {value!r}. Give a number above 0{limit}")


def operate(driver: Driver, held: object, rates: Mapping[str, object]) -> Verb | Answer:
    """Return the verb (a function of the robot's processes) that sends an operator's input, or a refusal.

    A wrong rate is refused and moves nothing. But a release of the dead-man is sent even if a rate is wrong.
    """
    is_held = as_python(held)
    # The text "False" would count as true and hold the dead-man, so only a bool is accepted.
    if not isinstance(is_held, bool):
        return answers.refused(refusals.bad_held(held))
    checked = _rates(driver, rates)
    if isinstance(checked, Refused) and is_held:
        return answers.refused(checked)

    async def run(tree: RobotTree) -> Answer:
        accepted = {} if isinstance(checked, Refused) else checked
        refused = tree.rollouts.operate(Operate(tree.clock.now_ns(), is_held, accepted))
        if refused is None and isinstance(checked, Refused):
            refused = checked
        return answers.success({"held": is_held}) if refused is None else answers.refused(refused)

    return run


def _rates(driver: Driver, rates: Mapping[str, object]) -> dict[str, float] | Refused:
    checked: dict[str, float] = {}
    for name, rate in rates.items():
        # A keyword has no dot: ``ee_x`` is ``ee.x``.
        key = _TOOL_KEYWORDS.get(name, name)
        if key not in driver.axes and (key not in POSE_KEYS or driver.arm_model({}) is None):
            closest_key = next(iter(closest(key, driver.axes)), None)
            return refusals.unknown_axis(key, closest_key, driver.robot, ", ".join(driver.axes))
        number = finite(as_python(rate))
        if number is None or abs(number) > MOST_RATE:
            return refusals.bad_rate(key, rate)
        checked[key] = number
    return checked
