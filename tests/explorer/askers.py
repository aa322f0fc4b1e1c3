"""Simulate operators on the mesh of a robot, and the policy of its rollouts.

The script that starts the tree is in ``script.py``.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import trio

from strands_actors.contract.driver import Driver, Reason
from strands_actors.kernel.clock import VirtualClock
from strands_actors.kernel.messages import Message, Refused
from strands_actors.kernel.node import AskTimeout, Node, Ref, Unreachable
from strands_actors.kernel.refusals import Code
from strands_actors.supervisors import addresses
from strands_actors.supervisors.gate.gate import Gate
from strands_actors.supervisors.gate.messages import (
    Acquire,
    GetStatus,
    Lease,
    Perform,
    Release,
    Resume,
    Resumed,
    Setpoint,
    Stop,
)
from strands_actors.supervisors.root.guardian import Guardian
from strands_actors.supervisors.root.messages import Fence, StopTask
from strands_actors.supervisors.root.tasks import Tasks

from .links import SimMesh
from .plan import Event
from .robot_model import Actions
from .world import Process, World

ROBOT = "explored"
GOES_ON = (Code.TOO_FAST, Code.SUPERSEDED)
"""Refusals after which a stream goes on."""
ASK_S = 0.3
STOP_S = 0.25
FENCE_S = 3.0
START_S = 1.0
PERIOD_S = 1 / 30
ONESHOT_S = 0.25
"""A latched single command must reach the wire within this time."""
HASTY_S = (0.001, 0.02)
"""Shortest and longest lifetime of the setpoints of a hasty stream."""


class Sweep:
    """The policy of a rollout, which returns six actions at a time.

    Attributes:
        actions: The actions of the present run.
    """

    actions: Actions

    def step(self, observation: Any) -> list[dict[str, float]]:
        return [self.actions.next(far=False) for _ in range(6)]


class Asker:
    """An operator.

    Attributes:
        events: Its requests, with their times since the beginning of the run.
    """

    def __init__(self, world: World, name: str, events: list[Event], actions: Actions, driver: Driver) -> None:
        self.world = world
        self.name = name
        self.events = events
        self.actions = actions
        self.driver = driver
        self._own: Lease | None = None

    async def main(self, process: Process) -> None:
        self.process = process
        self.node = Node(f"{ROBOT}.{self.name.replace(' ', '.')}.{process.pid}", VirtualClock())
        at = addresses.of(ROBOT)
        sender = f"{self.node.address}/{ROBOT}"
        self.gate: Ref = self.node.ref(at.gate, Gate, sender)
        self.guardian: Ref = self.node.ref(at.guardian, Guardian)
        self.tasks: Ref = self.node.ref(at.tasks, Tasks)
        async with trio.open_nursery() as nursery:
            self.nursery = nursery
            await nursery.start(self.node.run)
            mesh = await SimMesh.open()
            mesh.attach(self.node)
            await nursery.start(mesh.run)
            await self._begin()
            for event in self.events:
                nursery.start_soon(self._wait_and_do, event)
            await trio.sleep_forever()

    async def _begin(self) -> None:
        """Begin the activity between events. An operator has none."""

    async def _wait_and_do(self, event: Event) -> None:
        await trio.sleep_until(self.world.began_s + event.at_s)
        await self.do(event)

    async def do(self, event: Event) -> None:
        match event.kind:
            case "stop":
                await self._ask(self.gate, Stop(Reason.STOP, self.name), STOP_S)
            case "estop":
                await self._ask(self.gate, Stop(Reason.ESTOP, self.name, True), STOP_S)
            case "resume":
                await self._resume(lift=True)
            case "resume softly":
                await self._resume(lift=False)
            case "oneshot":
                await self._oneshot()
            case "stream":
                await self._stream(event.value)
            case "hasty stream":
                await self._stream(event.value, hasty=True)
            case "service":
                await self._perform()
            case "acquire":
                await self._acquire()
            case "release":
                await self._release()
            case "status":
                await self._ask(self.gate, GetStatus(), ASK_S)
            case "stop task":
                await self._ask(self.tasks, StopTask(), START_S)
            case "fence":
                await self._ask(self.guardian, Fence(Reason.STOP, self.name), FENCE_S)
            case _:
                raise ValueError(f"{self.name} cannot {event.kind}")

    async def _ask(self, ref: Ref, message: Message, within_s: float) -> Message | None:
        try:
            return await ref.ask(message, within_s)
        except (AskTimeout, Unreachable):
            return None

    # -- the verbs

    @property
    def lease(self) -> Lease | None:
        return self._own

    async def _resume(self, lift: bool) -> None:
        answer = await self._ask(self.gate, Resume(self.name, lift), 4.0)
        if isinstance(answer, Resumed):
            await self._acquire()

    async def _acquire(self) -> None:
        again = self._own.id if self._own else 0
        answer = await self._ask(self.gate, Acquire(self.name, pid=self.process.pid, again=again), ASK_S)
        if isinstance(answer, Lease):
            self._own = answer

    async def _release(self) -> None:
        lease, self._own = self._own, None
        if lease is not None:
            await self._ask(self.gate, Release(lease.id), ASK_S)

    async def _oneshot(self) -> None:
        if self.lease is None:
            await self._acquire()
        if self.lease is not None:
            lives_s = self.driver.timing.oneshot_ttl_s
            deadline_ns = self.node.clock.now_ns() + round((lives_s or ONESHOT_S) * 1e9)
            action = self.actions.next(far=True)
            setpoint = Setpoint(self.lease.id, self.lease.epoch, deadline_ns, action, latched=lives_s is None)
            await self._ask(self.gate, setpoint, ASK_S)

    async def _perform(self) -> None:
        """Request a drawn service of the driver."""
        if self.lease is None:
            await self._acquire()
        if self.lease is not None and self.driver.SERVICES:
            service = self.world.rng("services").choice(sorted(self.driver.SERVICES))
            within_s = self.driver.SERVICES[service].within_s + ASK_S
            await self._ask(self.gate, Perform(self.lease.id, self.lease.epoch, service, {}, None), within_s)

    async def _stream(self, for_s: float, hasty: bool = False) -> None:
        """Send setpoints until one is refused.

        The setpoints of a hasty stream live for a few milliseconds. Some are late, and a late one
        must not be written.
        """
        if self.lease is None:
            await self._acquire()
        rng = self.world.rng("hasty")
        for at_s in _times(trio.current_time(), for_s):
            await trio.sleep_until(at_s)
            lease = self.lease
            if lease is None:
                return
            lives_s = rng.uniform(*HASTY_S) if hasty else self.driver.timing.stream_ttl_s
            deadline_ns = self.node.clock.now_ns() + round(lives_s * 1e9)
            action = self.actions.next(far=False)
            setpoint = Setpoint(lease.id, lease.epoch, deadline_ns, action, PERIOD_S)
            answer = await self._ask(self.gate, setpoint, ASK_S)
            if hasty and isinstance(answer, Refused):
                await self._acquire()  # the robot holds since the last setpoint expired
            elif answer is None or (isinstance(answer, Refused) and answer.code not in GOES_ON):
                return


def _times(begin_s: float, for_s: float) -> Iterator[float]:
    for step in range(int(for_s / PERIOD_S)):
        yield begin_s + step * PERIOD_S
