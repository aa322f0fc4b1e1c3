"""``mcp``: serve a robot, or all robots, as a tool to an MCP client.

The client starts this command, and uses its standard input and output.
"""

from __future__ import annotations

import signal
from collections.abc import Awaitable, Callable
from pathlib import Path

import trio

from strands_actors.caller.handle.async_robot import AsyncRobot, open_tree
from strands_actors.caller.processes.background import open_background
from strands_actors.caller.processes.plan import Plan
from strands_actors.caller.resolve.planning import plan
from strands_actors.contract.extras import require
from strands_actors.surfaces.agents.approval import APPROVE_S, approval_of, ask_on_terminal
from strands_actors.surfaces.mesh.client import open_mesh

from .errors import Problem
from .orders import configuration


def serve_mcp(
    robot: str, port: str | None, transport: str | None, robot_id: str | None, allow_motion: bool
) -> None:
    """Serve a robot until the client closes standard input.

    Args:
        robot: The type of the robot.
        port: The port or address of a real robot.
        transport: ``twin`` for a simulated robot behind its real driver. Without ``transport`` and ``port``, a
            simulation is served.
        robot_id: The robot's id, which is also the name of the tool and of the robot's calibration. None: the type
            of the robot.
        allow_motion: Energise the robot, and accept commands that move it.

    Raises:
        Problem: The robot cannot be connected.
        KeyboardInterrupt: The user pressed Ctrl-C.
    """
    require("mcp", "mcp")
    options = {name: value for name, value in (("port", port), ("transport", transport)) if value is not None}
    try:
        planned = plan(robot, "real" if options else "sim", id=robot_id, **options)
    except (ValueError, TypeError) as refusal:
        raise Problem(f"mcp: {refusal}") from refusal

    async def serve() -> None:
        await _serve(planned, allow_motion)

    _run(serve)


def serve_fleet(mesh: Path | None, allow_motion: bool) -> None:
    """Serve the tool for all robots until the client closes standard input.

    Args:
        mesh: A TOML file with the endpoints of robots on other hosts.
        allow_motion: Accept tasks for robots. Each robot decides about its tasks.

    Raises:
        Problem: The mesh configuration cannot be used.
        KeyboardInterrupt: The user pressed Ctrl-C.
    """
    require("mcp", "mcp")
    config = configuration(mesh)

    async def serve() -> None:
        from strands_actors.surfaces.agents.fleet import ServedFleet
        from strands_actors.surfaces.agents.mcp_server import serve

        async with open_mesh(config) as client:
            await serve(ServedFleet(client), allow_motion, "All robots that can be reached.")

    _run(serve)


def _run(serve: Callable[[], Awaitable[None]]) -> None:
    """Serve until the client or Ctrl-C ends it."""
    interrupted, problem = False, ""
    try:
        interrupted = trio.run(_until_interrupted, serve)
    except* BrokenPipeError:
        pass  # The client has ended. The robot is safe, because ``open_tree`` has stopped it.
    except* ConnectionError as failures:
        problem = str(failures.exceptions[0])
    if interrupted:
        raise KeyboardInterrupt
    if problem:
        raise Problem(f"mcp: {problem}")


async def _until_interrupted(serve: Callable[[], Awaitable[None]]) -> bool:
    """Serve until the client or SIGINT ends it. Return True after SIGINT.

    SIGINT is received as an event. Otherwise Python would raise ``KeyboardInterrupt`` at any line, and the
    start or the end of the server could stay half done.
    """
    with trio.open_signal_receiver(signal.SIGINT) as signals, trio.CancelScope() as serving:

        async def interrupt() -> None:
            await anext(aiter(signals))
            serving.cancel()

        async with open_background() as nursery:
            nursery.start_soon(interrupt)
            await serve()
    return serving.cancelled_caught


async def _serve(planned: Plan, allow_motion: bool) -> None:
    from strands_actors.surfaces.agents.mcp_server import serve

    approval = approval_of(planned.driver_class, (), ask_on_terminal, APPROVE_S)
    async with open_tree(planned, arm=allow_motion) as tree:
        await serve(AsyncRobot(tree, approval), allow_motion)
