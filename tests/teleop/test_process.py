"""A teleoperation as real processes on twins, judged by the frames on both wires. If the leader or its process
is dead, frozen or unplugged, the arm holds."""

from __future__ import annotations

import itertools
import os
import signal
import time

import pytest

from strands_actors import Robot, Teleoperator
from strands_actors.testing import Twin
from tests.answers import json_of, status, task, task_ended, until, why
from tests.robot.helpers import goals

from .conftest import NEUTRAL, Pair

pytestmark = pytest.mark.real_time

ROOM_S = 1.0
"""Timeout for a busy machine. The benchmarks measure the real times."""
RADIAN = 0.017453


def settled(pair: Pair, since_ns: int) -> int:
    """Return the time of the first safe frame. No setpoint may follow it."""
    safe = until(lambda: pair.follower.log.first_safe(since_ns), "a safe frame")
    pair.follower.log.safe_within(since_ns, ROOM_S)
    assert safe.safe_state == "hold"
    return safe.t_ns


def test_the_arm_follows_and_the_leader_is_never_energised(pair: Pair) -> None:
    pair.begin()
    assert pair.follower.log.host("setpoint") == [], "the arm is not engaged"
    pair.engage()
    pair.leader.move_by_hand(shoulder_pan=10 * RADIAN)
    until(
        lambda: pair.arm.operate(True) and abs(pair.arm.get_observation()["shoulder_pan"] - 10) < 1.5, "it follows"
    )
    counts = [goals(entry)[1] for entry in pair.follower.log.host("setpoint")]
    assert max(abs(after - before) for before, after in itertools.pairwise(counts)) < 60, "no jump"
    assert task(pair.arm)["steps"] > 0
    ended = json_of(pair.arm.stop_task())
    assert ended["exit_reason"] == "stopped" and status(pair.arm)["state"] == "holding"
    kinds = {entry.kind for entry in pair.leader.log.entries() if entry.sender == "host"}
    assert kinds <= {"read", "config", "safe"}, "neither torque nor a goal reaches a leader"


def test_an_idle_teleoperation_that_was_stopped_makes_room_for_another(pair: Pair) -> None:
    """The robot is resumed at once, so the teleoperation does not see the stop in the robot's state."""
    pair.begin()
    pid = pair.pid
    json_of(pair.arm.stop())
    assert pair.arm.resume()["status"] == "success"
    assert not task(pair.arm)["running"]
    until(lambda: pair.arm.attach_teleop(pair.teleoperator, deadman="key")["status"] == "success", "another begins")
    assert task(pair.arm)["running"] and pair.pid != pid


def test_saf_003_a_killed_teleoperation_leads_to_a_hold_without_later_setpoints(pair: Pair) -> None:
    pair.begin()
    pid = pair.pid
    pair.engage()
    killed_ns = time.monotonic_ns()
    os.kill(pid, signal.SIGKILL)
    settled(pair, killed_ns)
    ended = task_ended(pair.arm)
    assert ended["exit_reason"] == "policy" and "signal 9" in ended["exit_detail"]
    time.sleep(0.3)
    pair.follower.log.no_setpoint_after_safe(killed_ns)
    assert status(pair.arm)["state"] == "holding"


def test_saf_003_a_frozen_teleoperation_leads_to_a_hold_that_stays_when_it_continues(pair: Pair) -> None:
    pair.begin()
    pid = pair.pid
    pair.engage()
    frozen_ns = time.monotonic_ns()
    os.kill(pid, signal.SIGSTOP)
    try:
        until(lambda: pair.arm.operate(True) and pair.follower.log.first_safe(frozen_ns), "a safe frame")
        settled(pair, frozen_ns)
    finally:
        os.kill(pid, signal.SIGCONT)
    pair.hold_on(0.5)  # still held, which is not a new press
    pair.follower.log.no_setpoint_after_safe(frozen_ns)
    pair.engage()
    assert pair.follower.log.setpoints_after_safe(frozen_ns) > 0


@pytest.mark.parametrize("how", ["unplugged", "frozen", "without power"])
def test_saf_001_a_lost_leader_leads_to_a_hold_until_a_new_press(pair: Pair, how: str) -> None:
    pair.begin()
    pair.engage()
    gone_ns = time.monotonic_ns()
    match how:
        case "unplugged":
            pair.leader.unplug()
        case "frozen":
            pair.leader.pause()
        case _:
            pair.leader.fault("off")
    idle = pair.wait(lambda now: now["state"] == "idle", held=True)
    # The leader's last frame may have expired on the way to the gate.
    assert "leader" in idle["why"] or "past its deadline" in idle["why"]
    settled(pair, gone_ns)
    match how:
        case "unplugged":
            pair.leader.plug()
        case "frozen":
            pair.leader.go_on()
        case _:
            pair.leader.fault("ok")
    pair.wait(lambda now: now["leader"] == "connected" and now["leader_age_ms"] < 100, held=True)
    pair.hold_on(0.3)
    pair.follower.log.no_setpoint_after_safe(gone_ns)
    pair.engage()


