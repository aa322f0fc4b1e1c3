"""Start one robot, and start it again when its processes have ended. Nothing here energises a robot."""

from __future__ import annotations

import enum
import logging
import os
from dataclasses import dataclass

import msgspec
import trio

from strands_actors.caller.handle import envelopes as answers
from strands_actors.caller.processes.nodes import Entrance
from strands_actors.caller.resolve.planning import completed
from strands_actors.caller.session.tree import RobotTree
from strands_actors.contract.wire import WireDown
from strands_actors.kernel.node import Node

from .adapters import Adapters
from .fleet import RobotSpec

PAUSES_S = (0.5, 1.0, 2.0, 4.0, 8.0, 15.0)
"""Pauses before the next attempts to start a robot. The last one is repeated."""
LOOK_S = 0.1
"""Period of the check if the robot's processes run."""
GUARD_S = 0.5
"""Longest time for an answer of the guardian."""
SILENT_LOOKS = 4
"""Answers of the guardian that may be missing in a row. Then the robot's processes are ended and started again."""

_log = logging.getLogger("strands_actors")


class Phase(enum.StrEnum):
    """The phase of a robot: the host starts it, keeps it, waits to try again, or stops it."""

    STARTING = "starting"
    UP = "up"  # its processes run, and its link was up once
    WAITING = "waiting"  # it could not be started, and will be tried again
    STOPPING = "stopping"


class RobotStatus(msgspec.Struct, frozen=True):
    """The status of one robot of the host.

    Attributes:
        name: Its name.
        type: Its type.
        phase: Its ``Phase``.
        reason: Why it is not up, or why its link is down; empty if it is well.
        retry_s: Seconds to the next attempt; 0 if it does not wait for one.
        starts: How often its processes were started.
        state: The robot's state, such as ``disarmed``; empty if it does not answer.
        holder: The program that holds the lease; empty if it is free.
        locked_by: The operator of an e-stop that locks it; empty without a lock.
        port: Its port; empty for a simulated robot.
        adapter: Serial number of its USB adapter, if it is known.
    """

    name: str
    type: str
    phase: str
    reason: str = ""
    retry_s: float = 0.0
    starts: int = 0
    state: str = ""
    holder: str = ""
    locked_by: str = ""
    port: str = ""
    adapter: str = ""


@dataclass(frozen=True)
class Ground:
    """What all robots of a host share: its node, its tasks, the address at which it listens, and its adapters."""

    node: Node
    nursery: trio.Nursery
    entrance: Entrance
    adapters: Adapters


class Keeper:
    """Keeps one robot. ``run`` starts it and keeps it until it is cancelled.

    Args:
        spec: The robot.
        ground: What all robots of the host share.
    """

    def __init__(self, spec: RobotSpec, ground: Ground) -> None:
        self.spec = spec
        self._ground = ground
        self._tree: RobotTree | None = None
        self._phase = Phase.STARTING
        self._reason = ""
        self._retry_at = 0.0
        self._retry = trio.Event()
        self._starts = 0
        self._port = ""
        self._silent_looks = 0
        self.settled = trio.Event()
        """Set when the first attempt has ended: the robot is up, or the reason why not is known."""
        self.ended = trio.Event()
        """Set when ``run`` has ended, and the robot with it."""

    async def run(self) -> None:
        pauses = iter(PAUSES_S)
        try:
            while True:
                self._phase = Phase.STARTING
                reason = await self._start()
                if not reason:
                    pauses = iter(PAUSES_S)
                    reason = await self._until_end()
                await self._end()
                await self._wait(reason, next(pauses, PAUSES_S[-1]))
        finally:
            self._phase = Phase.STOPPING
            with trio.CancelScope(shield=True):
                await self._end()
            self.ended.set()

    def hurry(self) -> None:
        """Start a robot that waits for its next attempt now."""
        self._retry.set()

    async def _start(self) -> str:
        """Start the robot's processes. Return why that failed; empty if it is up."""
        spec, ground = self.spec, self._ground
        self._starts += 1
        try:
            plan = spec.plan()
            self._port = "" if plan.twin_process is not None else plan.port
            if problem := self._problem_of_port():
                return problem
            plan = await completed(plan)
        except (TypeError, ValueError, ImportError, WireDown) as error:
            return str(error)
        self._tree = tree = RobotTree(ground.node, ground.nursery, ground.entrance, plan)
        failure = await tree.connect(arm=False)
        if failure is not None:
            return failure
        if self._port:
            ground.adapters.remember(spec.name, self._port)
        self._phase, self._reason = Phase.UP, ""
        self._silent_looks = 0
        _log.info("%s: up, disarmed", spec.name)
        self.settled.set()
        return ""

    def _problem_of_port(self) -> str:
        """Return why the robot cannot be at its port; empty if it may be."""
        port = self._port
        if not os.path.isabs(port):
            return ""
        if problem := self._ground.adapters.problem_of(self.spec.name, port, self.spec.adapter):
            return problem
        # Without this check, each attempt would start all processes of the robot.
        return "" if os.path.exists(port) else f"there is no device {port}. Plug it in, or correct port"

    async def _until_end(self) -> str:
        """Wait until the robot's processes have ended, or its guardian is silent. Return the reason."""
        tree = self._tree
        assert tree is not None
        while tree.alive:
            if self._silent_looks >= SILENT_LOOKS:
                return "its guardian did not answer, so its processes were ended"
            await trio.sleep(LOOK_S)
        return "its root process ended"

    async def _end(self) -> None:
        """Make the robot safe, and end its processes."""
        tree, self._tree = self._tree, None
        if tree is not None:
            answers.warn_unless_safe(tree.robot, answers.stop_result("cleanup", await tree.cleanup()))

    async def _wait(self, reason: str, pause_s: float) -> None:
        if reason != self._reason:
            _log.warning("%s: %s. It is tried again", self.spec.name, reason)
        self._phase, self._reason = Phase.WAITING, reason
        self._retry_at = trio.current_time() + pause_s
        self._retry = trio.Event()
        self.settled.set()
        with trio.move_on_after(pause_s):
            await self._retry.wait()

    # -- for the host

    async def guard(self) -> bool:
        """Return False if the robot is up and its guardian does not answer."""
        tree = self._tree
        if tree is None or self._phase is not Phase.UP or await tree.is_guarded(GUARD_S):
            self._silent_looks = 0
            return True
        self._silent_looks += 1
        return False

    async def status(self) -> RobotStatus:
        """Return the status. The gate is asked, and never the wire."""
        tree = self._tree
        waits_s = self._retry_at - trio.current_time() if self._phase is Phase.WAITING else 0.0
        own = RobotStatus(
            self.spec.name,
            self.spec.type,
            self._phase,
            self._reason,
            max(0.0, waits_s),
            self._starts,
            port=self._port,
            adapter=self._ground.adapters.serials.get(self.spec.name, "") if self._port else "",
        )
        status = None if tree is None or self._phase is not Phase.UP else await tree.status()
        if status is None:
            return own
        return msgspec.structs.replace(
            own,
            reason=own.reason or status.connect_error,
            state=str(status.mode),
            holder=status.holder,
            locked_by=status.locked_by,
        )
