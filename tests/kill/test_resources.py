"""What runs out: descriptors, in the root and in the caller; memory, by restarts of a policy. (Memory of a policy:
``test_failures.py``; the disk: ``test_a_full_disk_ends_the_recording_and_nothing_else``; the clock: nobody asks it,
``test_no_part_of_the_tree_reads_the_wall_clock``.)
"""

from __future__ import annotations

import os
import resource
import signal
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import trio
import trio.lowlevel

from strands_actors.robot import RealRobot
from strands_actors.runtime.node import Node
from strands_actors.runtime.process import ChildProcess
from strands_actors.supervisors import addresses
from strands_actors.supervisors.messages import GetTask, Rollout, StartTask, TaskStatus
from strands_actors.supervisors.tasks import Tasks
from strands_actors.testing import Twin, open_inline_tree, run_virtual

PATIENCE_S = 20.0
RESTARTS = int(os.environ.get("STRANDS_ACTORS_RESTARTS", "5000"))
"""In virtual time; the figure that docs/safety.md gives is of 100000."""
REAL_RESTARTS = int(os.environ.get("STRANDS_ACTORS_REAL_RESTARTS", "60"))
GROWTH = 1.05

Start = Callable[..., tuple[RealRobot, Twin]]


def until(condition: Callable[[], Any], what: str) -> Any:
    deadline_s = time.monotonic() + PATIENCE_S
    while not (seen := condition()):
        assert time.monotonic() < deadline_s, what
        time.sleep(0.005)
    return seen


def pids(arm: RealRobot) -> dict[str, int]:
    return {process["role"]: process["pid"] for process in (arm.tree() or {}).get("processes", ())}


def private_kb(pid: int) -> int:
    """What the process has for itself; what it shares with others is no growth of its own."""
    lines = Path(f"/proc/{pid}/smaps_rollup").read_text().splitlines()
    return sum(int(line.split()[1]) for line in lines if line.startswith("Private_"))


def only_those_it_has(pid: int) -> tuple[int, int]:
    """Let a process open no more descriptors; its limits before."""
    numbers = [int(name) for name in os.listdir(f"/proc/{pid}/fd")]
    free = next(number for number in range(len(numbers) + 1) if number not in numbers)
    assert free <= max(numbers) + 1
    _, hard = before = resource.prlimit(pid, resource.RLIMIT_NOFILE)
    resource.prlimit(pid, resource.RLIMIT_NOFILE, (free, hard))
    return before


def test_saf_003_a_root_without_free_descriptors_makes_safe_and_stays_so(strands_robot: Start) -> None:
    """Its own path was ready before; for another wire process it has no descriptors."""
    arm, twin = strands_robot("so101")
    assert arm.send_action({"shoulder_pan": 10.0})["status"] == "success"
    root, wire = pids(arm)["root"], pids(arm)["wire"]
    before = only_those_it_has(root)
    began_ns = time.monotonic_ns()
    os.kill(wire, signal.SIGKILL)
    safe = until(lambda: twin.log.first_safe(began_ns), "nobody made it safe")
    assert safe.rung == "limp"
    until(lambda: (arm.tree() or {}).get("state") == "failed", "it was not given up")
    assert arm.send_action({"shoulder_pan": 20.0})["status"] == "error"
    twin.log.no_setpoint_after_safe(began_ns)
    resource.prlimit(root, resource.RLIMIT_NOFILE, before)
    resumed = arm.resume()
    assert resumed["status"] == "success", resumed
    assert arm.send_action({"shoulder_pan": 20.0})["status"] == "success"


def test_saf_006_a_caller_without_free_descriptors_moves_and_stops(strands_robot: Start) -> None:
    arm, twin = strands_robot("so101")
    before = only_those_it_has(os.getpid())
    try:
        moved = arm.send_action({"shoulder_pan": 10.0})
        began_ns = time.monotonic_ns()
        stopped = arm.stop()
    finally:
        resource.prlimit(os.getpid(), resource.RLIMIT_NOFILE, before)
    assert moved["status"] == "success", moved
    assert stopped["status"] == "success", stopped
    twin.log.safe_within(began_ns, PATIENCE_S)
    twin.log.no_setpoint_after_safe(began_ns)


def test_restarts_of_a_policy_process_leave_root_and_wire_as_they_were(strands_robot: Start) -> None:
    arm, _ = strands_robot("so101")
    roles = ("root", "wire")

    def run_policies(count: int) -> dict[str, int]:
        for _ in range(count):
            assert arm.start_task("fall", policy_provider="tests.kill.brief:Brief")["status"] == "success"
            until(lambda: not arm.get_task_status()["content"][0]["json"]["running"], "it goes on")
            until(lambda: "policy" not in pids(arm), "its process goes on")
            if arm.send_action({"shoulder_pan": 0.0})["status"] != "success":
                assert arm.resume()["status"] == "success"
        return {role: private_kb(pids(arm)[role]) for role in roles}

    processes = pids(arm)
    before = run_policies(REAL_RESTARTS // 3)
    after = run_policies(REAL_RESTARTS)
    print({role: f"{before[role]} kB, after {REAL_RESTARTS} more {after[role]} kB" for role in roles})
    assert {role: pids(arm)[role] for role in roles} == {role: processes[role] for role in roles}
    for role in roles:
        assert after[role] <= before[role] * GROWTH, role


class Ended(ChildProcess):
    """A policy process that has ended as soon as it was started."""

    def __init__(self, number: int) -> None:
        self.pid = number

    @property
    def alive(self) -> bool:
        return False

    def kill(self, sig: int = signal.SIGKILL) -> None:
        pass

    async def wait(self) -> int:
        return -signal.SIGKILL

    def link(self, node: Node) -> Any:
        return Silent()


class Silent:
    async def run(self) -> None:
        await trio.sleep_forever()


def test_restarts_of_a_policy_leave_the_memory_of_gate_and_tasks_as_it_was() -> None:
    """The actors of root and wire in one process, in virtual time: each policy's end is told to the gate."""
    before_kb = 0

    async def restart_many() -> None:
        nonlocal before_kb
        async with open_inline_tree() as tree, trio.open_nursery() as nursery:
            robot = tree.gate.address.split("/")[1]
            at, starts = addresses.of(robot), 0

            async def start(entry: str, args: dict[str, Any]) -> ChildProcess:
                nonlocal starts
                starts += 1
                return Ended(starts)

            cell = tree.node.cell(at.path("tasks"), lambda: Tasks(robot, list, start))
            await nursery.start(cell.run)
            tasks = tree.node.ref(at.tasks, Tasks)
            rollout = Rollout(robot, tree.driver.axes, "", 0.02, 0.1, 1.0)
            for number in range(RESTARTS + RESTARTS // 10):
                if number == RESTARTS // 10:
                    before_kb = private_kb(os.getpid())
                assert isinstance(await tasks.ask(StartTask("no:where", {}, rollout), 1.0), TaskStatus)
                while (await tasks.ask(GetTask(), 1.0)).running:
                    await trio.lowlevel.checkpoint()
            assert starts == RESTARTS + RESTARTS // 10
            nursery.cancel_scope.cancel()

    run_virtual(restart_many)
    after_kb = private_kb(os.getpid())
    print(f"{before_kb} kB, after {RESTARTS} more {after_kb} kB")
    assert after_kb <= before_kb * GROWTH
