"""A call becomes a message to the actors, or a refusal. Every surface of others comes through
here."""

from __future__ import annotations

from typing import Any

from strands_actors.caller import envelopes as answers
from strands_actors.caller import moving, verbs
from strands_actors.caller.envelopes import Answer
from strands_actors.caller.tree import RobotTree
from strands_actors.contract.driver import Driver
from strands_actors.kernel.messages import Refused
from strands_actors.kernel.refusals import Code

from .approval import Approval, Request
from .calls import Call

LIFT = "a person has to resume it: no verb of this tool lifts that"
NOBODY = "a person has to resume it: no verb of this tool does"


async def use(tree: RobotTree, call: Call, approval: Approval, by: str, motion: str = "") -> Answer:
    """``motion``: how to allow motion, where it is not; empty: it is. A stop is neither asked about
    nor held up. What the robot's own program is told to call is told in the tool's verbs."""
    return _in_its_verbs(await _use(tree, call, approval, by, motion), tree.driver)


async def perform(tree: RobotTree, call: Call, wait: bool = True) -> Answer:
    """Do a verb. Whoever asks for it may."""
    if call.kind == "stop":
        return await verbs.stop(tree)
    match call.verb.does:
        case "action" | "move_to":
            return await _command(tree, call, wait)
        case "service":
            return await verbs.service(tree, call.verb.name, call.inputs)
        case "torque":
            return await verbs.resume(tree, lift=False)  # an e-stop is an operator's to lift
        case "sensors":
            return await verbs.get_sensors(tree)
        case "state":
            return await verbs.get_state(tree)
    return await verbs.get_status(tree)


async def _command(tree: RobotTree, call: Call, wait: bool) -> Answer:
    """Do a verb that is a command: once, for some seconds, or as a motion in a time."""
    if call.verb.does == "move_to":
        seconds = call.inputs.get("seconds", moving.DEFAULT_S)
        return await moving.move_to(tree, call.action, seconds, wait)
    if call.held_s is not None:
        return await moving.hold(tree, call.verb.name, call.action, call.held_s, wait)
    return await verbs.send_action(tree, call.action)


def _in_its_verbs(answer: Answer, driver: Driver) -> Answer:
    """Return it with remedies that the tool has, in place of those of the robot's own program."""
    torque = next((verb.name for verb in driver.TOOL_VERBS if verb.does == "torque"), "")
    resume = f"{torque} with enabled=true energises it" if torque else NOBODY
    return answers.with_remedy(answer, {Code.DISARMED: resume, Code.FAULTED: resume, Code.LOCKED_OUT: LIFT})


def _action_of(driver: Driver, call: Call) -> dict[str, Any] | None:
    """Return the command that a call comes to; None: it is none."""
    if call.verb.does in ("action", "move_to"):
        return call.action
    service = driver.SERVICES.get(call.verb.name) if call.verb.does == "service" else None
    return verbs.action_of_service(service, call.inputs) if service is not None and service.acts else None


async def _use(tree: RobotTree, call: Call, approval: Approval, by: str, motion: str) -> Answer:
    verb = call.verb
    if call.kind == "motion":
        if motion:
            return answers.refused(Refused(Code.NO_MOTION, "motion is not allowed here", motion, verb=verb.name))
        if wrong := approval.guards_nothing(tree.driver):  # an operator believes to be asked
            return answers.refused(Refused(Code.GUARD, wrong, "mend guarded= of the robot", verb=verb.name))
        request = Request(tree.robot, verb.name, call.inputs, by)
        action = _action_of(tree.driver, call)
        keys = () if action is None else tree.driver.to_approve(action)
        rests = action is not None and not keys  # all velocities are zero: nobody is asked before a stop
        refusal = await approval.refuse(request, keys, call.asks and not rests)
        if refusal is not None:
            return answers.refused(refusal)
    return await perform(tree, call)