def test_saf_001_a_released_dead_man_or_a_lost_operator_leads_to_a_hold(pair: Pair) -> None:
    pair.begin()
    pair.engage()
    since_ns = time.monotonic_ns()
    pair.wait(lambda now: now["state"] == "idle", held=False)
    settled(pair, since_ns)
    pair.follower.log.no_setpoint_after_safe(since_ns)
    pair.engage()
    since_ns = time.monotonic_ns()  # from now on no operator sends frames
    until(lambda: pair.now["state"] == "idle", "it is let go of")
    settled(pair, since_ns)
    pair.follower.log.no_setpoint_after_safe(since_ns)


def test_saf_011_a_leader_that_is_elsewhere_is_not_engaged(pair: Pair) -> None:
    pair.leader.move_by_hand(**{**NEUTRAL, "shoulder_pan": 40 * RADIAN})
    pair.begin()
    pair.wait(lambda now: now["values"]["shoulder_pan"] > 35, held=False)
    shown = pair.wait(lambda now: now["differs"], held=True)
    assert set(shown["differs"]) == {"shoulder_pan"} and "Move it to within 15 degrees" in shown["why"]
    pair.hold_on(0.3)
    assert pair.follower.log.host("setpoint") == []


def test_a_stop_ends_an_idle_teleoperation(pair: Pair) -> None:
    pair.begin()
    pair.engage()
    since_ns = time.monotonic_ns()
    json_of(pair.arm.stop())
    assert task_ended(pair.arm)["exit_reason"] == "stop"
    json_of(pair.arm.resume())
    pair.follower.log.no_setpoint_after_safe(since_ns)
    pair.begin()
    json_of(pair.arm.stop())
    until(lambda: not pair.pid, "its process has ended")
    json_of(pair.arm.resume())


def test_an_invalid_leader_is_refused_before_anything_starts(pair: Pair) -> None:
    arm, leader = pair.arm, pair.teleoperator
    assert "give so101_leader one of port=" in why(arm.attach_teleop("so101_leader"))
    assert "hz is 0" in why(arm.attach_teleop(leader, hz=0))
    assert "deadman is 'foot'" in why(arm.attach_teleop(leader, deadman="foot"))
    assert "another process cannot import" in why(arm.attach_teleop(leader, map_fn=lambda action: action))
    assert "no teleoperation runs" in why(arm.operate(True))
    assert pair.pid == 0


def test_a_keyboard_jogs_and_a_map_changes_the_actions_of_an_arm(pair: Pair) -> None:
    json_of(pair.arm.attach_teleop(Teleoperator("keyboard")))
    pair.wait(lambda now: now["leader"] == "connected", held=False)
    before = pair.arm.get_observation()["wrist_roll"]

    def jogged() -> bool:
        """Return True if one press jogs the axis. On a busy machine a press may be missed."""
        pair.wait(lambda now: not now["held"], held=False)
        until_s = time.monotonic() + 3.0
        while time.monotonic() < until_s:
            pair.arm.operate(True, wrist_roll=1.0)
            if pair.arm.get_observation()["wrist_roll"] > before + 3:
                return True
            time.sleep(0.02)
        return False

    until(jogged, "it is jogged", 60.0)
    json_of(pair.arm.stop_task())
    pair.begin(map_fn=only_the_wrist)
    assert set(pair.now["values"]) == {"wrist_roll"}
    json_of(pair.arm.stop_task())


def only_the_wrist(action: dict[str, float]) -> dict[str, float]:
    """A map function that other processes can import."""
    return {"wrist_roll": -action["wrist_roll"]}


def test_an_object_that_raises_ends_the_teleoperation_with_its_message(pair: Pair) -> None:
    json_of(pair.arm.attach_teleop(Teleoperator(f"{__name__}:Broken")))
    ended = task_ended(pair.arm)
    assert ended["exit_reason"] == "policy" and "no batteries" in ended["exit_detail"]
    assert pair.follower.log.host("setpoint") == []


class Broken:
    def get_action(self) -> dict[str, float]:
        raise RuntimeError("no batteries")


class Steady:
    """A third-party teleoperator with the methods of LeRobot's."""

    def __init__(self, pan: float) -> None:
        self._pan = pan

    def connect(self) -> None:
        self._connected = True

    def get_action(self) -> dict[str, float]:
        assert self._connected
        return {"shoulder_pan.pos": self._pan}


def test_any_object_with_get_action_leads(pair: Pair) -> None:
    json_of(pair.arm.attach_teleop(Teleoperator(f"{__name__}:Steady", pan=8.0)))
    pair.engage()
    until(
        lambda: pair.arm.operate(True) and abs(pair.arm.get_observation()["shoulder_pan"] - 8) < 1.5, "it follows"
    )


def test_a_follower_with_arm_false_is_not_energised_before_a_resume(follower_process: Twin) -> None:
    os.truncate(follower_process.log.path, 0)
    arm = Robot("so101", mode="real", port=follower_process.port, arm=False)
    try:
        assert until(lambda: arm.connect_eagerly() is None, "it connects")
        assert len(arm.get_observation()) == 6
        assert "resume()" in why(arm.send_action({"shoulder_pan": 1.0}))
        assert follower_process.log.host("setpoint") == follower_process.log.host("enable") == []
        json_of(arm.resume())
        assert follower_process.log.host("enable")
    finally:
        arm.cleanup()
