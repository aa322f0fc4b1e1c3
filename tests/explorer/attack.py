"""A hostile policy process: it pretends to be the gate, sends ``Resume``, and requests its caller's lease
in the caller's name."""

from __future__ import annotations

import trio

from strands_actors.contract.safe_state import SafeState
from strands_actors.kernel.actor import Actor
from strands_actors.kernel.frames import ASK, frame
from strands_actors.supervisors import addresses
from strands_actors.supervisors.gate.messages import Acquire, Resume, Stop, StopReport

from .kinds import CALLER
from .links import Net, SimMesh

PESTER_S = 0.01


class Liar(Actor):
    """Always reports that the robot is safe."""

    def receive(self, message: Stop | Resume) -> StopReport | None:
        if isinstance(message, Resume):
            return None
        return StopReport(message.reason, SafeState.LIMP, 1 << 30, True, ())


def attack(net: Net) -> None:
    """Start the attack in the policy process, if there is one."""
    for session in net.sessions:
        if session.network == "policy" and not session.process.dead and session.process.role == "policy":
            session.process.post(lambda session=session: _lie(session))  # type: ignore[misc]


def _lie(session: SimMesh) -> None:
    liar = session.node.cell(addresses.of("explored").path("gate"), Liar)
    trio.lowlevel.spawn_system_task(liar.run)
    trio.lowlevel.spawn_system_task(_pester, session)


async def _pester(session: SimMesh) -> None:
    """Send the forged requests over the session of the rollout. They bypass the policy's node, where the
    liar has the gate's address."""
    gate = addresses.of("explored").gate
    number = 1 << 40
    while True:
        for message in (Resume("policy"), Acquire(CALLER)):
            number += 1
            session.send(gate, frame(gate, ASK, number, session.node.address, session.node.address, message))
        await trio.sleep(PESTER_S)
