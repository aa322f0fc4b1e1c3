"""Test exhausted resources: descriptors of root and caller, and memory after restarts of a policy.

Other tests: memory of a policy in ``test_failures.py``, the disk in
``test_a_full_disk_ends_the_recording_and_nothing_else``, the clock in ``test_clock_step.py``.
"""

from __future__ import annotations

import os
import resource
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from strands_actors.caller.handle.robot import RealRobot
from strands_actors.testing import Twin
from tests.answers import PATIENCE_S, pids, until

from .restarts import private_kb

RESTARTS = int(os.environ.get("STRANDS_ACTORS_RESTARTS", "5000"))
"""Restarts in virtual time. The figure in docs/safety-faults.md was measured with 100000."""
REAL_RESTARTS = int(os.environ.get("STRANDS_ACTORS_REAL_RESTARTS", "60"))
GROWTH = 1.05
WARM_UP = 100
"""Restarts until the allocator of a wire process has settled. It grows by 0.5 MB in the first hundred
policy sessions that it accepts, and by 0.15 MB in the next three hundred."""

Start = Callable[..., tuple[RealRobot, Twin]]


def use_up_descriptors(pid: int) -> tuple[int, int]:
    """Let a process open no more descriptors, and return its previous limits."""
    numbers = [int(name) for name in os.listdir(f"/proc/{pid}/fd")]
    free = next(number for number in range(len(numbers) + 1) if number not in numbers)
    assert free <= max(numbers) + 1
    _, hard = before = resource.prlimit(pid, resource.RLIMIT_NOFILE)
    resource.prlimit(pid, resource.RLIMIT_NOFILE, (free, hard))
    return before


def test_saf_003_a_root_without_free_descriptors_makes_safe_and_stays_so(strands_robot: Start) -> None:
    """The root's stop channel was open before. It has no descriptors to start another wire process."""
    arm, twin = strands_robot("so101")
    assert arm.send_action({"shoulder_pan": 10.0})["status"] == "success"
    root, wire = pids(arm)["root"], pids(arm)["wire"]
    before = use_up_descriptors(root)
    began_ns = time.monotonic_ns()
    os.kill(wire, signal.SIGKILL)
    safe = until(lambda: twin.log.first_safe(began_ns), "the root makes the robot safe")
    assert safe.safe_state == "limp"
    until(lambda: (arm.tree() or {}).get("state") == "failed", "the root gives up")
    assert arm.send_action({"shoulder_pan": 20.0})["status"] == "error"
    twin.log.no_setpoint_after_safe(began_ns)
    resource.prlimit(root, resource.RLIMIT_NOFILE, before)
    resumed = arm.resume()
    assert resumed["status"] == "success", resumed
    assert arm.send_action({"shoulder_pan": 20.0})["status"] == "success"


def test_saf_006_a_caller_without_free_descriptors_moves_and_stops(strands_robot: Start) -> None:
    arm, twin = strands_robot("so101")
    before = use_up_descriptors(os.getpid())
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


@pytest.mark.long
def test_restarts_of_a_policy_process_do_not_change_root_and_wire(strands_robot: Start) -> None:
    arm, _ = strands_robot("so101")
    roles = ("root", "wire")

    def run_policies(count: int) -> dict[str, int]:
        for _ in range(count):
            assert arm.start_task("fall", policy_provider="tests.kill.brief:Brief")["status"] == "success"
            until(lambda: not arm.get_task_status()["content"][0]["json"]["running"], "the policy ends")
            if arm.send_action({"shoulder_pan": 0.0})["status"] != "success":
                assert arm.resume()["status"] == "success"
        return {role: private_kb(pids(arm)[role]) for role in roles}

    processes = pids(arm)
    before = run_policies(WARM_UP)
    after = run_policies(REAL_RESTARTS)
    print({role: f"{before[role]} kB, after {REAL_RESTARTS} more {after[role]} kB" for role in roles})
    assert {role: pids(arm)[role] for role in roles} == {role: processes[role] for role in roles}
    for role in roles:
        assert after[role] <= before[role] * GROWTH, role


def test_restarts_of_a_policy_do_not_increase_the_memory_of_gate_and_tasks() -> None:
    """Run in a child process, because the test runner's own memory must not be counted."""
    done = subprocess.run(
        [sys.executable, "-m", "tests.kill.restarts", str(RESTARTS)],
        cwd=Path(__file__).parents[2],
        stdout=subprocess.PIPE,
        text=True,
        check=True,
    )
    before_kb, after_kb = map(int, done.stdout.split())
    print(f"{before_kb} kB, after {RESTARTS} more {after_kb} kB")
    assert after_kb <= before_kb * GROWTH
