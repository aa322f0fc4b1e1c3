"""A robot by its name alone: of this user's, or of those that the configuration leads to."""

from __future__ import annotations

import contextlib
import os
import secrets
from collections.abc import AsyncIterator

import trio

from strands_actors.caller.async_robot import open_tree
from strands_actors.caller.nodes import open_node
from strands_actors.caller.plan import plan
from strands_actors.caller.run_directory import notes
from strands_actors.caller.tree import RobotTree
from strands_actors.kernel.messages import Refused
from strands_actors.kernel.node import AskTimeout, Unreachable
from strands_actors.supervisors import addresses
from strands_actors.supervisors.mesh.gateway import Gateway
from strands_actors.supervisors.mesh.gateway_messages import Sync, Synced

from .config import MeshConfig

LOOK_S = 1.0
"""How long a robot of this host may take to appear; one elsewhere five times as long."""


@contextlib.asynccontextmanager
async def reach(robot: str, config: MeshConfig) -> AsyncIterator[RobotTree]:
    """Its tree, as it has it who did not start it: nothing is armed, and nothing stopped in the end
    that was released before. Raise ``ConnectionError``."""
    at, kind = await _find(robot, config)
    wanted = plan(kind, "real", at=at, mesh=config, tool_name=robot)
    async with open_tree(wanted, arm=False) as tree:
        yield tree


async def _find(robot: str, config: MeshConfig) -> tuple[str, str]:
    """Return where it listens, and what it is."""
    here = {note.robot: note.mesh[0] for note in notes() if note.mesh}
    if robot in here:
        found = await _ask(robot, here[robot], MeshConfig(), LOOK_S)
        if found is not None:
            return here[robot], found.kind
    for endpoint in config.connects:
        found = await _ask(robot, endpoint, config, 5 * LOOK_S)
        if found is not None:
            return endpoint, found.kind
    raise ConnectionError(f"{robot} is not on the mesh. these are: {', '.join(here) or 'none'} on this host")


async def _ask(robot: str, endpoint: str, config: MeshConfig, within_s: float) -> Synced | None:
    name = f"{config.own_prefix}visitor.{os.getpid()}.{secrets.token_hex(4)}"
    gateway = addresses.of(robot).gateway
    tokens = f"{gateway}/**/alive"
    settings = config.settings_for(robot)
    async with open_node(name, [], [endpoint], settings, tokens, private=[gateway]) as (node, _):
        with trio.move_on_after(within_s):
            while True:
                try:
                    answer = await node.ref(gateway, Gateway).ask(Sync(), within_s)
                except (AskTimeout, Unreachable):
                    await trio.sleep(0.02)
                    continue
                if isinstance(answer, Synced):
                    return answer
                if isinstance(answer, Refused):
                    raise ConnectionError(answer.text)
    return None
