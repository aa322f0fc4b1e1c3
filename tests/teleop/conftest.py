"""A leader and its follower, each a twin on a real pty with its own log. The arm is always cleaned up after a
test."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from strands_actors import Robot, Teleoperator
from strands_actors.caller.handle.robot import RealRobot
from strands_actors.testing import Twin
from tests.answers import json_of, pids, state, task, until

OPERATE_S = 0.03
PRESS_S, PRESSES = 4.0, 5
NEUTRAL = {"shoulder_pan": 0.0, "shoulder_lift": 0.0, "elbow_flex": 0.0, "wrist_flex": 0.0, "wrist_roll": 0.0}


class Pair:
    """A leader that follows the test, and the arm that it leads."""

    def __init__(self, leader: Twin, follower: Twin, arm: RealRobot) -> None:
        self.leader, self.follower, self.arm = leader, follower, arm
        self.teleoperator = Teleoperator("so101_leader", port=leader.port)

    def begin(self, **keywords: Any) -> None:
        begun = json_of(self.arm.attach_teleop(self.teleoperator, deadman="key", **keywords))
        assert "so101_leader is not calibrated" in begun["caveats"][0], "the leader is not known to be a twin"
        self.wait(lambda now: now["leader"] == "connected" and now["leader_age_ms"] is not None, held=False)

    def engage(self) -> None:
        """Release the dead-man, then hold it until the arm is engaged. Try again if a frame of the leader was late
        on a busy machine, because continuing needs a new press."""
        end_s = time.monotonic() + PRESSES * PRESS_S
        while True:
            self.wait(lambda now: not now["held"] and now["leader_age_ms"] is not None, held=False)
            over_s = time.monotonic() + PRESS_S
            status = self.wait(lambda now: now["state"] == "engaged" or time.monotonic() > over_s, held=True)  # noqa: B023
            if status["state"] == "engaged":
                return
            assert time.monotonic() < end_s, f"it is not engaged: {task(self.arm)}"

    def wait(self, condition: Any, held: bool, within_s: float = 20.0) -> dict[str, Any]:
        """Operate until the condition is true, and return the status."""
        deadline_s = time.monotonic() + within_s
        while True:
            if self.pid:
                self.arm.operate(held)
            now = self.now
            if now and condition(now):
                return now
            assert time.monotonic() < deadline_s, f"not within {within_s:g} s: {task(self.arm)}"
            time.sleep(OPERATE_S)

    def hold_on(self, seconds: float) -> None:
        """Hold the dead-man for this time."""
        end_s = time.monotonic() + seconds
        while time.monotonic() < end_s:
            self.arm.operate(True)
            time.sleep(OPERATE_S)

    @property
    def now(self) -> dict[str, Any]:
        status: dict[str, Any] = task(self.arm).get("teleop", {})
        return status

    @property
    def pid(self) -> int:
        """Return the pid of the teleoperation's process, or 0 if no process runs."""
        return pids(self.arm).get("policy", 0)


@pytest.fixture(scope="session")
def leader_process(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Twin]:
    with Twin("so101_leader", tmp_path_factory.mktemp("leader"), by_hand=True) as twin:
        twin.move_by_hand(**NEUTRAL, gripper=0.8)
        yield twin


@pytest.fixture(scope="session")
def follower_process(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Twin]:
    with Twin("so101", tmp_path_factory.mktemp("follower")) as twin:  # starts first, as a robot does
        yield twin


@pytest.fixture
def pair(leader_process: Twin, follower_process: Twin, run_dir: Path) -> Iterator[Pair]:
    leader_process.move_by_hand(**NEUTRAL, gripper=0.8)
    arm = Robot("so101", mode="real", port=follower_process.port)
    try:
        problem = None
        for _ in range(3):
            if (problem := arm.connect_eagerly()) is None:
                break
        assert problem is None, problem
        json_of(arm.send_action(NEUTRAL))
        until(lambda: all(abs(value) < 4 for key, value in arm.get_observation().items() if key in NEUTRAL), "rest")
        json_of(arm.release())  # no setpoint is sent until the leader is engaged
        until(lambda: state(arm) == "holding", "it holds")
        for twin in (leader_process, follower_process):
            os.truncate(twin.log.path, 0)
        yield Pair(leader_process, follower_process, arm)
    finally:
        arm.cleanup()
        for twin in (leader_process, follower_process):
            twin.go_on()
            twin.fault("ok")
            twin.plug()
