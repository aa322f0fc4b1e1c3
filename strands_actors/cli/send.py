"""``send``: one target for a robot, from any terminal."""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import trio

from ..mesh.client import open_mesh
from ..mesh.remote import RemoteRobot, control
from ..runtime.messages import Refused
from .errors import Problem
from .orders import configuration

REFUSED = 1


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
    async with open_mesh(configuration(mesh)) as client:
        try:
            async with control(client, robot, resume) as remote:
                answer = await remote.send_action(targets)
                if isinstance(answer, Refused):
                    return _refuse(robot, answer.text, as_json)
                _tell(robot, answer, seconds, as_json)
                return await _keep(remote, targets, seconds, as_json)
        except PermissionError as refused:
            return _refuse(robot, str(refused), as_json)


async def _keep(remote: RemoteRobot, targets: dict[str, float], seconds: float, as_json: bool) -> int:
    """Hold the lease that long. A target that lives for a moment only is sent again."""
    deadline = trio.current_time() + seconds
    while (left := deadline - trio.current_time()) > 0:
        if remote.oneshot_ttl_s is None:
            await trio.sleep(left)
            break
        await trio.sleep(min(left, remote.oneshot_ttl_s / 2))
        answer = await remote.send_action(targets)
        if isinstance(answer, Refused):
            return _refuse(remote.robot, answer.text, as_json)
    return 0


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
