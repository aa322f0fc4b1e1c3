"""Join the mesh, wait for a robot, and pass its telemetry to a ``Viewer``."""

from __future__ import annotations

from collections.abc import Callable

import trio

from strands_actors.supervisors.mesh.schemas import EVENT_KEY, TELEMETRY, camera_topic, is_name, key
from strands_actors.surfaces.mesh.client import MeshClient
from strands_actors.surfaces.mesh.sessions import LOOK_S

from .model import NoModel, read_model
from .viewer import Viewer

PRESENCE_S = 3.0
"""How long to wait for the robot's type. A robot publishes it twice a second."""


class NotRunning(Exception):
    """The robot does not run. The text has the reason and the robots that run."""


async def find(client: MeshClient, robot: str, waits: bool, on_wait: Callable[[], None]) -> None:
    """Return when the robot is on the mesh.

    Args:
        client: The client of the mesh.
        robot: The robot's name.
        waits: Wait until the robot runs. Otherwise it must run already.
        on_wait: Called once if it does not run yet.

    Raises:
        NotRunning: The robot does not run, and ``waits`` is False; or its name is not valid.
    """
    if not is_name(robot):
        raise NotRunning(f"{robot!r} is not a robot's name. Give a name as `strands-actors tree` shows it")
    await client.settle()
    if client.is_there(robot):
        return
    if not waits:
        running = ", ".join(client.robots)
        remedy = f"These robots run: {running}" if running else "No robot runs"
        raise NotRunning(f"robot {robot} does not run. {remedy}. Start it, or wait for it with --wait")
    on_wait()
    while not client.is_there(robot):
        with trio.move_on_after(LOOK_S):
            await client.sessions.appeared.wait()


async def watch(client: MeshClient, viewer: Viewer, with_cameras: bool, with_model: bool, file: str = "") -> None:
    """Show the robot until cancelled. If the robot ends and is started again, it is shown again.

    Args:
        client: The client of the mesh.
        viewer: Shows the robot.
        with_cameras: Subscribe to the robot's cameras, too. A camera compresses its pictures only for subscribers.
        with_model: Show the robot's model in 3-D.
        file: A model file of the user, for a robot that is simulated from it.
    """
    topics = [*TELEMETRY, camera_topic("*")] if with_cameras else TELEMETRY
    for topic in topics:
        client.subscribe(key(viewer.robot, topic), viewer.receive)
    client.subscribe(EVENT_KEY, viewer.receive)
    async with trio.open_nursery() as nursery:
        if with_model:
            nursery.start_soon(_show_model, viewer, file)
        while True:
            await trio.sleep(LOOK_S / 2)
            viewer.look()


async def _show_model(viewer: Viewer, file: str) -> None:
    with trio.move_on_after(PRESENCE_S):
        await viewer.identified.wait()
    if viewer.presence is None:
        viewer.problem("the robot has not published its type, so its model is not shown")
        return
    try:
        await viewer.show_model(await read_model(viewer.presence.hw, file))
    except NoModel as reason:
        viewer.problem(f"the model is not shown: {reason}")
