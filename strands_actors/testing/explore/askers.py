"""Who asks: the script that has started the tree, operators on its mesh, and a policy of its own
process."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import trio

from strands_actors.contract.driver import Driver, Reason
from strands_actors.kernel.clock import VirtualClock
from strands_actors.kernel.messages import Message, Refused
from strands_actors.kernel.node import AskTimeout, Node, Ref, Unreachable
from strands_actors.supervisors import addresses
from strands_actors.supervisors import permissions as channels
from strands_actors.supervisors.gate.gate import Gate
from strands_actors.supervisors.gate.messages import (
    Acquire,
    Beat,
    GetStatus,
    Lease,
    Release,
    Resume,
    Resumed,
    Setpoint,
    Status,
    Stop,
)
from strands_actors.supervisors.root.guardian import Guardian
from strands_actors.supervisors.root.messages import Fence, Rollout, Shutdown, StartTask, StopTask
from strands_actors.supervisors.root.process import Root
from strands_actors.supervisors.root.tasks import Tasks

from .children import SimChild
from .links import SimLink, SimMesh
from .plan import CALLER, Event
from .robot_model import Actions
from .world import Process, World

ROBOT = "explored"
BEAT_S = 0.2
GOES_ON = ("too_fast", "superseded")
"""Refusals after which a stream goes on."""
ASK_S = 0.3
STOP_S = 0.25
FENCE_S = 3.0
START_S = 1.0
PERIOD_S = 1 / 30
ONESHOT_S = 0.25
"""Until a single command that is latched must have reached the wire."""
PROVIDER = "strands_actors.testing.explore.askers:Sweep"


class Sweep:
    """The policy of a rollout: a few actions at a time. ``actions``: of the present run."""

    actions: Actions

    def step(self, observation: Any) -> list[dict[str, float]]:
        return [self.actions.next(far=False) for _ in range(6)]


class Asker:
    """``events``: what it asks, and when since the world began."""

    def __init__(
        self, world: World, name: str, events: list[Event], style: str, actions: Actions, driver: Driver
    ) -> None:
        self.world = world
        self.name = name
        self.events = events
        self.style = style
        self.actions = actions
        self.driver = driver
        self._lease: Lease | None = None
        self._stopped = 0
        self._child: Any = None
        self.start_root: Callable[[str], SimChild] | None = None
        """Of the caller: starts the tree for the node at that address."""

    async def main(self, process: Process) -> None:
        self.process = process
        self.node = Node(f"{ROBOT}.{self.name.replace(' ', '.')}.{process.pid}", VirtualClock())
        at = addresses.of(ROBOT)
        sender = f"{self.node.address}/{ROBOT}"
        self.gate: Ref = self.node.ref(at.gate, Gate, sender)
        self.guardian: Ref = self.node.ref(at.guardian, Guardian)
        self.tasks: Ref = self.node.ref(at.tasks, Tasks)
        self.tree: Ref = self.node.ref(at.root, Root)
        async with trio.open_nursery() as nursery:
            self.nursery = nursery
            await nursery.start(self.node.run)
            mesh = await SimMesh.open()
            mesh.attach(self.node)
            await nursery.start(mesh.run)
            if self.name == CALLER:
                assert self.start_root is not None
                self._child = self.start_root(self.node.address)
                link: SimLink = self._child.link(self.node, channels.of_root(ROBOT))
                nursery.start_soon(link.run)
                nursery.start_soon(self._beat)
                nursery.start_soon(self._by_itself)
            for event in self.events:
                nursery.start_soon(self._do, event)
            await trio.sleep_forever()

    # -- what it does by itself

    async def _beat(self) -> None:
        while True:
            await trio.sleep(BEAT_S)
            if self._lease is not None:
                self.gate.tell(Beat(self._lease.id))

    async def _by_itself(self) -> None:
        """Connect, energise, move: once."""
        while True:
            status = await self._ask(self.gate, GetStatus(), ASK_S)
            if isinstance(status, Status) and status.mode == "disarmed":
                break
            await trio.sleep(0.01)
        if self.style == "rest" or self._stopped:
            return
        await self._resume(lift=False)
        match self.style:
            case "stream":
                await self._stream(10.0)
            case "oneshot":
                for _ in range(30):
                    await self._oneshot()
                    await trio.sleep(0.15)
            case "task":
                await self._start_task(10.0)

    # -- the verbs

    async def _do(self, event: Event) -> None:
        await trio.sleep_until(self.world.began_s + event.at_s)
        match event.kind:
            case "stop":
                await self._stop(Reason.STOP, False)
            case "estop":
                await self._stop(Reason.ESTOP, True)
            case "resume":
                await self._resume(lift=True)
            case "resume softly":
                await self._resume(lift=False)
            case "oneshot":
                await self._oneshot()
            case "stream":
                await self._stream(event.value)
            case "acquire":
                await self._acquire()
            case "release":
                await self._release()
            case "status":
                await self._ask(self.gate, GetStatus(), ASK_S)
            case "start task":
                await self._start_task(event.value)
            case "stop task":
                await self._ask(self.tasks, StopTask(), START_S)
            case "fence":
                await self._ask(self.guardian, Fence(Reason.STOP, self.name), FENCE_S)
            case "cleanup":
                await self._clean_up()

    async def _ask(self, ref: Ref, message: Message, within_s: float) -> Message | None:
        try:
            return await ref.ask(message, within_s)
        except (AskTimeout, Unreachable):
            return None

    async def _stop(self, reason: Reason, lock: bool) -> None:
        """As ``RobotTree.stop``: the gate; else the guardian; else the root is ended."""
        self._stopped += 1
        if await self._ask(self.gate, Stop(reason, self.name, lock), STOP_S) is not None or self.name != CALLER:
            return
        if await self._ask(self.guardian, Fence(reason, self.name, lock), FENCE_S) is None:
            self._child.kill()

    async def _clean_up(self) -> None:
        self._stopped += 1
        if await self._ask(self.tree, Shutdown(Reason.CLEANUP, self.name), FENCE_S) is None:
            self._child.kill()

    async def _resume(self, lift: bool) -> None:
        answer = await self._ask(self.gate, Resume(self.name, lift), 4.0)
        if isinstance(answer, Resumed):
            await self._acquire()

    async def _acquire(self) -> None:
        again = self._lease.id if self._lease else 0
        answer = await self._ask(self.gate, Acquire(self.name, pid=self.process.pid, again=again), ASK_S)
        if isinstance(answer, Lease):
            self._lease = answer

    async def _release(self) -> None:
        lease, self._lease = self._lease, None
        if lease is not None:
            await self._ask(self.gate, Release(lease.id), ASK_S)

    async def _oneshot(self) -> None:
        if self._lease is None:
            await self._acquire()
        if self._lease is not None:
            lives_s = self.driver.timing.oneshot_ttl_s
            deadline_ns = self.node.clock.now_ns() + round((lives_s or ONESHOT_S) * 1e9)
            action = self.actions.next(far=True)
            setpoint = Setpoint(self._lease.id, self._lease.epoch, deadline_ns, action, latched=lives_s is None)
            await self._ask(self.gate, setpoint, ASK_S)

    async def _stream(self, for_s: float) -> None:
        """Until something is refused."""
        if self._lease is None:
            await self._acquire()
        for at_s in _times(trio.current_time(), for_s):
            await trio.sleep_until(at_s)
            lease = self._lease
            if lease is None:
                return
            deadline_ns = self.node.clock.now_ns() + round(self.driver.timing.stream_ttl_s * 1e9)
            action = self.actions.next(far=False)
            answer = await self._ask(
                self.gate, Setpoint(lease.id, lease.epoch, deadline_ns, action, PERIOD_S), ASK_S
            )
            if answer is None or (isinstance(answer, Refused) and answer.code not in GOES_ON):
                return

    async def _start_task(self, for_s: float) -> None:
        if self._lease is None:
            await self._acquire()
        if self._lease is None:
            return
        rollout = Rollout(
            ROBOT, self.driver.axes, "sweep", PERIOD_S, self.driver.timing.stream_ttl_s, for_s, over=self._lease.id
        )
        deadline_ns = self.node.clock.now_ns() + round(START_S * 1e9)
        if await self._ask(self.tasks, StartTask(PROVIDER, {}, rollout, deadline_ns), START_S) is None:
            await self._never_started()

    async def _never_started(self) -> None:
        """As ``Rollouts``: the stop ends the lease that a policy would write under."""
        self.tasks.tell(StopTask())
        await self._ask(self.gate, Stop(Reason.POLICY, self.name), STOP_S)


def _times(begin_s: float, for_s: float) -> Iterator[float]:
    for step in range(int(for_s / PERIOD_S)):
        yield begin_s + step * PERIOD_S
