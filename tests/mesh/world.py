"""Run a robot in memory on a real mesh, and clients that observe it."""

from __future__ import annotations

import contextlib
import time
from collections.abc import AsyncIterator, Callable, Mapping
from pathlib import Path
from typing import Any

import msgspec
import trio

from strands_actors.caller.processes.run_directory import Name, Note
from strands_actors.kernel.channels.pubsub import Received
from strands_actors.kernel.channels.zenoh_session import unix_endpoint
from strands_actors.kernel.clock import MonotonicClock
from strands_actors.kernel.messages import Refused
from strands_actors.supervisors.gate.messages import Resume
from strands_actors.supervisors.mesh import schemas as mesh_json
from strands_actors.supervisors.mesh.service import MeshService
from strands_actors.supervisors.root.messages import TaskStatus
from strands_actors.surfaces.mesh.client import MeshClient, open_mesh
from strands_actors.surfaces.mesh.config import TLS, MeshConfig
from strands_actors.testing import FakeHardware, InlineTree, open_inline_tree

PATIENCE_S = 20.0
"""Longest wait for an event on a busy machine."""


@contextlib.asynccontextmanager
async def robot_on_mesh(
    hardware: FakeHardware | None = None, config: MeshConfig | Callable[[str], MeshConfig] | None = None
) -> AsyncIterator[tuple[str, InlineTree, MeshService]]:
    """Run an armed robot and yield its name, its tree and its service on the mesh. ``config`` may be a function
    of the name."""
    async with open_inline_tree(hardware, MonotonicClock()) as tree, trio.open_nursery() as nursery:
        robot = tree.gate.address.split("/")[1]
        name = Name(robot)
        endpoint = unix_endpoint(name.socket("mesh"))
        service = MeshService(tree.node, robot, tree.driver, TaskStatus)
        config = config(robot) if callable(config) else config or MeshConfig()
        nursery.start_soon(service.run, [endpoint, *config.listens], config.connects, config.robot_settings())
        await service.settled.wait()
        assert not service.problem
        name.publish(Note(robot, "fake", 0, [], [endpoint]))
        await tree.gate.ask(Resume("the test"), 5.0)
        await tree.until("armed")
        try:
            yield robot, tree, service
        finally:
            service.close()
            name.release()
            nursery.cancel_scope.cancel()


@contextlib.asynccontextmanager
async def mesh(config: MeshConfig | None = None, **keywords: Any) -> AsyncIterator[MeshClient]:
    async with open_mesh(config or MeshConfig(), **keywords) as client:
        await client.settle()
        yield client


def run(test: Callable[[], Any]) -> None:
    async def limited() -> None:
        with trio.fail_after(60):
            await test()

    trio.run(limited)


async def until(look: Callable[[], Any], what: str, within_s: float = PATIENCE_S) -> Any:
    deadline = time.monotonic() + within_s
    while not (seen := look()):
        assert time.monotonic() < deadline, f"not within {within_s:g} s: {what}"
        await trio.sleep(0.005)
    return seen


class Samples:
    """All samples of a key."""

    def __init__(self, client: MeshClient, key: str) -> None:
        self.received: list[Received] = []
        client.subscribe(key, self.received.append)

    async def wait(self, count: int = 1) -> list[dict[str, Any]]:
        await until(lambda: len(self.received) >= count, f"{count} samples, there are {self.received}")
        return [msgspec.json.decode(received.payload) for received in self.received]


async def raw(client: MeshClient, robot: str, payload: bytes, key: str = "cmd") -> None:
    """Send a payload that the client itself would never send."""
    await until(lambda: client.is_there(robot), "it is there")
    client.sessions.via[robot].put(mesh_json.key(robot, key) if "/" not in key else key, payload, "x")


def code(answer: Mapping[str, Any] | Refused) -> str:
    assert isinstance(answer, Refused), answer
    return answer.code


def tls(directory: Path, name: str) -> TLS:
    return TLS(str(directory / "ca.pem"), str(directory / f"{name}.pem"), str(directory / f"{name}.key"))
