"""Test failures that other projects had and that no cell of the kill matrix would notice.

docs/safety-evidence.md names the others.
"""

from __future__ import annotations

import ast
import os
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

import strands_actors
from strands_actors.caller.handle.robot import RealRobot
from strands_actors.testing import Twin

PACKAGE = Path(strands_actors.__file__).parent
TREE = ("kernel", "contract", "supervisors", "drivers")
"""The parts that run in root and wire."""
WALL_CLOCK = {"time", "time_ns", "now", "utcnow", "today", "localtime", "gmtime"}

PATIENCE_S = 20.0

Start = Callable[..., tuple[RealRobot, Twin]]


def ended(arm: RealRobot) -> dict[str, Any]:
    deadline_s = time.monotonic() + PATIENCE_S
    while (task := task_of(arm))["running"]:
        assert time.monotonic() < deadline_s, task
        time.sleep(0.02)
    return task


def task_of(arm: RealRobot) -> dict[str, Any]:
    task: dict[str, Any] = arm.get_task_status()["content"][0]["json"]
    return task


def raises(observation: dict[str, float]) -> dict[str, float]:
    raise RuntimeError("a fault was asked for")


@pytest.mark.parametrize("how", ["its time is up", "the policy raises", "stop_task"])
def test_cleanup_after_any_end_of_a_rollout_leaves_no_torque(strands_robot: Start, how: str) -> None:
    """In another project the torque stayed on in six of six runs."""
    arm, twin = strands_robot("so101")
    policy = raises if how == "the policy raises" else lambda observation: dict(observation)
    assert arm.run_policy(policy, duration=0.3 if how == "its time is up" else 30.0)["status"] == "success"
    if how == "stop_task":
        arm.stop_task()
    ended(arm)
    began_ns = time.monotonic_ns()
    answer = arm.cleanup()
    assert answer["status"] == "success", answer
    safe = twin.log.first_safe(began_ns)
    assert safe is not None
    assert safe.safe_state == "limp"
    twin.log.no_setpoint_after_safe(began_ns)


def test_saf_003_a_policy_out_of_memory_ends_in_a_hold(strands_robot: Start) -> None:
    arm, twin = strands_robot("so101")
    began_ns = time.monotonic_ns()
    started = arm.start_task("eat", policy_provider="tests.kill.hungry:Hungry", steps=10)
    assert started["status"] == "success", started
    task = ended(arm)
    assert task["exit_reason"] == "policy", task
    assert task["steps"] >= 10
    first = twin.log.first_safe(began_ns)
    assert first is not None
    assert first.safe_state == "hold"
    twin.log.no_setpoint_after_safe(began_ns)
    assert arm.send_action({"shoulder_pan": 1.0})["status"] == "success"


READERS = {
    "supervisors/mesh/telemetry.py",
    "supervisors/mesh/answers.py",
    "supervisors/mesh/commands.py",
    "supervisors/mesh/readings.py",
    "kernel/channels/pubsub.py",
    "kernel/channels/ros2/graph.py",
    "drivers/common/rtps/sockets.py",
    "drivers/yahboom/twin/bridge.py",
    "drivers/rby1/twin/controller.py",
    "drivers/kinova/twin/topics.py",
    "drivers/spot/session.py",
    "supervisors/mesh/pictures.py",
    "supervisors/root/audit.py",
}
"""Files that may read the wall clock. They publish its time, or they check a wall-clock timestamp from
the operating system for plausibility.
"""


def test_no_part_of_the_tree_reads_the_wall_clock() -> None:
    """A step of the wall clock must not change a deadline."""
    assert list(wall_clock_calls("import time\ntime.monotonic_ns()\nclock.now_ns()")) == []
    assert list(wall_clock_calls("import time\ntime.time()")) == ["time.time"]
    assert list(wall_clock_calls("datetime.datetime.now()")) == ["datetime.datetime.now"]
    assert all((PACKAGE / part).is_dir() for part in TREE), "a part has moved"
    readers = {
        str(path.relative_to(PACKAGE)): calls
        for part in TREE
        for directory, _, files in os.walk(PACKAGE / part, followlinks=True)
        for path in (Path(directory) / file for file in files if file.endswith(".py"))
        if (calls := list(wall_clock_calls(path.read_text())))
    }
    assert readers.keys() <= READERS


def wall_clock_calls(source: str) -> Iterator[str]:
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute):
            called = ast.unparse(node.func)
            owner, _, name = called.rpartition(".")
            if name in WALL_CLOCK and owner.rpartition(".")[2] in ("time", "datetime", "date"):
                yield called
