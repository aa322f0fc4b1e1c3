"""A policy process that lies: it calls itself the gate, resumes, and takes its caller's lease by the holder's name."""

from __future__ import annotations

import trio

from strands_actors.contract.driver import Reason
from strands_actors.kernel.actor import Actor
from strands_actors.supervisors import addresses
from strands_actors.supervisors.messages import Acquire, Resume, Stop, StopReport

from .links import Net, SimMesh
from .plan import CALLER


class Liar(Actor):
    """Says that the robot is safe."""

    def receive(self, message: Stop | Resume) -> StopReport | None:
        if isinstance(message, Resume):
            return None
        return StopReport(message.reason, "limp", 1 << 30, True, ())


def attack(net: Net) -> None:
    """Have the policy process do so, if there is one."""
    for session in net.sessions:
        if session.network == "policy" and not session.process.dead and session.process.role == "policy":
            session.process.post(lambda session=session: _lie(session))  # type: ignore[misc]


def _lie(session: SimMesh) -> None:
    node = session.node
    at = addresses.of("explored")
    gate = node.ref(at.gate)
    gate.tell(Stop(Reason.POLICY))
    gate.tell(Resume("policy"))
    gate.tell(Acquire(CALLER))
    liar = node.cell(at.path("gate"), Liar)
    trio.lowlevel.spawn_system_task(liar.run)
