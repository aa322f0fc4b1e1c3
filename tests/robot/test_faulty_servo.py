"""One servo is silent, late or sends unreadable answers while the arm is in use (SAF-005). The other five
must not be affected.
"""

from __future__ import annotations

import time

import pytest

from strands_actors.caller.handle.robot import RealRobot
from strands_actors.testing import Twin
from tests.answers import json_of, state, status, until, why

from .helpers import IDS, at, goals, limps, replies, torque_now

FAULTS = ("off", "delayed", "garbage")
THIRD = "elbow_flex (id 3)"
OTHERS = [servo for servo in IDS.values() if servo != 3]

WINDOW_S = 1.5


def rates(twin: Twin) -> dict[int, float]:
    """Return the answers per second of each other servo from now on."""
    began_ns = time.monotonic_ns()
    time.sleep(WINDOW_S)
    counts = replies(twin.log, began_ns, began_ns + round(WINDOW_S * 1e9))
    return {servo: counts[servo] / WINDOW_S for servo in OTHERS}


def break_third(arm: RealRobot, twin: Twin, fault: str) -> None:
    twin.fault(f"{fault}:3")
    until(
        lambda: "silent" in status(arm)["faults"].get("elbow_flex", ""), "the fault of the third servo is reported"
    )


@pytest.mark.quick_cases(1)
@pytest.mark.parametrize("fault", FAULTS)
def test_the_other_servos_continue(arm: RealRobot, twin: Twin, fault: str) -> None:
    normal = rates(twin)
    break_third(arm, twin, fault)
    seen = rates(twin)
    assert all(seen[servo] >= normal[servo] / 2 for servo in OTHERS), (seen, normal)

    refusal = until(lambda: _refused(arm, {"elbow_flex": 5.0}), "a command to the third is refused")
    assert f"no position from {THIRD} for" in refusal
    assert refusal.startswith("move: ")
    assert "elbow_flex" in why(arm.send_action({"shoulder_pan": 5.0, "elbow_flex": 5.0}))
    began_ns = time.monotonic_ns()
    assert arm.send_action({"shoulder_pan": 20.0})["status"] == "success"
    assert until(lambda: twin.log.host("setpoint", began_ns), "a setpoint")
    at(arm, "shoulder_pan", 20.0)
    assert status(arm)["observation_age_s"] < 0.5
    assert state(arm) == "armed"

    twin.fault("ok:3")
    until(lambda: "silent" not in status(arm)["faults"].get("elbow_flex", ""), "the third servo answers again")
    if fault == "off":  # its power was off, so its torque is off
        until(lambda: "is limp" in (_refused(arm, {"elbow_flex": 5.0}) or ""), "its missing torque is reported")
        json_of(arm.stop())
        json_of(arm.resume())
    assert arm.send_action({"elbow_flex": 5.0})["status"] == "success"
    at(arm, "elbow_flex", 5.0, within=4.0)


def _refused(arm: RealRobot, action: dict[str, float]) -> str | None:
    answer = arm.send_action(action)
    return None if answer["status"] == "success" else answer["content"][0]["text"]


@pytest.mark.quick_cases(1)
@pytest.mark.parametrize("fault", FAULTS)
def test_stop_releases_five_servos_and_names_the_sixth(arm: RealRobot, twin: Twin, fault: str) -> None:
    arm.send_action({"shoulder_pan": 20.0})
    break_third(arm, twin, fault)
    stopped_ns = time.monotonic_ns()
    answer = arm.stop()
    took_s = (time.monotonic_ns() - stopped_ns) / 1e9
    assert took_s < 3.0
    twin.log.safe_within(stopped_ns, 0.3)
    assert limps(twin.log, stopped_ns)
    off = torque_now(twin.log, stopped_ns)
    assert {servo: off.get(servo) for servo in OTHERS} == dict.fromkeys(OTHERS, 0)

    assert THIRD in why(answer)
    report = answer["content"][1]["json"]
    assert (report["stopped"], report["unconfirmed"]) == (False, ["elbow_flex"])
    assert [name for name, motor in report["motors"].items() if motor["safe"]] == [
        name for name in IDS if name != "elbow_flex"
    ]
    assert "resume() first" in why(arm.send_action({"shoulder_pan": 0.0}))
    assert state(arm) == "unconfirmed"

    twin.fault("ok:3")
    until(lambda: state(arm) == "disarmed", "the third servo answers again and is released")
    assert torque_now(twin.log, stopped_ns) == dict.fromkeys(IDS.values(), 0)
    assert twin.log.setpoints_after_safe(stopped_ns) == 0
    json_of(arm.resume())
    assert arm.send_action({"elbow_flex": 5.0, "shoulder_pan": 0.0})["status"] == "success"
    at(arm, "shoulder_pan", 0.0)


@pytest.mark.quick_cases(1)
@pytest.mark.parametrize("fault", ["off", "garbage"])
def test_an_arm_with_a_dead_servo_is_not_energised(arm: RealRobot, twin: Twin, fault: str) -> None:
    break_third(arm, twin, fault)
    arm.stop()
    resumed_ns = time.monotonic_ns()
    assert THIRD in why(arm.resume())
    assert state(arm) in ("unconfirmed", "stopping")
    assert not twin.log.host("enable", resumed_ns)
    assert not twin.log.host("setpoint", resumed_ns)


def test_a_goal_of_the_silent_joint_is_never_invented(arm: RealRobot, twin: Twin) -> None:
    """Commands to other joints send its last good target, or no target for it."""
    arm.send_action({"elbow_flex": 10.0})
    target = goals(until(lambda: twin.log.host("setpoint"), "a setpoint")[0])[3]
    break_third(arm, twin, "delayed")
    began_ns = time.monotonic_ns()
    arm.send_action({"gripper": 50.0})
    written = until(lambda: twin.log.host("setpoint", began_ns), "a setpoint")
    assert {goals(entry).get(3, target) for entry in written} == {target}
