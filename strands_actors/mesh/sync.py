"""The mesh for programs without trio."""

from __future__ import annotations

from ..portal import portal
from ..runtime.messages import Refused
from ..supervisors.mesh_json import ESTOP_ANSWER_S
from .client import open_mesh
from .config import MeshConfig
from .outcome import Outcome


def estop(*, mesh: MeshConfig | None = None, by: str = "", within_s: float = ESTOP_ANSWER_S) -> list[Outcome]:
    """Every robot on the mesh goes safe, and is locked until it is resumed. What became of each that is known,
    within ``within_s``: safe, unconfirmed or unreachable. Call it from any thread."""

    async def run() -> list[Outcome]:
        async with open_mesh(mesh) as client:
            return await client.estop(by, within_s)

    return portal().call(run)


def resume(robot: str, *, mesh: MeshConfig | None = None, by: str = "") -> None:
    """Lift the lockout of one robot and energise it at the measured position. Raise ``PermissionError`` with its
    refusal."""

    async def run() -> None:
        async with open_mesh(mesh) as client:
            answer = await client.resume(robot, by)
        if isinstance(answer, Refused):
            raise PermissionError(answer.text)

    portal().call(run)
