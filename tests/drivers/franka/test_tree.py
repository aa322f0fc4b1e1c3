"""Test a Franka arm with its real tree: real processes, with the twin on the wire. The twin's log decides."""

from __future__ import annotations

import functools
import itertools
import math
import os
import signal
import struct
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from strands_actors import Robot
from strands_actors.caller.handle.robot import RealRobot
from strands_actors.drivers.franka.arms import arm_of
from strands_actors.testing import Twin
from tests.answers import json_of, pids, resumed, state, status, until, why
from tests.drivers.common.twin_process import TwinProcess
from tests.trees import answers_status, made_safe, robot_on, shared_twin

from .arms_on_twins import away, cycle_of, is_at, wait_at

"""Added to the published bounds, for a busy machine."""
JOINTS = arm_of("panda").keys


@pytest.fixture(scope="module")
def twin_process(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Twin]:
    with Twin("panda", tmp_path_factory.mktemp("twin")) as process:
        yield process


@pytest.fixture
def twin(twin_process: Twin) -> Iterator[Twin]:
    with shared_twin(twin_process, "mode IDLE", "success-rate measured") as process:
        yield process


@pytest.fixture
def arm(twin: Twin, run_dir: Path) -> Iterator[RealRobot]:
    with robot_on(twin.port, "panda") as connected:
        yield connected


@pytest.fixture
def moving(arm: RealRobot, twin: Twin) -> RealRobot:
    """Return an arm that moves for a second or more, in alternating directions from test to test."""
    far = 0.6 if arm.get_observation()[JOINTS[0]] < 0.5 else -0.6
    began_ns = time.monotonic_ns()
    json_of(arm.send_action({**arm.get_observation(), JOINTS[0]: arm.get_observation()[JOINTS[0]] + far}))
    until(lambda: len(twin.log.host("setpoint", began_ns)) > 100, "it moves")
    return arm


def comes_back(arm: RealRobot, twin: Twin) -> None:
    """Assert that it reconnects by itself, disarmed, and moves only after a resume, from its present position."""
    until(lambda: state(arm) == "disarmed", "it is back, disarmed")
    back_ns = time.monotonic_ns()
    assert "resume() first" in why(arm.send_action(away(arm, 0.01)))
    time.sleep(0.2)
    twin.log.silent_after(back_ns, "setpoint", "enable")
    resumed = json_of(arm.resume())
    seen = arm.get_observation()
    assert all(abs(resumed["position"][joint] - seen[joint]) < 0.01 for joint in JOINTS)
    time.sleep(0.1)
    twin.log.silent_after(back_ns, "setpoint", "enable")
    goal = away(arm, -0.01)
    json_of(arm.send_action(goal))
    wait_at(arm, goal)


def recovers(arm: RealRobot) -> None:
    """Recover as soon as no stop is under way."""
    answer = until(lambda: None if (reported := arm.recover())["status"] == "error" else reported, "it recovers")
    assert json_of(answer) == {"recovered": True}


def commanded(twin: Twin, since_ns: int) -> list[tuple[float, ...]]:
    """Return q_c of each setpoint in the log."""
    return [struct.unpack_from("<Q7d", entry.data)[1:] for entry in twin.log.host("setpoint", since_ns)]


# -- the verbs


def test_connect_observe_act_stop_resume(arm: RealRobot, twin: Twin) -> None:
    seen = arm.get_observation()
    assert list(seen) == list(JOINTS)
    goal = away(arm, 0.05)
    began_ns = time.monotonic_ns()
    answer = json_of(arm.send_action(goal))
    assert answer == {"robot": "panda", "joints": list(JOINTS), "targets": goal, "speed_factor": 0.2}
    wait_at(arm, goal)
    assert [entry.kind for entry in twin.log.entries(began_ns) if entry.kind == "reflex"] == []
    assert twin.log.host("setpoint", began_ns)[-1].data[8:64] == struct.pack("<7d", *goal.values())
    arrived_ns = time.monotonic_ns()
    time.sleep(0.3)
    assert state(arm) == "armed"
    twin.log.silent_after(arrived_ns, "setpoint"), "the controller holds the arm by itself"

    began_ns = time.monotonic_ns()
    stopped = json_of(arm.stop())
    assert stopped["safe_state"] == "stop"
    assert list(stopped["motors"]) == list(JOINTS)
    made_safe(twin.log, began_ns)
    comes_back(arm, twin)


