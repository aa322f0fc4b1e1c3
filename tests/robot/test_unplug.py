"""The cable is pulled and plugged in again, or the robot is not connected yet (SAF-012, SAF-011)."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from strands_actors.caller.handle.robot import RealRobot
from strands_actors.drivers.feetech import protocol as p
from strands_actors.testing import Twin
from tests.answers import json_of, state, status, task_ended, until, why

from .conftest import NewArm
from .helpers import IDS, armed_at, goals, limps, register_now, torque_now

TWO_PERIODS_S = 0.5
"""Two periods of the wire are 0.07 s. The rest is for a busy machine."""


class Mover:
    """Command the arm at 50 Hz from another thread, and ignore its answers."""

    def __init__(self, arm: RealRobot) -> None:
        self._arm = arm
        self._end = threading.Event()
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def _run(self) -> None:
        began_s = time.monotonic()
        while not self._end.wait(0.02):
            self._arm.send_action({"shoulder_pan": 15.0 * math.sin(3.0 * (time.monotonic() - began_s))})

    def stop(self) -> None:
        self._end.set()
        self._thread.join()


@pytest.fixture
def mover(arm: RealRobot, twin: Twin) -> Iterator[Mover]:
    moving = Mover(arm)
    until(lambda: len(twin.log.host("setpoint")) > 10, "the arm moves")
    yield moving
    moving.stop()


def test_a_cable_that_is_pulled_during_motion_and_plugged_in_again(
    arm: RealRobot, twin: Twin, mover: Mover
) -> None:
    twin.unplug()
    pulled_s = time.monotonic()
    until(lambda: not status(arm)["connected"], "the loss is reported")
    assert time.monotonic() - pulled_s < TWO_PERIODS_S
    reported = status(arm)
    assert "the port is gone" in reported["connect_error"] or "cannot open" in reported["connect_error"]
    assert reported["state"] == "lost"
    assert not arm.is_connected
    assert "move: not connected" in why(arm.send_action({"shoulder_pan": 0.0}))
    assert why(arm.resume()).startswith("resume: ")
    unreached = arm.stop()
    assert all(f"{name} (id {servo})" in why(unreached) for name, servo in IDS.items())
    until(lambda: arm.get_observation() == {}, "readings from before the loss are not returned any more")  # SAF-012

    plugged_ns = time.monotonic_ns()
    twin.plug()
    until(lambda: status(arm)["connected"], "the arm is connected again")
    until(lambda: state(arm) == "disarmed", "the arm is safe")
    first = next(entry for entry in twin.log.entries(plugged_ns) if entry.kind in ("safe", "setpoint", "enable"))
    assert limps(twin.log, plugged_ns)[0] == first
    assert register_now(twin.log, p.TORQUE_ENABLE, first.t_ns) == dict.fromkeys(IDS.values(), 0)

    time.sleep(0.3)  # the mover still sends commands
    assert "resume() first" in why(arm.send_action({"shoulder_pan": 0.0}))
    assert not twin.log.host("setpoint", plugged_ns)
    mover.stop()

    resumed_ns = time.monotonic_ns()
    json_of(arm.resume())
    held = armed_at(twin.log, resumed_ns)
    assert held.keys() == set(IDS.values())
    assert not twin.log.host("setpoint", resumed_ns)
    assert arm.send_action({"gripper": 50.0})["status"] == "success"
    first_setpoint = until(lambda: twin.log.host("setpoint", resumed_ns), "a setpoint")[0]
    assert {servo: goals(first_setpoint)[servo] for servo in (1, 2, 3, 4, 5)} == {
        servo: held[servo] for servo in (1, 2, 3, 4, 5)
    }


def test_saf_020_a_cable_that_is_plugged_in_again_with_a_servo_whose_answers_are_unreadable(
    arm: RealRobot, twin: Twin, mover: Mover
) -> None:
    """The handshake never succeeds. The arm is still made limp, and again at each stop."""
    twin.unplug()
    until(lambda: not status(arm)["connected"], "the loss is reported")
    mover.stop()
    twin.fault("garbage:5")
    plugged_ns = time.monotonic_ns()
    twin.plug()
    until(lambda: limps(twin.log, plugged_ns), "the arm is limp")
    first = next(entry for entry in twin.log.entries(plugged_ns) if entry.sender == "host")
    assert first.data == p.LIMP
    others = {name: servo for name, servo in IDS.items() if servo != 5}
    until(
        lambda: (
            {servo: torque_now(twin.log, plugged_ns).get(servo) for servo in others.values()}
            == dict.fromkeys(others.values(), 0)
        ),
        "the other servos have no torque",
    )
    until(lambda: "wrist_roll" in status(arm)["connect_error"], "the handshake has failed")
    assert state(arm) == "lost"
    stopped_ns = time.monotonic_ns()
    answer = arm.stop()
    assert "wrist_roll (id 5)" in why(answer)
    assert limps(twin.log, stopped_ns)
    assert not twin.log.host("enable", plugged_ns)
    twin.fault("ok:5")
    until(lambda: state(arm) == "disarmed", "the servo's answers are readable again")


def test_a_rollout_ends_when_the_cable_is_pulled(arm: RealRobot, twin: Twin) -> None:
    json_of(arm.run_policy(lambda observation: {"shoulder_pan": observation["shoulder_pan"] + 1.0}))
    until(lambda: len(twin.log.host("setpoint")) > 5, "the arm moves")
    twin.unplug()
    ended = task_ended(arm)
    assert ended["exit_reason"] in ("gate", "policy"), ended
    plugged_ns = time.monotonic_ns()
    twin.plug()
    until(lambda: state(arm) == "disarmed", "the arm is connected again")
    json_of(arm.resume())
    time.sleep(0.2)
    assert not twin.log.host("setpoint", plugged_ns)
    assert arm.send_action({"shoulder_pan": 0.0})["status"] == "success"


def test_the_arm_is_connected_again_after_each_of_several_losses(arm: RealRobot, twin: Twin) -> None:
    for _ in range(3):
        twin.unplug()
        until(lambda: not status(arm)["connected"], "the loss is reported")
        twin.plug()
        until(lambda: state(arm) == "disarmed", "the arm is connected again")
        json_of(arm.resume())
    assert arm.send_action({"shoulder_pan": 5.0})["status"] == "success"


def test_an_arm_without_torque_stays_so_when_its_cable_is_pulled(arm: RealRobot, twin: Twin) -> None:
    json_of(arm.stop())
    twin.unplug()
    until(lambda: not status(arm)["connected"], "the loss is reported")
    plugged_ns = time.monotonic_ns()
    twin.plug()
    until(lambda: state(arm) == "disarmed", "the arm is connected again")
    assert not twin.log.host("enable", plugged_ns)
    assert not twin.log.host("setpoint", plugged_ns)


@pytest.mark.long
def test_connect_waits_for_a_link_that_is_coming_back(arm: RealRobot, twin: Twin) -> None:
    twin.unplug()
    until(lambda: not status(arm)["connected"], "the loss is reported")
    assert (arm.connect_eagerly() or "").startswith("connect: ")
    twin.plug()
    assert arm.connect_eagerly() is None
    assert arm.send_action({"shoulder_pan": 5.0})["status"] == "success"


def test_connect_to_a_robot_that_is_not_plugged_in_yet(twin: Twin, new_arm: NewArm) -> None:
    twin.unplug()
    arm = new_arm(port=twin.port)
    reason = arm.connect_eagerly() or ""
    assert reason.startswith(f"connect: {twin.port}: cannot open"), reason
    assert not arm.is_connected
    assert arm.get_observation() == {}
    assert (status(arm)["connected"], f"connect: {status(arm)['connect_error']}") == (False, reason)
    assert "connect_eagerly()" in why(arm.send_action({"shoulder_pan": 0.0}))
    twin.plug()
    assert arm.connect_eagerly() is None
    assert arm.send_action({"shoulder_pan": 5.0})["status"] == "success"


def test_a_robot_with_a_servo_missing_is_not_energised(twin: Twin, new_arm: NewArm) -> None:
    twin.fault("off:3")
    arm = new_arm(port=twin.port)
    reason = arm.connect_eagerly() or ""
    assert "elbow_flex (id 3) does not answer" in reason, reason
    assert "Check cables and ids; so101 has ids 1, 2, 3, 4, 5, 6" in reason
    assert "elbow_flex" in status(arm)["connect_error"]
    time.sleep(0.3)
    assert not twin.log.host("enable")
    assert not twin.log.host("setpoint")
    twin.fault("ok:3")
    assert arm.connect_eagerly() is None
    assert arm.send_action({"elbow_flex": 5.0})["status"] == "success"


def test_connect_to_a_port_that_does_not_exist(new_arm: NewArm, tmp_path: Path) -> None:
    nothing = tmp_path / "nothing"
    reason = new_arm(port=str(nothing), tool_name="arm").connect_eagerly() or ""
    assert str(nothing) in reason and "Check port=" in reason
    with pytest.raises(ValueError, match="a folder"):
        new_arm(port=str(tmp_path), tool_name="other")
