"""``send``: send one target to a robot, from any terminal."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import trio

from strands_actors.caller.session.tree import RobotTree
from strands_actors.kernel.messages import Message, Refused
from strands_actors.supervisors.gate.messages import Accepted

from .borrow import borrow, refuse
from .errors import Problem
from .remedies import of_motion, with_remedy


def send(robot: str, pairs: Sequence[str], seconds: float, resume: bool, mesh: Path | None, as_json: bool) -> int:
    """Move a robot to targets ``joint=number``, and keep the right to command it for ``seconds``.

    Afterwards the robot holds its position. Return 1 if the robot refused, else 0.
    """
    return trio.run(_send, robot, parse(pairs), seconds, resume, mesh, as_json)


def parse(pairs: Sequence[str]) -> dict[str, float]:
    """Return the targets from arguments ``joint=number``. Raise ``Problem`` for an argument of another form."""
    targets: dict[str, float] = {}
    for pair in pairs:
        joint, equals, text = pair.partition("=")
        try:
            value = float(text)
        except ValueError:
            value = None
        if not joint or not equals or value is None:
            raise Problem(f"{pair!r} is not a target. Give joint=number, like shoulder_pan=10")
        if joint in targets:
            raise Problem(f"{joint} has two targets. Give one")
        targets[joint] = value
    return targets


async def _send(
    robot: str, targets: dict[str, float], seconds: float, resume: bool, mesh: Path | None, as_json: bool
) -> int:
    problem = await borrow(robot, mesh, lambda tree: _keep(tree, targets, seconds, resume, as_json))
    return refuse(robot, "sent", problem, as_json) if problem else 0


async def _keep(tree: RobotTree, targets: dict[str, float], seconds: float, resume: bool, as_json: bool) -> str:
    """Send the targets, and keep the lease (the right to command) for ``seconds``. Return why this failed, or
    an empty text.

    If targets of this robot expire quickly, they are sent again and again for ``seconds``.
    """
    answer: Message | None = await tree.resume() if resume else None
    if not isinstance(answer, Refused):
        answer = await tree.send_action(targets)
    if isinstance(answer, Accepted):
        _tell(tree.robot, tree.driver.commanded(targets, answer.values), seconds, as_json)
    deadline, ttl_s = trio.current_time() + seconds, tree.driver.timing.oneshot_ttl_s
    while not isinstance(answer, Refused) and (left_s := deadline - trio.current_time()) > 0:
        await trio.sleep(left_s if ttl_s is None else min(left_s, ttl_s / 2))
        if ttl_s is not None:
            answer = await tree.send_action(targets)
    if isinstance(answer, Refused):
        return with_remedy(answer, of_motion(tree.robot, resume)).text
    return ""


def _tell(robot: str, answer: dict[str, Any], seconds: float, as_json: bool) -> None:
    if as_json:
        print(json.dumps({"robot": robot, "sent": True, **answer}), flush=True)
    else:
        commanded = answer.get("commanded", answer)
        shown = ", ".join(f"{joint} {value:g}" for joint, value in commanded.items() if isinstance(value, float))
        print(f"{robot}: {shown or commanded} ({answer.get('unit', '')}), for {seconds:g} s", flush=True)
