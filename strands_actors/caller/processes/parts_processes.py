"""Start and end the processes of a robot that is made of parts: those of each part, and those that command them."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from dataclasses import replace
from typing import Any, TypeVar

import msgspec
import trio

from strands_actors.contract.driver import Driver, Reason
from strands_actors.kernel.messages import Refused
from strands_actors.kernel.node import Node
from strands_actors.parts.tables import CAMERA_JOINED_BY
from strands_actors.supervisors.gate.messages import Lease
from strands_actors.supervisors.loading import build_driver
from strands_actors.supervisors.root.messages import TreeReport
from strands_actors.supervisors.stop_result import Confirmed, StopResult
from strands_actors.surfaces.cameras.config import SCENE

from .nodes import Entrance
from .plan import Plan
from .robot_processes import NotConnected
from .run_directory import run_dir
from .tree_processes import TreeProcesses

T = TypeVar("T")

RETRY_S = 3.0
"""Longest pause of a part's wire process between two attempts to open the wire, and the time of one attempt."""
CALLER = "caller"
"""The role of this program. It is the caller of the whole robot and of each part, and is shown once."""


class PartsProcesses(TreeProcesses):
    """The processes of a robot of parts. Arguments and methods are those of ``TreeProcesses``.

    Each part has the processes of any robot, which end with this program. The processes of the whole robot command
    the parts, and have no hardware.
    """

    def __init__(self, node: Node, nursery: trio.Nursery, entrance: Entrance, plan: Plan, driver: Driver) -> None:
        super().__init__(node, nursery, entrance, plan, driver)
        self._entrance_of_parts = entrance
        self._parts: dict[str, TreeProcesses] = {}

    async def _start_hardware(self) -> str:
        """Start the processes of the parts that do not run, and wait until each is connected to its hardware.

        Return the place of their sockets, which is the port of the whole robot: the run directory, and the robot's
        name.
        """
        for name, plan in self.plan.parts.items():
            if name not in self._parts:
                own = replace(plan, tool_name=f"{self.robot}_{name}", is_part=True)
                driver = build_driver(own.driver_class, own.robot, own.port, own.options)
                self._parts[name] = TreeProcesses(self.node, self.nursery, self._entrance_of_parts, own, driver)

        async def start(part: TreeProcesses) -> str:
            try:
                if not part.started:
                    await part.start(trio.sleep_forever)
                    await part.wait_linked()
            except (NotConnected, OSError) as failure:
                return f"{part.robot}: {failure}"
            return ""

        problems = [problem for problem in await self._each(start) if problem]
        if problems:
            raise NotConnected(". ".join(problems))
        return str(run_dir() / self.robot)

    def _begin_cameras(self, port: str) -> list[dict[str, Any]]:
        """Return the cameras of all parts. A camera that draws the scene of a part connects to that simulation."""
        begun = super()._begin_cameras(port)
        for camera in begun:
            part = camera["name"].partition(CAMERA_JOINED_BY)[0]
            plan, settings = self.plan.parts[part], camera["args"]["settings"]
            twin = plan.twin_process
            control = twin.control if twin is not None and settings["type"] == SCENE else ""
            settings |= {"robot": plan.robot, "port": control or plan.port, "options": plan.options}
        return begun

    async def _each(self, run: Callable[[TreeProcesses], Awaitable[T]]) -> list[T]:
        """Run a function for all parts at the same time, and return the results in their order."""
        results: dict[str, T] = {}

        async def keep(name: str, part: TreeProcesses) -> None:
            results[name] = await run(part)

        async with trio.open_nursery() as nursery:
            for name, part in self._parts.items():
                nursery.start_soon(keep, name, part)
        return [results[name] for name in self._parts]

    def close(self) -> None:
        super().close()
        for part in self._parts.values():
            part.close()

    async def end(self, lease: Lease | None) -> StopResult:
        """Stop the parts together, end the processes that command them, then those of each part."""
        result = await super().end(lease)

        async def end(part: TreeProcesses) -> StopResult:
            return await part.end(None)

        ended = await self._each(end)
        self._parts.clear()
        return next((each for each in ended if not isinstance(each, Confirmed)), result)

    async def make_safe(self, reason: Reason, by: str, lock: bool) -> StopResult:
        result = await super().make_safe(reason, by, lock)
        if isinstance(result, Confirmed) and self.alive:
            return result

        # The processes that command the parts may all have ended. The parts then only hold.
        async def make_safe(part: TreeProcesses) -> StopResult:
            return await part.make_safe(reason, by, lock)

        stopped = await self._each(make_safe)
        return next((each for each in stopped if not isinstance(each, Confirmed)), result)

    async def describe(self) -> TreeReport | None:
        """Return the processes and actors of the whole robot, and those of each part with roles such as
        ``left/wire``."""
        report = await super().describe()
        if report is None:
            return None

        async def describe(part: TreeProcesses) -> TreeReport | None:
            return await part.describe()

        processes, actors = list(report.processes), list(report.actors)
        for name, own in zip(self._parts, await self._each(describe), strict=True):
            if own is not None:
                processes += [
                    msgspec.structs.replace(process, role=f"{name}/{process.role}")
                    for process in own.processes
                    if process.role != CALLER
                ]
                actors += own.actors
        return msgspec.structs.replace(report, processes=tuple(processes), actors=tuple(actors))

    async def revive(self, lift: bool, background: Callable[[], Awaitable[None]]) -> Refused | None:
        async def revive(part: TreeProcesses) -> Refused | str | None:
            try:
                refusal = await part.revive(lift, trio.sleep_forever)
                if refusal is None:
                    # The wire process of a part that has suffered may still be starting again.
                    await part.wait_linked(RETRY_S)
            except (NotConnected, OSError) as failure:
                return f"{part.robot}: {failure}"
            return refusal

        answers = await self._each(revive)
        if problems := [answer for answer in answers if isinstance(answer, str)]:
            raise NotConnected(". ".join(problems))
        refused = next((answer for answer in answers if isinstance(answer, Refused)), None)
        return refused or await super().revive(lift, background)