def test_a_motion_keeps_the_selected_share_of_the_limits(arm: RealRobot, twin: Twin) -> None:
    began_ns = time.monotonic_ns()
    goal = away(arm, -0.3)
    json_of(arm.send_action(goal))
    wait_at(arm, goal)
    path = commanded(twin, began_ns)
    numbers = [struct.unpack_from("<Q", entry.data)[0] for entry in twin.log.host("setpoint", began_ns)]
    limits = arm_of("panda")
    for (at, before), (then, after) in itertools.pairwise(zip(numbers, path, strict=True)):
        for joint in range(7):
            speed = abs(after[joint] - before[joint]) / ((then - at) / 1e3)
            assert speed <= 0.2 * limits.speed[joint] + 1e-6


def test_a_new_target_replaces_the_one_before(moving: RealRobot, twin: Twin) -> None:
    began_ns = time.monotonic_ns()
    goal = away(moving, 0.0)
    json_of(moving.send_action(goal))
    wait_at(moving, goal)
    assert [entry.kind for entry in twin.log.entries(began_ns) if entry.kind == "reflex"] == []
    assert not twin.log.host("enable", began_ns), "the new target is part of the same motion"


def test_saf_014_refusals_name_the_joint_and_write_nothing(arm: RealRobot, twin: Twin) -> None:
    began_ns = time.monotonic_ns()
    here = arm.get_observation()
    assert "joint7 missing" in why(arm.send_action({joint: here[joint] for joint in JOINTS[:6]}))
    assert "joint4 is nan" in why(arm.send_action({**here, "joint4": math.nan}))
    assert "joint4 0.5000 rad is past -0.0698" in why(arm.send_action({**here, "joint4": 0.5}))
    assert "fr3_joint1 is not a joint of panda" in why(arm.send_action({**here, "fr3_joint1": 0.0}))
    time.sleep(0.1)
    twin.log.silent_after(began_ns, "setpoint", "enable")


def test_policies_are_refused_by_name(arm: RealRobot) -> None:
    for answer in (arm.run_policy(lambda seen: dict(seen)), arm.start_task("wave", policy_provider="mock")):
        assert "is moved by send_action" in why(answer)


def test_saf_013_status_shows_stride_scheduling_and_the_firmwares_reaction(arm: RealRobot) -> None:
    reported = status(arm)
    assert (reported["state_hz"], reported["stride"], reported["fci"], reported["speed_factor"]) == (
        1000,
        33,
        5,
        0.2,
    )
    assert reported["stream_rate_hz"] == pytest.approx(30.3, abs=0.1)
    assert reported["cycle_scheduling"].startswith(("SCHED_FIFO", "ordinary"))
    assert "after 20 ms of a motion without a command" in reported["firmware_watchdog"]
    assert reported["sensors"]["robot_mode"] == [1.0]
    assert reported["sensors"]["flange_m"][2] == pytest.approx(0.59, abs=0.3)


@pytest.mark.long
@pytest.mark.parametrize("robot", ["fr3", "fr3_v2"])
def test_the_arms_of_fci_10(robot: str, tmp_path: Path, run_dir: Path) -> None:
    with Twin(robot, tmp_path) as twin, robot_on(twin.port, robot, speed_factor=0.5, stream_rate_hz=100.0) as arm:
        assert (status(arm)["fci"], status(arm)["stride"]) == (10, 10)
        goal = away(arm, 0.2)
        json_of(arm.send_action(goal))
        wait_at(arm, goal)
        near_the_end = {**arm.get_observation(), arm.driver.axes[3]: arm.driver.limits.high[3]}
        json_of(arm.send_action(near_the_end))
        wait_at(arm, near_the_end)
        began_ns = time.monotonic_ns()
        json_of(arm.stop())
        made_safe(twin.log, began_ns)
        assert [entry.kind for entry in twin.log.entries() if entry.kind == "reflex"] == []


@pytest.mark.parametrize(
    ("robot", "fci", "said"),
    [
        ("panda", 10, "connect: controller has FCI 10, panda needs FCI 5. Use the fr3 or fr3_v2 driver"),
        ("fr3", 5, "connect: controller has FCI 5, fr3 needs FCI 10. Use the panda driver"),
    ],
)
def test_a_controller_of_the_other_version_is_named(
    robot: str, fci: int, said: str, tmp_path: Path, run_dir: Path
) -> None:
    with TwinProcess(tmp_path, robot, "franka", options={"fci": fci}) as twin:
        arm = Robot(robot, mode="real", port=twin.port)
        try:
            until(lambda: said in (arm.connect_eagerly() or ""), "it says so")
        finally:
            arm.cleanup()
        assert not [kind for kind, _ in twin.logged("host") if kind in ("setpoint", "enable")]


def test_a_twin_without_anything_else(run_dir: Path) -> None:
    """The README's case: no vendor SDK, no port."""
    with Robot("fr3", mode="real", transport="twin") as arm:
        goal = {joint: here - 0.05 for joint, here in arm.get_observation().items()}
        json_of(arm.send_action(goal))
        wait_at(arm, goal)


