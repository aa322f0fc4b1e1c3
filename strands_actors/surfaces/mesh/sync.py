"""The mesh for programs without trio."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, wait
from typing import Any

import trio

from strands_actors.caller.portal import portal
from strands_actors.kernel.messages import Refused
from strands_actors.supervisors.mesh.schemas import ESTOP_ANSWER_S

from .client import AWAY_S, MeshClient, open_mesh
from .config import MeshConfig
from .outcome import Outcome


def estop(*, mesh: MeshConfig | None = None, by: str = "", within_s: float = ESTOP_ANSWER_S) -> list[Outcome]:
    """Every robot on the mesh goes safe, and is locked until it is resumed. What became of each
    that is known, within ``within_s``: safe, unconfirmed or unreachable. Call it from any
    thread."""

    async def run() -> list[Outcome]:
        async with open_mesh(mesh) as client:
            return await client.estop(by, within_s)

    return portal().call(run)


@contextlib.contextmanager
def estop_button(*, mesh: MeshConfig | None = None, by: str = "") -> Iterator[Callable[[], list[Outcome]]]:
    """For whoever may have to stop at any moment: join the mesh now, wait for its robots (half a
    second, if one does not come), and stay. Gives a function that does as ``estop`` does. Call it
    from any thread, as often as need be: the order leaves in that thread, before anything is waited
    for. Raise ``ValueError`` for a configuration that cannot be used."""
    joined: Future[MeshClient] = Future()

    async def stay() -> None:
        async with open_mesh(mesh) as client:
            await client.settle()  # else the first order could leave before anybody is there to hear it
            joined.set_result(client)
            await trio.sleep_forever()

    staying = portal().submit(stay)
    either: list[Future[Any]] = [joined, staying]
    wait(either, return_when=FIRST_COMPLETED)
    if staying.done():
        staying.result()  # raises why it could not
    client = joined.result()

    def press() -> list[Outcome]:
        if staying.done():
            raise RuntimeError("the button's block has been left. Press it inside, or call estop()")
        pressed = client.press(by)
        time.sleep(AWAY_S)
        return portal().call(client.outcomes, pressed, ESTOP_ANSWER_S - AWAY_S)

    try:
        yield press
    finally:
        staying.cancel()


def resume(robot: str, *, mesh: MeshConfig | None = None, by: str = "") -> None:
    """Lift the lockout of one robot and energise it at the measured position. Raise
    ``PermissionError`` with its refusal."""

    async def run() -> None:
        async with open_mesh(mesh) as client:
            answer = await client.resume(robot, by)
        if isinstance(answer, Refused):
            raise PermissionError(answer.text)

    portal().call(run)
