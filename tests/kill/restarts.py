"""Measure the memory that restarts of a policy take: ``python -m tests.kill.restarts N``.

The actors of root and wire run in one process, in virtual time. A policy starts and ends N / 10
times, and then N times. After each of the two series the program prints the private memory of the
process (kB).
"""

from __future__ import annotations

import os
import signal
import sys
from pathlib import Path
from typing import Any

import trio
import trio.lowlevel

from strands_actors.kernel.channels.permissions import Channel
from strands_actors.kernel.node import Node
from strands_actors.kernel.processes.process import ChildProcess
from strands_actors.supervisors import addresses
from strands_actors.supervisors.root.messages import GetTask, Rollout, StartTask, TaskStatus
from strands_actors.supervisors.root.tasks import Tasks
from strands_actors.testing import open_inline_tree, run_virtual


def private_kb(pid: int) -> int:
    """Return the private memory of a process (kB). Shared memory is not counted as its growth."""
    lines = Path(f"/proc/{pid}/smaps_rollup").read_text().splitlines()
    return sum(int(line.split()[1]) for line in lines if line.startswith("Private_"))


class Ended(ChildProcess):
    """A policy process that ends immediately after its start."""

    def __init__(self, number: int) -> None:
        self.pid = number

    @property
    def alive(self) -> bool:
        return False

    def kill(self, sig: int = signal.SIGKILL) -> None:
        pass

    async def wait(self) -> int:
        return -signal.SIGKILL

    def link(self, node: Node, channel: Channel | None = None) -> Any:
        return Silent()


class Silent:
    async def run(self) -> None:
        await trio.sleep_forever()


async def restart(count: int) -> None:
    async with open_inline_tree() as tree, trio.open_nursery() as nursery:
        robot = tree.gate.address.split("/")[1]
        starts = 0

        async def start(entry: str, args: dict[str, Any]) -> ChildProcess:
            nonlocal starts
            starts += 1
            return Ended(starts)

        cell = tree.node.cell(addresses.of(robot).path("tasks"), lambda: Tasks(robot, start, ""))
        await nursery.start(cell.run)
        tasks = tree.node.ref(addresses.of(robot).tasks, Tasks)
        rollout = Rollout(robot, tree.driver.axes, "", 0.02, 0.1, 1.0)
        for more in (count // 10, count):
            for _ in range(more):
                assert isinstance(await tasks.ask(StartTask("no:where", {}, rollout), 1.0), TaskStatus)
                while (await tasks.ask(GetTask(), 1.0)).running:
                    await trio.lowlevel.checkpoint()
            print(private_kb(os.getpid()), flush=True)
        assert starts == count + count // 10
        nursery.cancel_scope.cancel()


if __name__ == "__main__":
    times = int(sys.argv[1])
    run_virtual(lambda: restart(times))