def test_a_simulation_moves_as_commanded(run_dir: Path) -> None:
    """One joint is enough. The gates that require all joints are the real arm's."""
    with Robot("panda") as sim:
        json_of(sim.send_action({"joint1": 0.3}))
        wait_at(sim, {"joint1": 0.3})
        goal = {joint: here + 0.3 for joint, here in sim.get_observation().items()}
        json_of(sim.send_action(goal))
        until(
            lambda: all(abs(sim.get_observation()[joint] - goal[joint]) < 0.01 for joint in JOINTS), "it is there"
        )
        assert sim.render(64, 48).shape == (48, 64, 3)


# -- refusals of the controller


@pytest.mark.parametrize(
    ("order", "said"),
    [
        ("reflex joint_reflex", "arm is in reflex (joint_reflex). recover() first"),
        ("mode USER_STOPPED", "user_stopped"),
    ],
)
def test_saf_003_the_controller_stops_by_itself(moving: RealRobot, twin: Twin, order: str, said: str) -> None:
    """The fault is named and disarms. No motion continues by itself afterwards, and arming is refused while it
    lasts."""
    began_ns = time.monotonic_ns()
    twin.order(order)
    until(lambda: state(moving) == "disarmed", "the tree notices by itself")
    made_safe(twin.log, began_ns)
    assert said in why(moving.resume())
    if order.startswith("reflex"):
        recovers(moving)
    else:
        until(lambda: "the controller refuses" in why(moving.recover()), "it is said")
        twin.order("mode IDLE")
    lifted_ns = time.monotonic_ns()
    time.sleep(0.3)
    twin.log.silent_after(lifted_ns, "setpoint")
    resumed(moving)
    goal = away(moving, 0.01)
    json_of(moving.send_action(goal))
    wait_at(moving, goal)


def test_a_reflex_before_connecting_is_named(twin: Twin, run_dir: Path) -> None:
    twin.order("reflex cartesian_reflex")
    time.sleep(0.1)
    arm = Robot("panda", mode="real", port=twin.port)
    try:
        until(lambda: "arm is in reflex (cartesian_reflex)" in (arm.connect_eagerly() or ""), "it says so")
        assert not twin.log.host("setpoint")
        recovers(arm)
        until(lambda: arm.connect_eagerly() is None, "it connects when it has recovered")
    finally:
        arm.cleanup()


def test_lost_commands_are_reported_and_new_targets_refused(moving: RealRobot, twin: Twin) -> None:
    twin.order("success-rate 0.4")
    until(lambda: "40%" in status(moving)["faults"].get("success_rate", ""), "status warns")
    assert "40% of the commands reach" in why(moving.send_action(moving.get_observation()))


# -- processes die and freeze


@pytest.mark.quick_cases(1)
@pytest.mark.parametrize("fault", [signal.SIGKILL, signal.SIGSTOP])
def test_saf_003_the_wire_process_dies_or_freezes(moving: RealRobot, twin: Twin, fault: signal.Signals) -> None:
    """The connection ends with the process. The root sees on its own connection that the arm stands."""
    victim, cycle = pids(moving)["wire"], cycle_of(moving)
    began_ns = time.monotonic_ns()
    os.kill(victim, fault)
    made_safe(twin.log, began_ns)
    if fault == signal.SIGKILL:  # frozen, its cycle may have braked the arm before
        assert [entry for entry in twin.log.entries(began_ns) if entry.kind == "aborted"]
    until(lambda: not Path(f"/proc/{cycle}").exists(), "the process of the cycle has ended with it")
    comes_back(moving, twin)


@pytest.mark.parametrize("fault", [signal.SIGKILL, signal.SIGSTOP])
def test_saf_003_the_cycle_process_dies_or_freezes(moving: RealRobot, twin: Twin, fault: signal.Signals) -> None:
    """Either the controller or a StopMove stops the arm first."""
    cycle = cycle_of(moving)
    began_ns = time.monotonic_ns()
    os.kill(cycle, fault)
    until(
        lambda: [entry for entry in twin.log.entries(began_ns) if entry.kind in ("reflex", "aborted", "safe")],
        "it stops",
    )
    until(lambda: state(moving) == "disarmed", "it is back, disarmed")
    assert twin.log.host("safe", began_ns)
    until(lambda: not Path(f"/proc/{cycle}").exists(), "nothing is left of it")
    if status(moving)["sensors"]["robot_mode"] == [4.0]:
        assert "communication_constraints_violation" in why(moving.resume())
        recovers(moving)
    comes_back(moving, twin)


