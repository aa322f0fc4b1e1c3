"""Command a robot of another process or host over the mesh.

    async with open_mesh(config) as mesh, control(mesh, "so101") as arm:
        await arm.send_action({"shoulder_pan": 10.0})

The block holds the lease (the right to command) while it runs, unless its event loop is blocked. If the
connection is cut, the lease ends a second after the last heartbeat. The robot holds its position when the last
setpoint expires, at the latest when the lease ends. Afterwards the robot accepts no command from the mesh before
a ``resume``.
"""

from __future__ import annotations

import contextlib
import logging
from collections.abc import AsyncIterator, Callable, Mapping
from typing import Any

import trio

from strands_actors.caller.processes.background import open_background
from strands_actors.kernel.clock import NS
from strands_actors.kernel.messages import Refused
from strands_actors.supervisors.mesh import schemas as mesh_json
from strands_actors.supervisors.mesh.schemas import Command

from .client import MeshClient, Reading
from .outcome import SAFE, UNREACHABLE, Outcome, outcome_of

_log = logging.getLogger("strands_actors")

BEAT_S = 0.2
COMMAND_S = 0.25
"""A command that has not reached the robot within this time is not carried out."""
RELEASE_S = 2.0


class RemoteRobot:
    """A robot for which this program holds the lease (the right to command). ``control`` makes it.

    Attributes:
        robot: The name of the robot.
        axes: The axes of the robot. Empty before the lease is held.
        unit: The unit of the axes.
        oneshot_ttl_s: Longest lifetime of a single command, in seconds. None means until the lease ends.
    """

    def __init__(self, mesh: MeshClient, robot: str) -> None:
        self.robot = robot
        self.axes: tuple[str, ...] = ()
        self.unit = ""
        self._mesh = mesh
        self._lease = self._epoch = 0
        self.oneshot_ttl_s: float | None = None

    async def acquire(self) -> Refused | None:
        """Acquire the lease (the right to command). Return None, or the refusal."""
        answer = await self._dated(
            lambda clock, deadline_ns: mesh_json.Acquire(clock=clock, deadline_ns=deadline_ns), COMMAND_S
        )
        if isinstance(answer, Refused):
            return answer
        self._lease, self._epoch = int(answer["lease"]), int(answer["epoch"])
        self.axes, self.unit = tuple(answer["axes"]), str(answer["unit"])
        self.oneshot_ttl_s = answer["oneshot_ttl_s"]
        return None

    async def send_action(
        self, targets: Mapping[str, float], ttl_s: float | None = None, period_s: float = 0.0
    ) -> dict[str, Any] | Refused:
        """Send a target for some joints. Return the accepted values, or the refusal.

        Args:
            targets: Targets by joint, in the driver's units.
            ttl_s: Lifetime of the target in seconds. Default: ``oneshot_ttl_s``.
            period_s: Period of the stream of targets, in seconds; 0 for a single target.
        """
        ttl_s = self.oneshot_ttl_s if ttl_s is None else ttl_s

        def make(clock: str, deadline_ns: int) -> Command:
            return mesh_json.Move(
                clock=clock,
                deadline_ns=deadline_ns,
                targets=dict(targets),
                lease=self._lease,
                epoch=self._epoch,
                period_s=period_s,
                latched=ttl_s is None,
            )

        return await self._dated(make, COMMAND_S if ttl_s is None else ttl_s)

    async def observe(self) -> dict[str, Any] | Refused:
        """Return ``joints`` by name, ``unit`` and ``age_s``, or a refusal."""
        return await self._mesh.request(self.robot, mesh_json.Observe())

    async def status(self) -> dict[str, Any] | Refused:
        return await self._mesh.request(self.robot, mesh_json.Status())

    async def stop(self, by: str = "") -> Outcome:
        """Stop the robot and return the result."""
        return await self._mesh.stop(self.robot, by)

    async def resume(self, by: str = "") -> Refused | None:
        """Energise the robot at the measured position and acquire the lease (the right to command). This starts
        no motion. Return None, or the refusal."""
        answer = await self._mesh.resume(self.robot, by)
        return answer if isinstance(answer, Refused) else await self.acquire()

    async def release(self) -> Outcome:
        """Release the lease (the right to command), and return the result. If the robot is moving to a target,
        it holds its position."""
        lease, self._lease = self._lease, 0
        answer = await self._mesh.request(self.robot, mesh_json.Release(lease), RELEASE_S)
        if isinstance(answer, Refused):
            return Outcome(self.robot, UNREACHABLE, answer.text)
        return outcome_of(self.robot, answer)

    async def beat(self) -> None:
        """Send heartbeats that keep the lease (the right to command), until cancelled."""
        while True:
            await trio.sleep(BEAT_S)
            if self._lease:
                clock = await self._mesh.clock(self.robot)
                if isinstance(clock, Reading):
                    deadline_ns = self._deadline(clock, COMMAND_S)
                    beat = mesh_json.Beat(clock=clock.name, deadline_ns=deadline_ns, lease=self._lease)
                    await self._mesh.post(self.robot, beat)

    async def _dated(self, make: Callable[[str, int], Command], ttl_s: float) -> dict[str, Any] | Refused:
        return await self._mesh.dated(self.robot, make, ttl_s)

    def _deadline(self, clock: Reading, ttl_s: float) -> int:
        return clock.deadline(self._mesh.now_ns() + round(ttl_s * NS))


@contextlib.asynccontextmanager
async def control(mesh: MeshClient, robot: str, resume: bool = False) -> AsyncIterator[RemoteRobot]:
    """Hold the lease of a robot (the right to command it) while the block runs.

    Args:
        mesh: The mesh.
        robot: The name of the robot.
        resume: Energise the robot first.

    Raises:
        PermissionError: The robot has refused. The message is the robot's refusal.
    """
    remote = RemoteRobot(mesh, robot)
    refused = await (remote.resume() if resume else remote.acquire())
    if refused is not None:
        raise PermissionError(refused.text)
    async with open_background() as nursery:
        nursery.start_soon(remote.beat)
        try:
            yield remote
        finally:
            with trio.CancelScope(shield=True):
                outcome = await remote.release()
            if outcome.outcome != SAFE:
                _log.warning("%s: its release is not confirmed: %s", robot, outcome.detail or outcome.outcome)
