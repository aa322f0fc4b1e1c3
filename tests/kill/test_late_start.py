"""SAF-010: a ``start_task`` that was not answered in time starts nothing later.

Processes are real, and the wire log shows the result.
"""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable
from typing import Any

import pytest

from strands_actors.caller.handle.robot import RealRobot
from strands_actors.caller.session import rollouts
from strands_actors.supervisors.root.messages import StartTask
from strands_actors.testing import Twin
from tests.answers import json_of, pids

Start = Callable[..., tuple[RealRobot, Twin]]

LATE_S = 2.5
"""A policy that was started late would have moved the robot within this time."""


def start(arm: RealRobot) -> dict[str, Any]:
    answer: dict[str, Any] = dict(arm.start_task("wave", policy_provider="tests.kill.sitting:Sitting"))
    return answer


def task(arm: RealRobot) -> dict[str, Any]:
    progress: dict[str, Any] = arm.get_task_status()["content"][0]["json"]
    return progress


def spawner_of(arm: RealRobot) -> int:
    """Return the pid of the process that starts others."""
    return pids(arm)["spawner"]


@pytest.mark.long
def test_saf_010_a_task_is_not_started_by_a_spawner_that_was_frozen(strands_robot: Start) -> None:
    arm, twin = strands_robot("so101")
    spawner, began_ns = spawner_of(arm), time.monotonic_ns()
    os.kill(spawner, signal.SIGSTOP)
    refused = start(arm)
    assert refused["status"] == "error" and "starts others did not answer" in str(refused), refused
    with pytest.raises(ProcessLookupError):
        for _ in range(200):  # The process has ended, so it cannot continue.
            os.kill(spawner, signal.SIGCONT)
            time.sleep(0.01)
    time.sleep(LATE_S)
    assert twin.log.host("setpoint", began_ns) == []
    assert not task(arm)["running"]
    started = start(arm)  # by the next spawner
    assert started["status"] == "success", started
    arm.stop_task()
    assert not task(arm)["running"]


def test_saf_010_a_task_whose_caller_has_timed_out_moves_nothing(
    strands_robot: Start, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The root answers too late. The policy that it has started by then is ended and gets no lease.

    The request has no deadline here, so that the root does start the policy.
    """
    arm, twin = strands_robot("so101")
    began_ns = time.monotonic_ns()
    monkeypatch.setattr(rollouts, "START_S", 0.0)
    monkeypatch.setattr(rollouts, "StartTask", lambda *message: StartTask(*message[:3]))
    refused = start(arm)
    assert refused["status"] == "error" and "nothing of it will begin" in str(refused), refused
    time.sleep(LATE_S)
    assert twin.log.host("setpoint", began_ns) == []
    assert not task(arm)["running"]
    monkeypatch.undo()
    json_of(arm.send_action({"shoulder_pan": 5.0}))