def test_saf_016_wire_and_root_die_together(moving: RealRobot, twin: Twin) -> None:
    wire, root = pids(moving)["wire"], pids(moving)["root"]
    began_ns = time.monotonic_ns()
    os.kill(root, signal.SIGKILL)
    os.kill(wire, signal.SIGKILL)
    until(lambda: [entry for entry in twin.log.entries(began_ns) if entry.kind == "aborted"], "the motion ends")
    ended_ns = time.monotonic_ns()
    time.sleep(0.3)
    twin.log.silent_after(ended_ns, "setpoint")


# -- the controller freezes, or its network goes


@pytest.mark.long
def test_saf_012_frozen_while_it_moves(moving: RealRobot, twin: Twin) -> None:
    """Setpoints under way are followed by a safe frame when it wakes up."""
    twin.pause()
    answers_status(moving)
    assert not status(moving)["connected"]
    assert why(moving.send_action(dict.fromkeys(JOINTS, 0.1)))
    thawed_ns = time.monotonic_ns()
    twin.go_on()
    until(lambda: state(moving) == "disarmed", "it is back, disarmed")
    assert twin.log.host("safe", thawed_ns)
    assert len(twin.log.host("setpoint", thawed_ns)) < 30
    if status(moving)["sensors"]["robot_mode"] == [4.0]:
        recovers(moving)
    comes_back(moving, twin)


def test_saf_005_stop_of_a_frozen_controller_is_an_error_that_names_every_joint(
    moving: RealRobot, twin: Twin
) -> None:
    twin.pause()
    time.sleep(0.05)
    answer = moving.stop()
    assert all(joint in why(answer) for joint in JOINTS), answer
    thawed_ns = time.monotonic_ns()
    twin.go_on()
    until(lambda: twin.log.host("safe", thawed_ns), "SAF-010: what executes late is followed by the stop")
    until(lambda: state(moving) == "disarmed", "it is confirmed")
    twin.log.no_setpoint_after_safe(thawed_ns)
    comes_back(moving, twin)


def test_saf_012_unplugged_while_it_moves(moving: RealRobot, twin: Twin) -> None:
    pulled_ns = time.monotonic_ns()
    twin.unplug()
    until(lambda: not status(moving)["connected"], "it is noticed")
    until(lambda: "cannot connect" in (status(moving)["connect_error"] or ""), "it says why")
    assert [entry for entry in twin.log.entries(pulled_ns) if entry.kind == "aborted"], (
        "the controller stopped the arm"
    )
    assert why(moving.stop())
    twin.plug()
    comes_back(moving, twin)


@pytest.mark.quick_cases(1)
@pytest.mark.parametrize("fault", ["stuck", "garbage"])
def test_saf_012_states_without_news_do_not_count_as_a_link(moving: RealRobot, twin: Twin, fault: str) -> None:
    """Either its numbers do not change, or no message is a state. The connection is open all the same."""
    twin.fault(fault)
    until(lambda: not status(moving)["connected"] or state(moving) == "disarmed", "it is noticed")
    twin.fault("ok")
    until(lambda: state(moving) == "disarmed", "it is back, disarmed")
    if status(moving)["sensors"]["robot_mode"] == [4.0]:
        recovers(moving)
    comes_back(moving, twin)


@pytest.mark.long
def test_it_comes_back_however_often_it_is_unplugged(arm: RealRobot, twin: Twin) -> None:
    wire = pids(arm)["wire"]
    for _ in range(5):
        twin.unplug()
        until(lambda: not status(arm)["connected"], "it is noticed")
        twin.plug()
        until(lambda: state(arm) == "disarmed", "it is back")
        json_of(arm.resume())
    goal = away(arm, 0.01)
    json_of(arm.send_action(goal))
    wait_at(arm, goal)
    assert pids(arm)["wire"] == wire
    children = Path(f"/proc/{wire}/task/{wire}/children")
    until(lambda: len(children.read_text().split()) == 1, "one process of the cycle, and none left unburied")


def test_power_cycled(moving: RealRobot, twin: Twin) -> None:
    twin.power_cycle()
    until(lambda: not status(moving)["connected"], "it is noticed")
    comes_back(moving, twin)


@pytest.mark.long
def test_saf_012_connecting_to_a_frozen_controller_ends_in_time(twin: Twin, run_dir: Path) -> None:
    """The vendor's constructors would never return here."""
    twin.pause()
    arm = Robot("panda", mode="real", port=twin.port)
    connecting = threading.Thread(target=arm.connect_eagerly)
    try:
        connecting.start()
        time.sleep(0.5)
        answers_status(arm)
        arm.stop()
        twin.go_on()
        connecting.join(30.0)
        assert not connecting.is_alive()
        until(lambda: arm.connect_eagerly() is None, "it connects", 60.0)
        goal = away(arm, 0.01)
        json_of(arm.send_action(goal))
        until(functools.partial(is_at, arm, goal), "it moves")
    finally:
        twin.go_on()
        arm.cleanup()
