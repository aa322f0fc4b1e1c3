"""Use a running robot whose lease is free, from any terminal, and give the lease back."""

from __future__ import annotations

import json
import sys
from collections.abc import Awaitable, Callable
from pathlib import Path

import trio

from strands_actors.caller.handle import verbs
from strands_actors.caller.handle.envelopes import Answer
from strands_actors.caller.processes.robot_processes import NotConnected
from strands_actors.caller.session.tree import RobotTree
from strands_actors.kernel.node import AskTimeout, Unreachable
from strands_actors.surfaces.mesh.reach import reach

from .errors import Problem
from .orders import configuration

REFUSED = 1
RELEASE_S = 1.0


async def borrow(robot: str, mesh: Path | None, use: Callable[[RobotTree], Awaitable[str]]) -> str:
    """Run ``use`` with a robot, then release the robot's lease.

    Args:
        robot: The robot's name.
        mesh: A TOML file with the endpoints of robots on other hosts; None for this user's robots.
        use: Uses the robot. Returns why it failed; empty if it succeeded.

    Returns:
        Why ``use`` or the release failed; empty if both succeeded.

    Raises:
        Problem: The mesh cannot be joined.
    """
    try:
        async with reach(robot, configuration(mesh)) as tree:
            released: Answer | None = None
            try:
                why = await use(tree)
            finally:
                # After the release the robot holds, and its own program may acquire the lease again.
                with trio.move_on_after(RELEASE_S, shield=True):
                    released = await verbs.release(tree)
            if why or (released is not None and released["status"] == "success"):
                return why
            return released["content"][0]["text"] if released is not None else "release: no answer"
    except ConnectionError as failure:  # no request was sent
        raise Problem(str(failure)) from failure
    except (NotConnected, AskTimeout, Unreachable) as failure:
        return str(failure)


def refuse(robot: str, done: str, why: str, as_json: bool) -> int:
    """Print why a command failed, and return its exit code.

    Args:
        robot: The robot's name.
        done: The key in the JSON output that is false.
        why: The reason.
        as_json: Print JSON.
    """
    if as_json:
        print(json.dumps({"robot": robot, done: False, "detail": why}))
    else:
        print(f"strands-actors: {why}", file=sys.stderr)
    return REFUSED
