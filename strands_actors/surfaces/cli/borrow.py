"""Use a running robot whose lease is free, from any terminal, and give the lease back."""

from __future__ import annotations

import json
import sys
from collections.abc import Awaitable, Callable
from pathlib import Path

import trio

from strands_actors.caller import verbs
from strands_actors.caller.envelopes import Answer
from strands_actors.caller.processes import NotConnected
from strands_actors.caller.tree import RobotTree
from strands_actors.kernel.node import AskTimeout, Unreachable
from strands_actors.surfaces.mesh.reach import reach

from .errors import Problem
from .orders import configuration

REFUSED = 1
RELEASE_S = 1.0


async def borrow(robot: str, mesh: Path | None, use: Callable[[RobotTree], Awaitable[str]]) -> str:
    """Run ``use`` with a robot, then release it.

    Args:
        robot: Its name.
        mesh: How to reach robots elsewhere.
        use: Returns why it failed. Empty: it did not.

    Returns:
        Why ``use`` or the release failed. Empty: neither did.

    Raises:
        Problem: The mesh cannot be joined.
    """
    try:
        async with reach(robot, configuration(mesh)) as tree:
            released: Answer | None = None
            try:
                why = await use(tree)
            finally:
                with trio.move_on_after(RELEASE_S, shield=True):  # it holds; its own program may have it again
                    released = await verbs.release(tree)
            if why or (released is not None and released["status"] == "success"):
                return why
            return released["content"][0]["text"] if released is not None else "release: no answer"
    except ConnectionError as failure:  # nobody was asked
        raise Problem(str(failure)) from failure
    except (NotConnected, AskTimeout, Unreachable) as failure:
        return str(failure)


def refuse(robot: str, done: str, why: str, as_json: bool) -> int:
    """Print why something was not done. ``done``: its name in JSON.

    Returns:
        The command's exit code.
    """
    if as_json:
        print(json.dumps({"robot": robot, done: False, "detail": why}))
    else:
        print(f"strands-actors: {why}", file=sys.stderr)
    return REFUSED
