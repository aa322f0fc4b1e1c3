"""The commands ``mesh keys`` and ``mesh status``."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import msgspec
import trio

from strands_actors.contract.shown import harmless
from strands_actors.kernel.channels.pubsub import Received
from strands_actors.kernel.messages import Refused
from strands_actors.supervisors.mesh.schemas import Status, key
from strands_actors.surfaces.mesh.client import MeshClient, open_mesh

from .errors import Problem
from .orders import configuration

PRESENCE_S = 0.7
"""How long to wait for every robot's presence, in seconds. It is published twice per second."""


def keys(
    directory: Path, robots: Sequence[str], hosts: Sequence[str], names: Sequence[str], days: int, as_json: bool
) -> None:
    """Make certificates, and a certificate authority if the folder does not have one. Print the paths of the
    files.

    Args:
        directory: The folder for the files.
        robots: Names of robots on the mesh.
        hosts: Host names by which other hosts connect to these robots.
        names: Names of further viewers or operators.
        days: How long the certificates are valid, in days.
        as_json: Print JSON.
    """
    try:
        from strands_actors.surfaces.mesh.keys import NAMES, make
    except ModuleNotFoundError as error:
        raise Problem(f"{error.name} is not installed: pip install 'strands-actors[mesh]'") from error
    # If the authority is new, also make certificates for an operator and a viewer. Otherwise make only the
    # requested certificates.
    usual = () if (directory / "ca.pem").exists() and (names or robots) else NAMES
    try:
        files = make(directory, tuple(dict.fromkeys((*usual, *names))), hosts, days, robots)
    except ValueError as error:
        raise Problem(f"mesh keys: {error}") from error
    if as_json:
        print(json.dumps({"files": [str(file) for file in files]}))
        return
    print("\n".join(str(file) for file in files))


def status(mesh: Path | None, as_json: bool) -> None:
    """Print the robots on the mesh and their states."""
    robots = trio.run(_status, mesh)
    if as_json:
        print(json.dumps({"robots": robots}))
        return
    if not robots:
        print("no robot is on the mesh")
    for robot in robots:
        print(harmless("  ".join(_words(robot))))


def _words(robot: dict[str, Any]) -> list[str]:
    words = [f"{robot['robot']:<16}", f"{robot['state']:<11}"]
    if robot["reachable"]:
        words += [
            f"{robot['hw']} on {robot['host']}",
            f"epoch {robot['epoch']}",
            f"answers in {robot['rtt_ms']} ms",
        ]
    if robot.get("lease"):
        words.append(f"moved by {robot['lease']}")
    if robot.get("locked_by"):
        words.append(f"e-stopped by {robot['locked_by']}")
    return words


async def _status(mesh: Path | None) -> list[dict[str, Any]]:
    presence: dict[str, dict[str, Any]] = {}
    has_all = trio.Event()
    rows: dict[str, dict[str, Any]] = {}

    def on_presence(received: Received) -> None:
        message = msgspec.json.decode(received.payload)
        if isinstance(message, dict):
            presence[received.key.split("/")[1]] = message
        if set(client.robots) <= set(presence):
            has_all.set()

    async with open_mesh(configuration(mesh)) as client:
        client.subscribe(key("*", "presence"), on_presence)
        await client.settle()
        with trio.move_on_after(PRESENCE_S):
            await has_all.wait()
        async with trio.open_nursery() as nursery:
            for robot in client.robots:
                nursery.start_soon(_ask, client, robot, presence.get(robot, {}), rows)
    return [rows[robot] for robot in sorted(rows)]


async def _ask(client: MeshClient, robot: str, presence: dict[str, Any], rows: dict[str, dict[str, Any]]) -> None:
    # A robot that was idle answers the first request late. So measure the time of the second request.
    await client.request(robot, Status())
    requested_s = trio.current_time()
    status = await client.request(robot, Status())
    took_ms = round(1e3 * (trio.current_time() - requested_s), 1)
    reachable = not isinstance(status, Refused)
    rows[robot] = {
        "robot": robot,
        "reachable": reachable,
        "state": presence.get("state", "unreachable"),
        "hw": presence.get("hw", ""),
        "host": presence.get("hostname", ""),
        "epoch": presence.get("epoch", 0),
        "rtt_ms": took_ms if reachable else None,
    }
    if not isinstance(status, Refused):
        rows[robot] |= {name: status[name] for name in ("state", "epoch", "lease", "locked_by")}
