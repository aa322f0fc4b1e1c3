"""``ros2``: show robots on a ROS 2 graph, until interrupted."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from pathlib import Path

import trio

from strands_actors.kernel.channels.ros2.names import Dialect, problem_of
from strands_actors.surfaces.mesh.client import open_mesh
from strands_actors.surfaces.ros2.bridge import Options, open_bridge

from .errors import Problem
from .orders import configuration


def ros2(
    robots: list[str],
    domain: int,
    namespace: str,
    router: str,
    hashed: bool,
    allow_motion: bool,
    mesh: Path | None,
    as_json: bool,
) -> None:
    """Show robots on a ROS 2 graph.

    Args:
        robots: The names of the robots; empty for all.
        domain: The number of the ROS domain.
        namespace: The namespace of the nodes.
        router: The endpoint of the graph's zenoh router.
        hashed: False for ROS 2 Humble, which has no type hashes.
        allow_motion: Let the graph resume and move robots.
        mesh: A TOML file with the endpoints of robots on other hosts.
        as_json: Print JSON lines.

    Raises:
        Problem: An argument is wrong.
    """
    namespace = namespace.rstrip("/")
    if problem := problem_of(namespace, router):
        raise Problem(f"ros2: {problem}")
    options = Options(tuple(robots), namespace, Dialect(domain, hashed), router, allow_motion)
    trio.run(_serve, options, mesh, _printer(as_json))


async def _serve(options: Options, mesh: Path | None, log: Callable[[str], None]) -> None:
    async with open_mesh(configuration(mesh)) as client, open_bridge(client, options, log):
        log(f"connected to {options.router}, ROS domain {options.dialect.domain}. Ctrl-C ends this")
        await trio.sleep_forever()


def _printer(as_json: bool) -> Callable[[str], None]:
    def show(line: str) -> None:
        print(json.dumps({"log": line}) if as_json else line, file=sys.stdout, flush=True)

    return show
