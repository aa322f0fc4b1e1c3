"""SAF-023 on a real tree: a motion that ends without a confirmation is not a success, for each verb. The
tests read the twin's wire log.
"""

from __future__ import annotations

import contextlib
import os
import signal
import time

import pytest

from strands_actors.caller.handle.robot import RealRobot
from strands_actors.testing import Twin
from tests.answers import json_of, pids, until, why

from .conftest import NewArm
from .helpers import far, limps

FAULTS = {"dead": signal.SIGKILL, "frozen": signal.SIGSTOP}


def moving(arm: RealRobot) -> int:
    """Return the root of an arm that holds a latched target."""
    json_of(arm.send_action({"shoulder_pan": far(arm)}))
    return pids(arm)["root"]


@pytest.mark.parametrize("how", FAULTS)
def test_saf_023_a_cleanup_without_confirmation_names_every_motor(how: str, arm: RealRobot, twin: Twin) -> None:
    root = moving(arm)
    twin.unplug()
    os.kill(root, FAULTS[how])
    answer = arm.cleanup()
    assert answer["status"] == "error"
    assert all(axis in why(answer) for axis in arm.driver.axes)
    report = answer["content"][1]["json"]
    assert report["stopped"] is False and report["unconfirmed"] == list(arm.driver.axes)


@pytest.mark.parametrize("how", FAULTS)
def test_saf_023_a_cleanup_without_a_root_is_confirmed_by_the_wires_report(
    how: str, arm: RealRobot, twin: Twin
) -> None:
    root, before_ns = moving(arm), time.monotonic_ns()
    os.kill(root, FAULTS[how])
    assert json_of(arm.cleanup())["stopped"] is True
    assert limps(twin.log, before_ns), "limp is on the wire"


def test_saf_023_a_cleanup_without_root_and_wire_is_confirmed_by_the_standby(arm: RealRobot, twin: Twin) -> None:
    root, wire, before_ns = moving(arm), pids(arm)["wire"], time.monotonic_ns()
    for pid in (root, wire):
        os.kill(pid, signal.SIGKILL)
    assert json_of(arm.cleanup())["stopped"] is True
    assert limps(twin.log, before_ns), "limp is on the wire"


@pytest.mark.parametrize("verb", ["release", "stop_task", "stop"])
def test_saf_023_with_the_cable_out_no_verb_that_ends_motion_is_a_success(
    verb: str, arm: RealRobot, twin: Twin
) -> None:
    moving(arm)
    twin.unplug()
    until(lambda: json_of(arm.get_status())["state"] == "lost", "the link is lost")
    answer = getattr(arm, verb)()
    assert answer["status"] == "error"
    assert all(axis in why(answer) for axis in arm.driver.axes)
    assert set(answer["content"][1]["json"]["unconfirmed"]) == set(arm.driver.axes)


@pytest.mark.parametrize("verb", ["release", "stop_task"])
def test_saf_023_with_a_frozen_wire_no_verb_that_ends_motion_is_a_success_without_a_report(
    verb: str, arm: RealRobot, twin: Twin
) -> None:
    moving(arm)
    members = pids(arm)
    twin.unplug()
    for role in ("root", "wire"):
        os.kill(members[role], signal.SIGSTOP)
    answer = getattr(arm, verb)()
    assert answer["status"] == "error"
    assert all(axis in why(answer) for axis in arm.driver.axes)
    tree = arm.tree()
    assert tree is not None and tree["state"] == "unreachable"
    for role in ("root", "wire"):  # the caller ended the root after it got no answer
        with contextlib.suppress(ProcessLookupError):
            os.kill(members[role], signal.SIGKILL)


def test_saf_023_stop_task_after_the_end_of_a_task_reports_the_motors(arm: RealRobot, twin: Twin) -> None:
    json_of(arm.run_policy(lambda seen: [{"shoulder_pan": seen["shoulder_pan"]}], n_steps=3))
    until(lambda: not json_of(arm.get_task_status())["running"], "the task has ended")
    held = json_of(arm.stop_task())
    assert held["stopped"] is True and set(held["motors"]) == set(arm.driver.axes)
    assert json_of(arm.release())["released"] is True


def test_saf_023_a_robot_that_never_ran_is_cleaned_up(new_arm: NewArm) -> None:
    assert json_of(new_arm(port="/dev/null").cleanup())["reason"] == "nothing was running"
