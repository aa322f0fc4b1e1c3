"""Measure the start and the restart of actors: ``python -m benchmarks.sides.life SIDE [short]``.

SIDE is the name of the program that is measured. With ``short`` the run is short.

Our side starts and replaces processes as a robot does with policies: under a supervisor, by a spawner. A spawner
is a process that was forked early, when the parent had one thread and no open files, and that forks all others.

``spawn``    from the order to start a process until its actor's first message has reached the parent's actor
``recover``  from SIGKILL until the actor of the replacing process, which the supervisor starts, has answered
``restart``  from the request at which an actor of this process raises until the restarted actor has answered
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import statistics
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from multiprocessing.connection import Connection
from typing import Any

import trio

from benchmarks.house import Figures
from strands_actors.kernel.actor import Actor
from strands_actors.kernel.clock import MonotonicClock
from strands_actors.kernel.messages import Message
from strands_actors.kernel.node import Node, Ref
from strands_actors.kernel.processes.process import ChildProcess
from strands_actors.kernel.processes.spawner import Spawner
from strands_actors.kernel.supervisor import Budget, ChildSpec, Supervisor

from .common import Count, GetCount, answer, percentiles
from .life_child import CHILD, DEADLINE_S, ENTRY, Child, Up

PATIENT = Budget(restarts=1_000_000, within_s=0.02)


class Boom(Message, frozen=True):
    pass


def processes(short: bool) -> int:
    return 3 if short else 20


def milliseconds(name: str, spans_s: list[float]) -> Figures:
    return {f"{name}_p50_ms": statistics.median(spans_s) * 1e3, f"{name}_worst_ms": max(spans_s) * 1e3}


# -- ours


class Parent(Actor):
    """Receives the first message of each child process."""

    def __init__(self) -> None:
        self.child_ready = trio.Event()

    def receive(self, message: Up) -> None:
        self.child_ready.set()


def ours(short: bool) -> Figures:
    # The spawner forks here, while this process has one thread and no open files.
    spawner = Spawner()
    return trio.run(_ours, spawner, short)


async def _ours(spawner: Spawner, short: bool) -> Figures:
    spawned_s, recovered_s = [], []
    async with trio.open_nursery() as nursery:
        node = Node("parent", MonotonicClock())
        await nursery.start(node.run)
        await nursery.start(spawner.run)
        parent = Parent()
        await nursery.start(node.cell("bench/actor/parent", lambda: parent).run)
        children: list[ChildProcess] = []

        async def keep(task_status: trio.TaskStatus[None] = trio.TASK_STATUS_IGNORED) -> None:
            child = await spawner.start(ENTRY, {})
            children.append(child)
            async with trio.open_nursery() as inner:
                await inner.start(child.link(node).run)
                task_status.started()
                await child.wait()
                inner.cancel_scope.cancel()
                raise ChildProcessError("the child ended")

        supervisor = Supervisor([ChildSpec("child", keep)], budget=PATIENT)
        nursery.start_soon(supervisor.run)
        await parent.child_ready.wait()
        ref = node.ref(CHILD, Child)
        for _ in range(processes(short)):
            pid = await ref.ask(GetCount(), DEADLINE_S)
            parent.child_ready = trio.Event()
            began_s = time.perf_counter()
            children[-1].kill(signal.SIGKILL)
            await parent.child_ready.wait()
            assert await ref.ask(GetCount(), DEADLINE_S) != pid
            recovered_s.append(time.perf_counter() - began_s)
        for _ in range(processes(short)):
            parent.child_ready = trio.Event()
            began_s = time.perf_counter()
            child = await spawner.start(ENTRY, {})
            link = child.link(node)
            nursery.start_soon(link.run)
            await parent.child_ready.wait()
            spawned_s.append(time.perf_counter() - began_s)
            await child.fence()
        children[-1].kill()
        nursery.cancel_scope.cancel()
    return milliseconds("spawn", spawned_s) | milliseconds("recover", recovered_s) | await restarts(short)


class Fragile(Actor):
    def receive(self, message: Boom | GetCount) -> Count:
        if type(message) is Boom:
            raise RuntimeError("boom")
        return Count(0)


async def restarts(short: bool) -> Figures:
    spans_ns = []
    async with trio.open_nursery() as nursery:
        node = Node("restarts", MonotonicClock())
        await nursery.start(node.run)
        cell = node.cell("bench/actor/fragile", Fragile)
        await nursery.start(Supervisor([ChildSpec("fragile", cell.run)], budget=PATIENT).run)
        ref: Ref = node.ref(cell.address, Fragile)
        for _ in range(200 if short else 2_000):
            began_ns = time.perf_counter_ns()
            ref.tell(Boom())
            await ref.ask(GetCount(), DEADLINE_S)
            spans_ns.append(time.perf_counter_ns() - began_ns)
        nursery.cancel_scope.cancel()
    return percentiles("restart", spans_ns)


# -- trio alone


async def trio_restarts(short: bool) -> Figures:
    """Measure the least work in trio alone: a task receives from a channel and raises, a loop starts it again, and
    the answer has a deadline. Restarts are not limited, delayed or reported.
    """
    spans_ns = []
    sender, receiver = trio.open_memory_channel[trio.Event | None](1)

    async def serve(task_status: trio.TaskStatus[None] = trio.TASK_STATUS_IGNORED) -> None:
        task_status.started()
        async for each in receiver:
            if each is None:
                raise RuntimeError("boom")
            each.set()

    async def keep() -> None:
        while True:
            with suppress(ExceptionGroup):
                async with trio.open_nursery() as inner:
                    await inner.start(serve)

    async with trio.open_nursery() as nursery:
        nursery.start_soon(keep)
        for _ in range(200 if short else 2_000):
            began_ns = time.perf_counter_ns()
            await sender.send(None)
            answered = trio.Event()
            with trio.fail_after(DEADLINE_S):
                await sender.send(answered)
                await answered.wait()
            spans_ns.append(time.perf_counter_ns() - began_ns)
        nursery.cancel_scope.cancel()
    return percentiles("restart", spans_ns)


# -- multiprocessing


def _child(connection: Connection) -> None:
    connection.send(os.getpid())
    while connection.recv() is not None:
        connection.send(os.getpid())


def spawn(short: bool) -> Figures:
    context = multiprocessing.get_context("spawn")

    def born() -> tuple[Any, Connection]:
        ours, theirs = context.Pipe()
        process = context.Process(target=_child, args=(theirs,), daemon=True)
        process.start()
        theirs.close()
        ours.recv()
        return process, ours

    spawned_s, recovered_s = [], []
    for _ in range(processes(short)):
        began_s = time.perf_counter()
        process, connection = born()
        spawned_s.append(time.perf_counter() - began_s)
        began_s = time.perf_counter()
        process.kill()
        process.join()
        process, connection = born()
        connection.send(0)
        connection.recv()
        recovered_s.append(time.perf_counter() - began_s)
        process.kill()
        process.join()
    return milliseconds("spawn", spawned_s) | milliseconds("recover", recovered_s)


# -- Ray


def ray(short: bool) -> Figures:
    os.environ["RAY_USAGE_STATS_ENABLED"] = "0"
    import ray

    ray.init(num_cpus=2, include_dashboard=False, log_to_driver=False, configure_logging=False)
    try:

        @ray.remote(max_restarts=-1, max_task_retries=-1, num_cpus=0)
        class Child:
            def pid(self) -> int:
                return os.getpid()

        def until(answered: Callable[[], int]) -> int:
            while True:
                with suppress(ray.exceptions.RayActorError):
                    return answered()

        spawned_s, recovered_s = [], []
        for _ in range(3 if short else 6):
            began_s = time.perf_counter()
            actor = Child.remote()  # type: ignore[attr-defined]
            pid = ray.get(actor.pid.remote(), timeout=60)
            spawned_s.append(time.perf_counter() - began_s)
            began_s = time.perf_counter()
            os.kill(pid, signal.SIGKILL)
            while until(lambda actor=actor: ray.get(actor.pid.remote(), timeout=60)) == pid:  # type: ignore[misc]
                pass
            recovered_s.append(time.perf_counter() - began_s)
            ray.kill(actor)
        return milliseconds("spawn", spawned_s) | milliseconds("recover", recovered_s)
    finally:
        ray.shutdown()


if __name__ == "__main__":
    answer(
        {"ours": ours, "trio": lambda short: trio.run(trio_restarts, short), "multiprocessing": spawn, "ray": ray}
    )
    sys.exit(0)
