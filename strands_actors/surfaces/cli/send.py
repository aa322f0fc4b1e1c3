"""``send``: one target for a robot, from any terminal."""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import trio

from strands_actors.caller import verbs
from strands_actors.caller.envelopes import Answer
from strands_actors.caller.processes import NotConnected
from strands_actors.caller.tree import RobotTree
from strands_actors.kernel.messages import Message, Refused
from strands_actors.kernel.node import AskTimeout, Unreachable
from strands_actors.supervisors.gate.messages import Accepted
from strands_actors.surfaces.mesh.reach import reach

from .errors import Problem
from .orders import configuration

REFUSED = 1
RELEASE_S = 1.0


def send(robot: str, pairs: Sequence[str], seconds: float, resume: bool, mesh: Path | None, as_json: bool) -> int:
    return trio.run(_send, robot, parse(pairs), seconds, resume, mesh, as_json)


def parse(pairs: Sequence[str]) -> dict[str, float]:
    """``joint=number`` each. Raise ``Problem``."""
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
    try:
        async with reach(robot, configuration(mesh)) as tree:
            released: list[Answer] = []
            try:
                code = await _keep(tree, targets, seconds, resume, as_json)
            finally:
                with trio.move_on_after(RELEASE_S, shield=True):  # it holds; its own program may have it again
                    released.append(await verbs.release(tree))
            if code or (released and released[0]["status"] == "success"):
                return code
            told = released[0]["content"][0]["text"] if released else "release: no answer"
            return _refuse(robot, told, as_json)
    except ConnectionError as failure:  # nobody was asked
        raise Problem(str(failure)) from failure
    except (NotConnected, AskTimeout, Unreachable) as failure:
        return _refuse(robot, str(failure), as_json)


async def _keep(tree: RobotTree, targets: dict[str, float], seconds: float, resume: bool, as_json: bool) -> int:
    """Hold the lease that long. A target that lives for a moment only is sent again."""
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
    return _refuse(tree.robot, answer.text, as_json) if isinstance(answer, Refused) else 0


def _refuse(robot: str, why: str, as_json: bool) -> int:
    if as_json:
        print(json.dumps({"robot": robot, "sent": False, "detail": why}))
    else:
        print(f"strands-actors: {why}", file=sys.stderr)
    return REFUSED


def _tell(robot: str, answer: dict[str, Any], seconds: float, as_json: bool) -> None:
    if as_json:
        print(json.dumps({"robot": robot, "sent": True, **answer}), flush=True)
    else:
        commanded = answer.get("commanded", answer)
        shown = ", ".join(f"{joint} {value:g}" for joint, value in commanded.items() if isinstance(value, float))
        print(f"{robot}: {shown or commanded} ({answer.get('unit', '')}), for {seconds:g} s", flush=True)
