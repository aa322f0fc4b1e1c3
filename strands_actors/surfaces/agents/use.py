"""A call becomes a message to the actors, or a refusal. Every surface of others comes through
here."""

from __future__ import annotations

from strands_actors.caller import envelopes as answers
from strands_actors.caller import verbs
from strands_actors.caller.envelopes import Answer
from strands_actors.caller.tree import RobotTree
from strands_actors.kernel.messages import Refused

from .approval import Approval, Request
from .calls import Call


async def use(tree: RobotTree, call: Call, approval: Approval, by: str, motion: str = "") -> Answer:
    """``motion``: how to allow motion, where it is not; empty: it is. A stop is neither asked about
    nor held up."""
    verb = call.verb
    if call.kind == "stop":
        return await verbs.stop(tree)
    if call.kind == "motion":
        if motion:
            return answers.refused(Refused("no_motion", f"{verb.name}: motion is not allowed here", motion))
        request = Request(tree.robot, verb.name, call.inputs, by)
        keys = tree.driver.to_approve(call.action) if verb.does == "action" else ()
        refusal = await approval.refuse(request, keys)
        if refusal is not None:
            return answers.refused(refusal)
    match verb.does:
        case "action":
            return await verbs.send_action(tree, call.action)
        case "service":
            return await verbs.service(tree, verb.name, call.inputs)
        case "torque":
            return await verbs.resume(tree, lift=False)  # an e-stop is an operator's to lift
        case "sensors":
            return await verbs.get_sensors(tree)
        case "state":
            return await verbs.get_state(tree)
    return await verbs.get_status(tree)
