"""Test the fence: the root kills a frozen wire process.

SAF-002: a frozen wire process writes nothing after it is thawed. SAF-003 and SAF-016: the root may
die, or get no answer from gate and policy, at the same moment.
"""

from __future__ import annotations

import contextlib
import os
import select
import signal
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from strands_actors import Robot
from strands_actors.caller.handle.robot import RealRobot
from strands_actors.testing import Twin, WireLog
from tests.answers import pids, resumed, until

Start = Callable[..., tuple[RealRobot, Twin]]


def test_saf_002_a_frozen_wire_is_fenced_before_the_root_writes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The target is latched and its caller is alive. Without the fence the wire process would resend the
    target.
    """
    log = WireLog(tmp_path / "wire.ndjson")
    monkeypatch.setenv("STRANDS_ACTORS_TWIN_LOG", str(log.path))
    with Robot("so101", mode="real", transport="twin") as arm:
        assert arm.send_action({"shoulder_pan": 10.0})["status"] == "success"
        wire = pids(arm)["wire"]
        frozen_ns = time.monotonic_ns()
        os.kill(wire, signal.SIGSTOP)
        deadline_s = time.monotonic() + 5.0
        while log.first_safe(frozen_ns) is None:
            assert time.monotonic() < deadline_s, "the wire was not made safe"
            time.sleep(0.01)
        with contextlib.suppress(ProcessLookupError):
            os.kill(wire, signal.SIGCONT)
        # The absence of a setpoint has no event to wait for.
        time.sleep(0.5)
        assert log.setpoints_after_safe(frozen_ns) == 0
        assert not Path(f"/proc/{wire}").exists()


def test_saf_016_a_root_that_dies_while_it_fences_a_frozen_wire_has_written(strands_robot: Start) -> None:
    """The root is killed at the moment when the fenced wire process ends. The safe frame that the root
    writes before the fence has been sent."""
    arm, twin = strands_robot("so101")
    assert arm.send_action({"shoulder_pan": 10.0})["status"] == "success"
    processes = pids(arm)
    wire = os.pidfd_open(processes["wire"])
    frozen_ns = time.monotonic_ns()
    os.kill(processes["wire"], signal.SIGSTOP)
    poll = select.poll()
    poll.register(wire, select.POLLIN)
    assert poll.poll(5000.0), "the wire was not fenced"
    os.kill(processes["root"], signal.SIGKILL)
    os.close(wire)
    time.sleep(0.5)  # No process is left that could write.
    safe = twin.log.first_safe(frozen_ns)
    assert safe is not None and safe.safe_state == "limp"
    twin.log.no_setpoint_after_safe(frozen_ns)


def test_saf_003_stopping_a_task_while_the_wire_is_dead_does_not_end_the_root(strands_robot: Start) -> None:
    """Neither the policy nor the gate answers the root. The root must not fail, because its
    stop channel is needed at that moment."""
    arm, twin = strands_robot("so101")
    started = arm.start_task("wave", policy_provider="tests.kill.sitting:Sitting")
    assert started["status"] == "success", started
    before = until(lambda: with_policy(arm), "the policy runs")
    os.kill(before["policy"], signal.SIGSTOP)
    killed_ns = time.monotonic_ns()
    os.kill(before["wire"], signal.SIGKILL)
    arm.stop_task()
    until(lambda: "policy" not in pids(arm), "the policy has ended")
    assert pids(arm)["root"] == before["root"]
    safe = twin.log.first_safe(killed_ns)
    assert safe is not None and safe.safe_state == "limp"
    twin.log.no_setpoint_after_safe(killed_ns)
    resumed(arm)


def with_policy(arm: RealRobot) -> dict[str, int] | None:
    processes = pids(arm)
    return processes if "policy" in processes and arm.get_task_status()["content"][0]["json"]["steps"] else None
