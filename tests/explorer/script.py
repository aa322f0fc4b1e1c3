"""The script that starts a simulated tree, with the product's code for callers.

It calls the verbs of ``RobotTree``, and their answers become the envelopes that a user reads. An
invariant compares each envelope that reports success with the robot.
"""

from __future__ import annotations

import os
from collections.abc import Awaitable, Callable
from typing import Any

import trio

from strands_actors.caller.handle import verbs
from strands_actors.caller.handle.envelopes import Answer, stop_result
from strands_actors.caller.handle.real_robot import RealRobot
from strands_actors.caller.processes.nodes import Entrance
from strands_actors.caller.processes.plan import Plan
from strands_actors.caller.processes.tree_processes import TreeProcesses
from strands_actors.caller.session.tree import RobotTree
from strands_actors.contract.driver import Driver, Reason
from strands_actors.kernel.messages import Message
from strands_actors.kernel.node import AskTimeout, Unreachable
from strands_actors.supervisors import addresses
from strands_actors.supervisors import permissions as channels
from strands_actors.supervisors.gate.messages import Lease
from strands_actors.supervisors.page import SafetyPage
from strands_actors.supervisors.root.process import Root

from .askers import PERIOD_S, ROBOT, Asker
from .children import SimChild
from .conversation import Told
from .plan import Event
from .robot_model import Actions, RobotModel
from .world import World

PROVIDER = "tests.explorer.askers:Sweep"
TASK_S = 10.0


class SimProcesses(TreeProcesses):
    """The caller's end of the processes. The root starts in the simulation; ``TreeProcesses`` makes all
    other decisions about it."""

    start_root: Callable[[str], tuple[SimChild, memoryview]]

    async def start(self, background: Callable[[], Awaitable[None]]) -> None:
        self.require_open()
        await trio.sleep(0.001)
        self.require_open()
        from strands_actors.supervisors.gate.gate import Gate
        from strands_actors.supervisors.root.guardian import Guardian
        from strands_actors.supervisors.root.tasks import Tasks

        process, page = type(self).start_root(self.node.address)
        self._safety_page = SafetyPage(page)
        at = addresses.of(self.robot)
        self.gate = self.node.ref(at.gate, Gate, sender=f"{self.node.address}/{self.robot}")
        self.guardian = self.node.ref(at.guardian, Guardian)
        self.root = self.node.ref(at.root, Root)
        self.tasks = self.node.ref(at.tasks, Tasks)
        self._scope = trio.CancelScope()
        link: Any = process.link(self.node, channels.of_root(self.robot))
        self._root_process = process
        self.nursery.start_soon(self._attend, process, link, self._scope, background)


class Script(Asker):
    """The simulated script. ``style`` selects its actions outside of the plan's events, as in ``Plan``."""

    def __init__(
        self,
        world: World,
        name: str,
        events: list[Event],
        actions: Actions,
        driver: Driver,
        style: str,
        model: RobotModel,
    ) -> None:
        super().__init__(world, name, events, actions, driver)
        self.style = style
        self._model = model
        self._stopped = False

    @property
    def lease(self) -> Lease | None:
        return self._tree._writer.lease

    async def _begin(self) -> None:
        model = self._model
        options = model.driver_class.resolve(model.robot, model.OPTIONS)
        plan = Plan(model.robot, ROBOT, model.driver_class, model.PORT, None, options)
        self._tree = RobotTree(self.node, self.nursery, Entrance("caller", ""), plan)
        self.nursery.start_soon(self._by_itself)

    async def _by_itself(self) -> None:
        """Connect, energise and move once."""
        rests = self.style == "rest"
        if await self._tree.connect(arm=not rests) is not None or rests or self._stopped:
            return
        for service, arguments in self._model.FIRST:
            await self._answered(service, verbs.service, service, dict(arguments))
        match self.style:
            case "stream":
                await self._stream(TASK_S)
            case "oneshot":
                for _ in range(30):
                    await self._oneshot()
                    await trio.sleep(0.15)
            case "task":
                await self._start_task(TASK_S)

    # -- the verbs

    async def do(self, event: Event) -> None:
        tree = self._tree
        match event.kind:
            case "stop":
                self._stopped = True
                await self._answered("stop", verbs.stop)
            case "estop":
                self._stopped = True
                await self._answered("estop", _estop)
            case "cleanup":
                self._stopped = True
                await self._answered("cleanup", _clean_up)
            case "start task":
                await self._start_task(event.value)
            case "stop task":
                await self._answered("stop_task", verbs.stop_task)
            case "fence":
                if tree._processes.started:
                    await super().do(event)
            case _:
                await super().do(event)

    async def _answered(self, name: str, verb: verbs.Verb, *args: Any) -> Answer:
        """Run a verb as ``Robot`` does, and record its envelope."""
        asked_s = self.world.now_s
        answer = await verbs.answered(name, verb, self._tree, *args)
        self.world.conversation.told.append(
            Told(asked_s, self.world.now_s, name, answer["status"] == "success", self.process.pid)
        )
        self.world.note(self.name, "is told", f"{name}: {answer}")
        return answer

    async def _ask(self, ref: Any, message: Message, within_s: float) -> Message | None:
        return await super()._ask(ref, message, within_s) if self._tree._processes.started else None

    async def _resume(self, lift: bool) -> None:
        await self._answered("resume", verbs.resume, lift)

    async def _acquire(self) -> None:
        if self._tree._processes.started:
            try:
                await self._tree._writer.acquire()
            except (AskTimeout, Unreachable):
                return

    async def _release(self) -> None:
        await self._answered("release", verbs.release)

    async def _oneshot(self) -> None:
        await self._answered("move", verbs.send_action, self.actions.next(far=True))

    async def _perform(self) -> None:
        if self.driver.SERVICES:
            service = self.world.rng("services").choice(sorted(self.driver.SERVICES))
            await self._answered(service, verbs.service, service, {})

    async def _start_task(self, for_s: float) -> None:
        async def start(tree: RobotTree) -> Answer:
            return verbs._begun(await tree.rollouts.start_task(PROVIDER, {}, "sweep", for_s, 1 / PERIOD_S))

        await self._answered("start_task", start)


async def _estop(tree: RobotTree) -> Answer:
    return stop_result("estop", await tree.stop(Reason.ESTOP, lock=True))


async def _clean_up(tree: RobotTree) -> Answer:
    """As ``RealRobot.cleanup``, which waits in a thread for the same coroutine."""
    result = await tree.cleanup()
    handle = object.__new__(RealRobot)
    handle.__dict__.update(_opened=tree, _pid=os.getpid(), _call=lambda verb: result)
    return handle.cleanup()
