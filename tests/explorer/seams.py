"""The table of names in the product's modules that the explorer replaces by simulated ones.

The processes run the product's ``_main``. If a name no longer exists, the explorer fails at once, and
the error names it.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable, Iterator
from types import SimpleNamespace
from typing import Any

import trio

from strands_actors.caller.processes import robot_processes as processes
from strands_actors.caller.processes import tree_processes
from strands_actors.caller.session import rollouts, tree, writer
from strands_actors.kernel.clock import VirtualClock
from strands_actors.kernel.health import busy
from strands_actors.supervisors import introspection, policy
from strands_actors.supervisors.root import guardian, lock_keeper, process, standby_keeper, tasks
from strands_actors.supervisors.standby import process as standby
from strands_actors.supervisors.wire import group

from .askers import START_S
from .children import SimOs, SimPeer, SimStatFile, Starter, life_of, suspected, until_ended
from .exhaustion import enter, seams_of
from .links import Net, SimLink, SimMesh
from .locks import SimLocks
from .robot_model import RobotModel, Seam
from .script import SimProcesses
from .world import World


class NoMesh:
    """Replaces the robot's service on the mesh of other hosts: topics, commands in JSON, the gateway."""

    problem = ""

    def __init__(self, *_: Any) -> None:
        self.settled = trio.Event()

    def tell_state(self, state: Any) -> None:
        """No-op: the topic has no subscriber."""

    async def run(self, *_: Any) -> None:
        self.settled.set()
        await trio.sleep_forever()


class Told:
    """Replaces the root's report of unconfirmed motors."""

    def __init__(self, world: World) -> None:
        self._world = world

    def tell(self, report: Any) -> None:
        self._world.note("root", "reports", f"{report.safe_state} unconfirmed {report.unconfirmed}")


def nothing(*_: Any) -> None:
    """Replace a function that sets process names, locks or priorities of the real system."""


def _threads(world: World) -> Callable[..., Any]:
    """Replace ``trio.to_thread.run_sync``. A thread takes up to 4 ms, in one of 20 cases up to 1.5 s."""
    rng = world.rng("threads")

    async def run_sync(
        do: Callable[..., Any], *args: Any, abandon_on_cancel: bool = False, limiter: object = None
    ) -> Any:
        world.current.resources.start_thread()
        took_s = 0.004 * rng.random() if rng.random() < 0.95 else 1.5 * rng.random()
        with trio.CancelScope(shield=not abandon_on_cancel):
            await trio.sleep(took_s)
        return do(*args)

    return run_sync


@contextlib.contextmanager
def seams(world: World, net: Net, starter: Starter, model: RobotModel) -> Iterator[None]:
    """Replace the names for one run."""
    system = SimOs(world)

    def words_of(page: int) -> memoryview:
        return world.pages[os.fstat(page).st_ino]

    def write(path: object, report: Any) -> None:
        world.note("standby", "reports", f"confirmed {report.confirmed} attempts {report.attempts}: {report.cause}")

    def report_failure(what: str, error: BaseException) -> None:
        world.note(world.current.role, "reports", f"{what} failed: {error!r}")

    def find(pid: int) -> Any:
        found = world.by_pid(pid)
        assert found is not None
        return found

    SimMesh.net = net
    world.enter = enter
    table: tuple[Seam, ...] = (
        (trio.to_thread, "run_sync", _threads(world)),
        (group, "os", system),
        (group, "run_first", nothing),
        (group, "MonotonicClock", VirtualClock),
        (group, "Link", SimLink),
        (group, "ZenohMesh", SimMesh),
        (group, "start", starter.execute),
        (group, "words_of", words_of),
        (group, "take_name", nothing),
        (group, "lower_oom_score", nothing),
        (group, "suspected", lambda pid: suspected(world, pid)),
        (group, "StatFile", lambda pid: SimStatFile(world, pid)),
        (group, "report_failure", report_failure),
        (process, "os", system),
        (process, "run_first", nothing),
        (process, "MonotonicClock", VirtualClock),
        (process, "Link", SimLink),
        (process, "ZenohMesh", SimMesh),
        (process, "MeshService", NoMesh),
        (process, "Locks", SimLocks),
        (process, "Unconfirmed", lambda _: Told(world)),
        (process, "words_of", words_of),
        (process, "wait_for_end_of", lambda pid: until_ended(find(pid))),
        (process, "report_failure", report_failure),
        (busy, "_assumed", busy.IDLE),
        (guardian, "life_of", lambda pid: life_of(world, pid)),
        (lock_keeper, "run_like_others", lambda: None),
        (standby_keeper, "os", system),
        (standby_keeper, "suspected", lambda pid: suspected(world, pid)),
        (standby_keeper, "report_failure", report_failure),
        (standby, "os", system),
        (standby, "run_first", nothing),
        (standby, "MonotonicClock", VirtualClock),
        (standby, "Link", SimLink),
        (standby, "words_of", words_of),
        (standby, "suspected", lambda pid: suspected(world, pid)),
        (standby, "report_failure", report_failure),
        (standby, "take_name", nothing),
        (standby, "lower_oom_score", nothing),
        (standby, "Peer", lambda pid, pidfd=None: SimPeer(world, pid, pidfd)),
        # No lock is needed, since a script is not started again before the last standby has ended.
        (standby, "_take_lock", nothing),
        (standby, "write", write),
        (tasks, "os", system),
        (tasks, "MonotonicClock", VirtualClock),
        (tasks, "Link", SimLink),
        (tasks, "ZenohMesh", SimMesh),
        (policy, "os", system),
        (introspection, "os", system),
        (tree, "processes_of", SimProcesses),
        (tree_processes, "wait_for_end_of", lambda pid: until_ended(find(pid))),
        (processes, "os", system),
        (rollouts, "START_S", START_S),
        (writer, "os", system),
        (policy, "gc_freeze", SimpleNamespace(frozen_objects=contextlib.nullcontext)),
        *seams_of(world),
        *model.seams(),
    )
    before = [(owner, name, getattr(owner, name)) for owner, name, _ in table]
    try:
        for owner, name, replacement in table:
            setattr(owner, name, replacement)
        with busy.assumed(busy.IDLE):
            yield
    finally:
        for owner, name, original in before:
            setattr(owner, name, original)
