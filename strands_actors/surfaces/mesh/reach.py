"""Connect to a running robot by its name. It may belong to this user, or be at an endpoint of the mesh
configuration."""

from __future__ import annotations

import contextlib
import os
import secrets
from collections.abc import AsyncIterator

import trio

from strands_actors.caller.handle.async_robot import open_tree
from strands_actors.caller.processes.nodes import open_node
from strands_actors.caller.processes.run_directory import notes
from strands_actors.caller.resolve.planning import plan
from strands_actors.caller.session.tree import RobotTree
from strands_actors.kernel.messages import Refused
from strands_actors.kernel.node import AskTimeout, Unreachable
from strands_actors.supervisors import addresses
from strands_actors.supervisors.mesh.gateway import Gateway
from strands_actors.supervisors.mesh.gateway_messages import Sync, Synced

from .config import MeshConfig

LOOK_S = 1.0
"""How long a robot of this host may take to appear. A robot on another host may take five times as long."""


@contextlib.asynccontextmanager
async def reach(robot: str, config: MeshConfig) -> AsyncIterator[RobotTree]:
    """Connect to a robot that another program has started.

    The robot's motors are not energised. At the end of the block the robot is stopped only if this program
    still holds the lease (the right to command).

    Raises:
        ConnectionError: The robot was not found, or it has refused the connection.
    """
    endpoint, robot_type = await _find(robot, config)
    robot_plan = plan(robot_type, "real", at=endpoint, mesh=config, tool_name=robot)
    async with open_tree(robot_plan, arm=False) as tree:
        yield tree


async def _find(robot: str, config: MeshConfig) -> tuple[str, str]:
    """Return the robot's endpoint and kind."""
    local_endpoints = {note.robot: note.mesh[0] for note in notes() if note.mesh}
    if robot in local_endpoints:
        synced = await _ask(robot, local_endpoints[robot], MeshConfig(), LOOK_S)
        if synced is not None:
            return local_endpoints[robot], synced.kind
    for endpoint in config.connects:
        synced = await _ask(robot, endpoint, config, 5 * LOOK_S)
        if synced is not None:
            return endpoint, synced.kind
    raise ConnectionError(
        f"{robot} is not on the mesh. Robots on this host: {', '.join(local_endpoints) or 'none'}"
    )


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
