"""LeRobot's own leaders, in a process of a teleoperation: what our followers do by them."""

from __future__ import annotations

import json
import os
import signal
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from strands_actors import Robot, Teleoperator
from strands_actors.testing import Twin
from tests.answers import json_of, pids, task, until

from .calibration import NAME, write

LONG_S = 240.0
"""For another process to import torch, on a busy machine."""
PRESS_S = 3.0
"""To align takes a third of it."""
BOUND_S = 0.05 + 0.5
"""Of a hold when the teleoperation's process ends, and room for a busy machine."""


@pytest.fixture(params=["so101", "koch"])
def pair(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[tuple[Twin, Twin]]:
    """A leader's twin, and its follower's."""
    for name in ("leader", "follower"):
        (tmp_path / name).mkdir()
    with (
        Twin(f"{request.param}_leader", tmp_path / "leader", by_hand=True) as leader,
        Twin(request.param, tmp_path / "follower") as follower,
    ):
        yield leader, follower


def test_saf_003_lerobots_own_leader_leads_and_its_process_is_killed(
    pair: tuple[Twin, Twin], tmp_path: Path
) -> None:
    leader, follower = pair
    write(tmp_path)
    theirs = Teleoperator(f"lerobot:{leader.robot}", port=leader.port, id=NAME, calibration_dir=str(tmp_path))
    arm = Robot(follower.robot, mode="real", port=follower.port)
    try:
        assert arm.connect_eagerly() is None
        json_of(arm.attach_teleop(theirs))
        until(lambda: _teleop(arm).get("values"), "it is read", LONG_S)
        leader.move_by_hand(shoulder_pan=0.15)  # 8.6 degrees
        until(lambda: abs(_teleop(arm)["values"]["shoulder_pan"] - 8.6) < 1.0, "its angles are degrees")
        _engage(arm)
        until(lambda: _held(arm) and abs(arm.get_observation()["shoulder_pan"] - 8.6) < 2.0, "it follows")
        policy = pids(arm)["policy"]
        killed_ns = time.monotonic_ns()
        os.kill(policy, signal.SIGKILL)
        until(lambda: not task(arm)["running"], "it has ended")
        until(lambda: follower.log.first_safe(killed_ns), "it holds")
        follower.log.safe_within(killed_ns, BOUND_S)
        follower.log.no_setpoint_after_safe(killed_ns)
    finally:
        arm.cleanup()


def test_one_that_is_not_calibrated_is_refused_and_asks_nobody(tmp_path: Path) -> None:
    with Twin("so101_leader", tmp_path) as leader, Robot("so101", mode="real", transport="twin") as arm:
        theirs = Teleoperator("lerobot:so101_leader", port=leader.port, id="grey", calibration_dir=str(tmp_path))
        json_of(arm.attach_teleop(theirs))
        until(lambda: "Run lerobot-calibrate" in json.dumps(task(arm)), "it says why", LONG_S)
        arm.stop_task()


def _teleop(arm: Any) -> dict[str, Any]:
    told: dict[str, Any] = task(arm).get("teleop", {})
    return told


def _held(arm: Any) -> bool:
    """The dead-man is held."""
    return arm.operate(held=True)["status"] == "success"


def _engage(arm: Any) -> None:
    """Press until it is; a press during which a busy machine kept the leader silent counts as let
    go, and takes a new one."""

    def engaged() -> bool:
        arm.operate(held=False)
        time.sleep(0.1)
        until_s = time.monotonic() + PRESS_S
        while time.monotonic() < until_s:
            if _held(arm) and _teleop(arm)["state"] == "engaged":
                return True
            time.sleep(0.02)
        return False

    until(engaged, "it is engaged", LONG_S)
