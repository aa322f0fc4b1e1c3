"""``run_policy(..., wait=True)``, and how the exception of a policy is reported: in the log, in the
status and to a waiting caller.
"""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Mapping
from typing import Any

import pytest

from strands_actors.caller.handle.robot import RealRobot
from strands_actors.testing import Twin
from tests.answers import json_of, task, task_ended, until, why

from .helpers import limps


def still(seen: Mapping[str, float]) -> dict[str, float]:
    return {"shoulder_pan": seen["shoulder_pan"]}


def broken(seen: Mapping[str, float]) -> dict[str, float]:
    return {"shoulder_pan": seen["shoulder_pann"]}


def test_a_waiting_caller_gets_the_final_status(arm: RealRobot) -> None:
    ended = json_of(arm.run_policy(still, n_steps=5, wait=True))
    assert (ended["running"], ended["exit_reason"], ended["steps"]) == (False, "n_steps", 5)


def test_a_waiting_caller_gets_the_exception_of_the_policy(
    arm: RealRobot, caplog: pytest.LogCaptureFixture
) -> None:
    with caplog.at_level(logging.ERROR), pytest.raises(KeyError, match="shoulder_pann"):
        arm.run_policy(broken, wait=True)
    assert task(arm)["exit_detail"].startswith("KeyError: 'shoulder_pann' (test_waiting.py:")
    assert task(arm)["exit_detail"].endswith(" in broken)")
    assert "so101: its policy failed" in caplog.text and 'seen["shoulder_pann"]' in caplog.text


def test_without_wait_the_status_names_the_line_of_the_exception(arm: RealRobot) -> None:
    json_of(arm.run_policy(broken))
    assert " in broken)" in task_ended(arm)["exit_detail"]


def test_a_refused_rollout_is_an_error_for_a_waiting_caller(arm: RealRobot) -> None:
    refused = arm.run_policy(lambda seen: {"shoulder_pan": 105.0}, wait=True)
    assert "run_policy: gate: " in why(refused)
    assert refused["content"][1]["json"]["refusal"] == "too_fast"


def test_saf_006_a_stop_ends_the_wait(arm: RealRobot, twin: Twin) -> None:
    answers: list[Any] = []
    waiting = threading.Thread(target=lambda: answers.append(arm.run_policy(still, duration=60.0, wait=True)))
    waiting.start()
    until(lambda: task(arm)["steps"] > 3, "the policy runs")
    stopped_ns = time.monotonic_ns()
    json_of(arm.stop())
    waiting.join(10.0)
    assert "run_policy: stop" in why(answers[0])
    assert limps(twin.log, stopped_ns)
