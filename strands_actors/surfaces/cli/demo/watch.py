"""Watch a running robot: sample its state, its processes, and the frames on its wire. No commands are sent."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import trio

from strands_actors.caller.handle.envelopes import Answer
from strands_actors.caller.handle.robot import RealRobot
from strands_actors.caller.session.portal import portal
from strands_actors.kernel.node import AskTimeout, Ref, Unreachable
from strands_actors.kernel.processes.process import state_of
from strands_actors.supervisors import addresses
from strands_actors.supervisors.gate.gate import Gate
from strands_actors.supervisors.gate.messages import GetStatus, Status
from strands_actors.supervisors.root.messages import Describe, ProcessInfo, TreeReport
from strands_actors.supervisors.root.process import Root

from .wire import Wire

SAMPLE_S = 0.02
TREE_S = 0.2
ASK_S = 0.25


class Sample(NamedTuple):
    """The measured position or the target of every axis at one time."""

    t_ns: int
    values: tuple[float, ...]


class Watch:
    """Samples a robot in the background, from ``start`` to ``stop``."""

    def __init__(self, robot: RealRobot, log: Path) -> None:
        self.wire = Wire(log)
        self.positions: list[Sample] = []
        self.targets: list[Sample] = []  # The targets while setpoints move the robot.
        self.status: Status | None = None  # The newest status. None if the wire process does not answer.
        self.tree: TreeReport | None = None  # The newest report of the root process about the robot's processes.
        self.unit = ""
        self.axes: tuple[str, ...] = ()
        self._robot = robot
        self._pids: dict[str, list[int]] = {}
        self._ended = False

    def start(self) -> None:
        """Start sampling. The robot must be connected."""
        self.unit = status_of(self._robot)["unit"]
        self.axes = tuple(self._robot.get_observation())
        actors, node = addresses.of(self._robot.name), portal().node
        portal().submit(self._sample, node.ref(actors.gate, Gate))
        portal().submit(self._describe, node.ref(actors.root, Root))

    def stop(self) -> None:
        self._ended = True
        self.wire.poll()

    def pid(self, role: str) -> int | None:
        """Return the pid of the process with a role, such as "wire". None if no such process is running."""
        processes = self.tree.processes if self.tree is not None else ()
        pid = next((process.pid for process in processes if process.role == role), None)
        return pid if pid is not None and state_of(pid) == "running" else None

    def left_over(self) -> list[int]:
        """Return the pids of all processes that were started for the robot and have not ended."""
        others = [pid for pids in self._pids.values() for pid in pids if pid != os.getpid()]
        return [pid for pid in others if state_of(pid) != "ended"]

    def restarts(self, role: str) -> int:
        """Return how often the process with a role, such as "wire", was replaced by a new process."""
        return max(0, len(self._pids.get(role, ())) - 1)

    # -- in the event loop of the robot's handle

    async def _sample(self, gate: Ref) -> None:
        while not self._ended:
            await trio.sleep(SAMPLE_S)
            try:
                answer = await gate.ask(GetStatus(), ASK_S)
            except (AskTimeout, Unreachable):
                answer = None
            self.wire.poll()
            self.status = answer if isinstance(answer, Status) else None
            if self.status is not None:
                self._keep(self.status)

    def _keep(self, status: Status) -> None:
        observation, setpoint = status.observation, self.wire.last("setpoint")
        if observation is not None and (not self.positions or observation.t_ns > self.positions[-1].t_ns):
            self.positions.append(Sample(observation.t_ns, observation.position))
        if setpoint is None or not self.moving or not status.target:
            return
        if not self.targets or setpoint.t_ns > self.targets[-1].t_ns:
            self.targets.append(Sample(setpoint.t_ns, status.target))

    @property
    def moving(self) -> bool:
        """True if the newest frame (protocol message) that acts on the robot is a setpoint. Otherwise it has
        stopped the robot ("safe") or energised it ("enable")."""
        last = self.wire.last("setpoint", "safe", "enable")
        return last is not None and last.kind == "setpoint"

    async def _describe(self, root: Ref) -> None:
        while not self._ended:
            try:
                answer = await root.ask(Describe(), ASK_S)
            except (AskTimeout, Unreachable):
                answer = None
            if isinstance(answer, TreeReport):
                self.tree = self._counted(answer)
            await trio.sleep(TREE_S)

    def _counted(self, report: TreeReport) -> TreeReport:
        """Return the root process's list of the robot's processes, with the number of restarts that this object
        has counted for each process. A new root process does not know about earlier restarts."""
        processes = []
        for process in report.processes:
            pids = self._pids.setdefault(process.role, [])
            if process.pid not in pids:
                pids.append(process.pid)
            processes.append(ProcessInfo(process.role, process.pid, self.restarts(process.role)))
        return msgspec.structs.replace(report, processes=tuple(processes))


def status_of(robot: RealRobot) -> dict[str, Any]:
    answer = robot.get_status()
    assert isinstance(answer, Answer)  # Without an event loop in this thread, the call returns the answer itself.
    json: dict[str, Any] = answer["content"][0]["json"]
    return json


def wait_for(condition: Callable[[], bool], at_most_s: float) -> bool:
    """Wait until the function ``condition`` returns True. Return False if it does not within ``at_most_s``
    seconds."""
    deadline = time.monotonic() + at_most_s
    while not condition():
        if time.monotonic() > deadline:
            return False
        time.sleep(0.005)
    return True
