"""Command a running robot from any terminal for a short time.

This needs the robot's lease (the right to command), so no other program may hold it. Afterwards the lease is
released.
"""

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
    """Call ``use`` with a robot, then release the robot's lease (the right to command).

    Args:
        robot: The robot's name.
        mesh: A TOML file with the endpoints of robots on other hosts; None for this user's robots.
        use: Function that commands the robot. It returns why it failed, or an empty text.

    Returns:
        Why ``use`` or the release failed. Empty if both succeeded.

    Raises:
        Problem: The robot was not found, or the mesh configuration cannot be used.
    """
    try:
        async with reach(robot, configuration(mesh)) as tree:
            released: Answer | None = None
            try:
                problem = await use(tree)
            finally:
                # After the release the robot holds its position, and its own program may command it again.
                with trio.move_on_after(RELEASE_S, shield=True):
                    released = await verbs.release(tree)
            if problem or (released is not None and released["status"] == "success"):
                return problem
            return released["content"][0]["text"] if released is not None else "release: no answer"
    except ConnectionError as failure:  # The robot was not found, so no command was sent.
        raise Problem(str(failure)) from failure
    except (NotConnected, AskTimeout, Unreachable) as failure:
        return str(failure)


def refuse(robot: str, done: str, reason: str, as_json: bool) -> int:
    """Print why a command failed, and return its exit code.

    Args:
        robot: The robot's name.
        done: The key that is false in the JSON output, such as ``sent``.
        reason: The reason.
        as_json: Print JSON.
    """
    if as_json:
        print(json.dumps({"robot": robot, done: False, "detail": reason}))
    else:
        print(f"strands-actors: {reason}", file=sys.stderr)
    return REFUSED
