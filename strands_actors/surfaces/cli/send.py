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


def send(robot: str, pairs: Sequence[str], seconds: float, resume: bool, mesh: Path | None, as_json: bool) -> int:
    """Send targets ``joint=number`` to a robot, and keep its lease for ``seconds``. Then the robot holds.

    Return 1 if the robot refused, else 0.
    """
    return trio.run(_send, robot, parse(pairs), seconds, resume, mesh, as_json)


def parse(pairs: Sequence[str]) -> dict[str, float]:
    """Return the targets of arguments ``joint=number``. Raise ``Problem`` for others."""
    targets: dict[str, float] = {}
    for pair in pairs:
        joint, equals, text = pair.partition("=")
        try:
            value = float(text)
        except ValueError:
            value = None
        if not joint or not equals or value is None:
            raise Problem(f"{pair!r} is no target. give joint=number, like shoulder_pan=10")
        if joint in targets:
            raise Problem(f"{joint} is named twice")
        targets[joint] = value
    return targets


async def _send(
    robot: str, targets: dict[str, float], seconds: float, resume: bool, mesh: Path | None, as_json: bool
) -> int:
    why = await borrow(robot, mesh, lambda tree: _keep(tree, targets, seconds, resume, as_json))
    return refuse(robot, "sent", why, as_json) if why else 0


async def _keep(tree: RobotTree, targets: dict[str, float], seconds: float, resume: bool, as_json: bool) -> str:
    """Send the target and keep the lease for ``seconds``. Return why that failed; empty if it succeeded.

    If the robot's targets have a short lifetime, the target is sent again until then.
    """
    answer: Message | None = await tree.resume() if resume else None
    if not isinstance(answer, Refused):
        answer = await tree.send_action(targets)
    if isinstance(answer, Accepted):
        _tell(tree.robot, tree.driver.commanded(targets, answer.values), seconds, as_json)
    deadline, ttl_s = trio.current_time() + seconds, tree.driver.timing.oneshot_ttl_s
    while not isinstance(answer, Refused) and (left := deadline - trio.current_time()) > 0:
        await trio.sleep(left if ttl_s is None else min(left, ttl_s / 2))
        if ttl_s is not None:
            answer = await tree.send_action(targets)
    return answer.text if isinstance(answer, Refused) else ""


def _tell(robot: str, answer: dict[str, Any], seconds: float, as_json: bool) -> None:
    if as_json:
        print(json.dumps({"robot": robot, "sent": True, **answer}), flush=True)
    else:
        commanded = answer.get("commanded", answer)
        shown = ", ".join(f"{joint} {value:g}" for joint, value in commanded.items() if isinstance(value, float))
        print(f"{robot}: {shown or commanded} ({answer.get('unit', '')}), for {seconds:g} s", flush=True)
