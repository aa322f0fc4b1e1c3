"""Carry out a tool call, or refuse it. All calls of agents and MCP clients pass through this module."""

from __future__ import annotations

import math
from typing import Any

from strands_actors.caller.handle import envelopes as answers
from strands_actors.caller.handle import moving, posing, verbs
from strands_actors.caller.handle.envelopes import Answer
from strands_actors.caller.session.tree import RobotTree
from strands_actors.contract.driver import Driver
from strands_actors.kernel.refusals import Code

from . import refusals
from .approval import Approval, Request
from .calls import Call

LIFT = "ask a person to lift the e-stop with resume(), which this tool cannot do"
NOBODY = "ask a person to call resume(), which this tool cannot do"


async def use(tree: RobotTree, call: Call, approval: Approval, by: str, motion: str = "") -> Answer:
    """Carry out a call, with an operator's approval if it needs one. A stop needs no approval and is not
    delayed.

    Args:
        tree: The connected robot.
        call: The call of the robot's tool.
        approval: The operator gate, which asks the operator.
        by: The name of the caller, which the operator sees in a request for approval.
        motion: Empty if motion is allowed. Otherwise the remedy in the refusal of a motion.

    Returns:
        The answer. A remedy in it names a verb of the tool, because an agent cannot call the handle's methods.
    """
    return _in_its_verbs(await _use(tree, call, approval, by, motion), tree.driver)


async def perform(tree: RobotTree, call: Call, wait: bool = True) -> Answer:
    """Carry out a call without asking an operator."""
    if call.kind == "stop":
        return await verbs.stop(tree)
    match call.verb.does:
        case "action" | "move_to":
            return await _command(tree, call, wait)
        case "service":
            return await verbs.service(tree, call.verb.name, call.inputs)
        case "torque":
            return await verbs.resume(tree, lift=False)  # Only an operator may lift an e-stop.
        case "sensors":
            return await verbs.get_sensors(tree)
        case "state":
            return await verbs.get_state(tree)
        case "pose":
            return await posing.get_pose(tree)
    return await verbs.get_status(tree)


async def _command(tree: RobotTree, call: Call, wait: bool) -> Answer:
    """Send a command once, repeat it for some seconds, or move to targets in a given time."""
    if call.verb.does == "move_to":
        pose = {name: value for name, value in call.inputs.items() if name not in ("targets", "seconds")}
        return await posing.move_to(tree, call.inputs.get("targets"), call.inputs.get("seconds"), wait, pose)
    if call.held_s is not None:
        return await moving.hold(tree, call.verb.name, call.action, call.held_s, wait)
    return await verbs.send_action(tree, call.action)


def _in_its_verbs(answer: Answer, driver: Driver) -> Answer:
    """Return the answer with remedies that an agent can follow: they name verbs of the tool, not methods of the
    robot's handle."""
    torque = next((verb.name for verb in driver.TOOL_VERBS if verb.does == "torque"), "")
    asks = "" if driver.SIMULATED else ", which an operator has to approve"
    resume = f"{torque} with enabled=true energises it{asks}" if torque else NOBODY
    return answers.with_remedy(answer, {Code.DISARMED: resume, Code.FAULTED: resume, Code.LOCKED_OUT: LIFT})


def _action_of(driver: Driver, call: Call) -> dict[str, Any] | None:
    """Return the command for the robot's axes that a call of a verb sends; None if it sends no such command."""
    if call.verb.does == "move_to" and "targets" not in call.inputs:
        # A motion to a pose may move each joint of the arm, so it needs the approval of all of them.
        return dict.fromkeys(driver.axes, math.inf)
    if call.verb.does in ("action", "move_to"):
        return call.action
    service = driver.SERVICES.get(call.verb.name) if call.verb.does == "service" else None
    return verbs.action_of_service(service, call.inputs) if service is not None and service.acts else None


async def _use(tree: RobotTree, call: Call, approval: Approval, by: str, motion: str) -> Answer:
    verb = call.verb
    if call.kind == "motion":
        if motion:
            return answers.refused(refusals.no_motion(verb.name, motion))
        # A misspelt name in guarded= would leave a verb unguarded. So refuse all motion of agents.
        if wrong := approval.guards_nothing(tree.driver):
            return answers.refused(refusals.guards_nothing(verb.name, wrong))
        request = Request(tree.robot, verb.name, call.inputs, by)
        action = _action_of(tree.driver, call)
        keys = () if action is None else tree.driver.to_approve(action)
        rests = action is not None and not keys  # The command sets all velocities to zero, so it needs no approval.
        refusal = await approval.refuse(request, keys, call.needs_approval and not rests)
        if refusal is not None:
            return answers.refused(refusal)
    return await perform(tree, call)
