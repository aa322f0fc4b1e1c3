"""Test a UR arm with its real tree: real processes and the twin. The twin's log decides.

The arm is commanded in two ways: by the unmodified ur-rtde, and by our own control script. The ordinary suite
runs the safety tests (SAF) in both ways and the others with ur-rtde. If ur-rtde cannot be installed, all of
them use the script.
"""

from __future__ import annotations

import math
import os
import signal
import socket
import struct
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import pytest

from strands_actors import Robot
from strands_actors.caller.handle.robot import RealRobot
from strands_actors.drivers.ur import protocol as p
from strands_actors.drivers.ur.arms import JOINTS, arm_of
from strands_actors.drivers.ur.driver import UR
from strands_actors.drivers.ur.gates import LEAD_S
from strands_actors.drivers.ur.protocol import DASHBOARD_PORT
from strands_actors.testing import Twin
from strands_actors.testing.wirelog import Entry
from tests import trees
from tests.answers import json_of, pids, resumed, state, status, task_ended, until, why
from tests.trees import Step, answers_status, made_safe, robot_on, run_for, set_moving, shared_twin

PAN, LIFT, ELBOW = "shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint"
"""Added to the published bounds, for a busy machine."""

UR_RTDE = pytest.param("ur-rtde", marks=pytest.mark.needs("ur-rtde"))
both_ways = pytest.mark.parametrize("way", [UR_RTDE, "script"], indirect=True)


@pytest.fixture(params=[UR_RTDE, pytest.param("script", marks=pytest.mark.long_beside("ur-rtde"))])
def way(request: pytest.FixtureRequest) -> str:
    """Return the way in which the arm is commanded."""
    return str(request.param)


@pytest.fixture(scope="module")
def twin_process(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Twin]:
    with Twin("ur5e", tmp_path_factory.mktemp("twin")) as process:
        yield process


@pytest.fixture
def twin(twin_process: Twin) -> Iterator[Twin]:
    with shared_twin(twin_process, "safety NORMAL", "mode RUNNING", "remote yes") as process:
        yield process


@pytest.fixture
def arm(twin: Twin, run_dir: Path, way: str) -> Iterator[RealRobot]:
    with robot_on(twin.port, "ur5e", control=way) as connected:
        yield connected


@pytest.fixture
def moving(arm: RealRobot, twin: Twin) -> RealRobot:
    set_moving(arm, twin.log, wave)
    return arm


def wave() -> Step:
    return trees.wave({PAN: 0.3}, 0.016)


def nudge(arm: RealRobot) -> Mapping[str, Any]:
    return trees.nudge(arm, PAN)


def comes_back(arm: RealRobot, twin: Twin) -> None:
    trees.comes_back(arm, twin.log, lambda: nudge(arm))


# -- the verbs


@both_ways
def test_connect_observe_act_stop_resume(arm: RealRobot, twin: Twin) -> None:
    seen = arm.get_observation()
    assert list(seen) == list(JOINTS)
    answer = json_of(arm.send_action({PAN: seen[PAN] + 0.02}))
    assert answer["robot"] == "ur5e"
    assert answer["joints"] == [PAN]
    assert math.isclose(answer["targets"][PAN], seen[PAN] + 0.02)
    assert answer["control_period"] == 0.008
    until(lambda: abs(arm.get_observation()[PAN] - seen[PAN] - 0.02) < 0.005, "it is there")
    reported = json_of(arm.state())
    assert (reported["robot_mode"], reported["safety_mode"], reported["model"]) == ("RUNNING", "NORMAL", "ur5e")
    assert [len(reported[name]) for name in ("tcp_pose", "tcp_speed", "wrench")] == [6, 6, 6]
    assert list(reported["joints"]) == list(reported["joint_velocities"]) == list(JOINTS)
    assert status(arm)["safety_mode"] == "NORMAL"

    began_ns = time.monotonic_ns()
    stopped = json_of(arm.stop())
    assert stopped["safe_state"] == "stop"
    assert list(stopped["motors"]) == list(JOINTS)
    made_safe(twin.log, began_ns)
    assert "resume() first" in why(arm.send_action({PAN: 0.0}))
    comes_back(arm, twin)


def test_a_slower_exchange_with_the_controller(twin: Twin, run_dir: Path, way: str) -> None:
    with Robot("ur5e", mode="real", port=twin.port, rtde_frequency=50.0, control=way) as arm:
        requested = [entry.data for entry in twin.log.entries() if b"actual_TCP_force" in entry.data]
        assert requested and struct.pack(">d", 50.0) in requested[-1]
        json_of(nudge(arm))
        until(lambda: twin.log.host("setpoint"), "it moves all the same")


def test_saf_014_refusals_name_the_joint_and_write_nothing(arm: RealRobot, twin: Twin) -> None:
    began_ns = time.monotonic_ns()
    assert f"{ELBOW} is nan" in why(arm.send_action({ELBOW: math.nan}))
    assert f"{ELBOW} 4.0000 rad is past" in why(arm.send_action({ELBOW: 4.0}))
    assert f"{ELBOW} steps" in why(arm.send_action({ELBOW: 0.0}))
    assert "elbow is not a joint of ur5e" in why(arm.send_action({"elbow": 0.0}))
    time.sleep(0.1)
    assert not twin.log.host("setpoint", began_ns)


@both_ways
def test_saf_014_targets_do_not_run_away_from_a_joint_that_is_held_back(arm: RealRobot, twin: Twin) -> None:
    """The arm would jump when it is released, because servoJ has no speed limit."""
    twin.fault("stuck:1")
    start = target = arm.get_observation()[PAN]
    began_ns = time.monotonic_ns()
    answer: Mapping[str, Any] = {}
    for _ in range(200):
        target += 0.02
        answer = arm.send_action({PAN: target})
        if answer["status"] != "success":
            break
    assert f"the target of {PAN} is" in why(answer) and "from its position" in why(answer)
    time.sleep(0.1)
    targets = [struct.unpack_from(">d", entry.data, 8)[0] for entry in twin.log.host("setpoint", began_ns)]
    longest_s = LEAD_S + UR.timing.state_ttl_s  # a sample may be this old
    assert 0.0 < max(targets) - start <= longest_s * arm_of("ur5e").axes[0].speed
    twin.fault("ok:1")
    json_of(arm.stop())
    json_of(arm.resume())
    json_of(nudge(arm))


@both_ways
def test_a_policy_runs_at_125_hz_and_ends_in_a_hold(arm: RealRobot, twin: Twin) -> None:
    task = run_for(arm, wave, 2.0)
    assert task["steps"] > 60, "half of the rate on a free machine"
    assert state(arm) == "holding"
    held_ns = time.monotonic_ns()
    time.sleep(0.5)
    assert not [entry for entry in twin.log.entries(held_ns) if entry.kind in ("watchdog", "setpoint")]
    assert len(twin.log.host("keepalive", held_ns)) > 2, "the controller's watchdog is fed while it holds"
    json_of(nudge(arm))


def hold_from_high_speed(arm: RealRobot) -> None:
    start, fast = 0.0, False

    def is_fast() -> bool:
        return bool(arm.get_observation()[PAN] - start > 1.0)

    for _ in range(5):  # a busy machine may end a rollout early
        start, steps = arm.get_observation()[PAN], iter(range(1, 1000))
        json_of(
            arm.run_policy(lambda _, start=start, steps=steps: {PAN: start + 0.018 * next(steps)}, duration=60.0)
        )
        until(lambda: is_fast() or not json_of(arm.get_task_status())["running"], "it is fast")
        if fast := is_fast():
            break
    assert fast, json_of(arm.get_task_status())
    arm.stop_task()


@pytest.mark.long
@pytest.mark.parametrize("way", [UR_RTDE], indirect=True)
def test_a_hold_from_high_speed_ends_the_program_by_the_watchdog_with_the_reason(
    arm: RealRobot, twin: Twin
) -> None:
    """No packet feeds the watchdog while servoStop brakes. The arm still stops, and no motion continues by
    itself."""
    hold_from_high_speed(arm)
    until(lambda: [entry for entry in twin.log.entries() if entry.kind == "watchdog"], "the watchdog ends it")
    until(lambda: "control script is not running" in why(nudge(arm)), "it is refused by name")
    stood = arm.get_observation()[PAN]
    time.sleep(0.3)
    assert abs(arm.get_observation()[PAN] - stood) < 0.01
    json_of(arm.stop())
    json_of(arm.resume())
    json_of(nudge(arm))


@pytest.mark.long
@pytest.mark.parametrize("way", ["script"], indirect=True)
def test_our_script_is_fed_while_it_brakes_and_takes_the_next_command(arm: RealRobot, twin: Twin) -> None:
    hold_from_high_speed(arm)
    until(lambda: state(arm) == "holding", "it holds")
    until(lambda: nudge(arm)["status"] == "success", "it takes the next command")
    assert not [entry for entry in twin.log.entries() if entry.kind == "watchdog"]


def test_saf_013_status_names_the_firmware_watchdog(arm: RealRobot) -> None:
    reported = status(arm)
    assert "rtde_set_watchdog, 10 Hz" in reported["firmware_watchdog"]
    assert reported["serial"] == "20265300001"
    assert reported["remote_control"] == "true"


@both_ways
def test_saf_013_a_latched_command_feeds_the_watchdog_as_long_as_the_caller_lives(
    arm: RealRobot, twin: Twin
) -> None:
    json_of(nudge(arm))
    time.sleep(0.5)
    assert state(arm) == "armed"
    assert not [entry for entry in twin.log.entries() if entry.kind == "watchdog"]


# -- refusals of the controller


def _says(reason: str, *either: str) -> bool:
    return any(words in reason for words in either)


@pytest.mark.parametrize(
    ("order", "undo", "name"),
    [
        ("safety PROTECTIVE_STOP", ("safety NORMAL",), "PROTECTIVE_STOP (3)"),
        ("safety ROBOT_EMERGENCY_STOP", ("safety NORMAL", "mode RUNNING"), "POWER_OFF (3)"),
        ("mode IDLE", ("mode RUNNING",), "IDLE (5)"),
    ],
)
def test_the_controller_stops_by_itself(
    moving: RealRobot, twin: Twin, order: str, undo: tuple[str, ...], name: str
) -> None:
    """The fault is named, no motion continues by itself when it is lifted, and arming is refused while it
    lasts.

    Either the gate or the wire notices it first. If the gate refuses a setpoint, the robot holds. If the wire
    meets it with a setpoint under way, it is a fault, which disarms.
    """
    twin.order(order)
    ended = task_ended(moving)
    if "no action for" in (ended["exit_detail"] or ""):  # a busy machine kept the policy waiting first
        for line in undo:
            twin.order(line)
        set_moving(moving, twin.log, wave)
        twin.order(order)
        ended = task_ended(moving)
    assert ended["exit_reason"] in ("gate", "stop"), ended
    until(lambda: _says(why(nudge(moving)), name, "is disarmed ("), "it is refused, and why")
    for line in undo:
        twin.order(line)
    fine = ("control script is not running", "Call resume() first")
    until(lambda: _says(why(nudge(moving)), *fine), "the mode is fine again")
    lifted_ns = time.monotonic_ns()
    time.sleep(0.3)
    assert not twin.log.host("setpoint", lifted_ns)
    twin.order(order)
    json_of(moving.stop())
    assert name in why(moving.resume())
    for line in undo:
        twin.order(line)
    resumed(moving)
    json_of(nudge(moving))


def press(twin: Twin, line: str, *answers: bytes) -> None:
    """Send a line to the dashboard, as the pendant does."""
    with socket.create_connection((twin.port.partition(":")[0], DASHBOARD_PORT), 10.0) as dashboard:
        dashboard.sendall(f"{line}\n".encode())
        until(lambda: any(map(dashboard.recv(4096).__contains__, answers)), line)


def end_program(twin: Twin) -> None:
    press(twin, "stop", b"Stopped")


def pause_program(twin: Twin) -> None:
    press(twin, "pause", b"Pausing program")


def protective_stop(twin: Twin) -> None:
    twin.order("safety PROTECTIVE_STOP")


@both_ways
@pytest.mark.parametrize("how", [end_program, pause_program, protective_stop])
def test_saf_003_a_target_that_stands_ends_when_the_controller_ends_its_program(
    arm: RealRobot, twin: Twin, how: Callable[[Twin], None]
) -> None:
    """No setpoint arrives that could be refused. The tree itself notices the end, stops the arm and gives the
    reason."""
    json_of(nudge(arm))
    ended_ns = time.monotonic_ns()  # taken before it: the tree may be quicker than the pendant's answer
    how(twin)
    until(lambda: state(arm) == "disarmed", "it is disarmed")
    # Either of the two reasons may reach the tree first.
    causes = ("control script is not running", "control script was paused", "PROTECTIVE_STOP (3)")
    assert status(arm)["cause"].startswith(causes)
    pressed = 0 if how is protective_stop else 1  # safe frames that the pendant causes
    until(lambda: len(twin.log.host("safe", ended_ns)) > pressed, "a safe frame of ours")
    ours_ns = twin.log.host("safe", ended_ns)[pressed].t_ns
    time.sleep(0.3)
    assert not twin.log.host("setpoint", ours_ns)
    assert "Call resume() first" in why(nudge(arm))


def test_a_pause_on_the_pendant_ends_the_program_with_the_remedy(arm: RealRobot, twin: Twin) -> None:
    """The tree does not end a paused program while the arm holds, because it writes nothing to it."""
    run_for(arm, wave, 0.3)
    assert state(arm) == "holding"
    pause_program(twin)
    until(lambda: status(arm)["sensors"]["runtime_state"] != [float(p.RuntimeState.PLAYING)], "the arm tells it")
    until(lambda: _says(why(nudge(arm)), "was paused on the pendant"), "it is named")
    assert why(nudge(arm)).endswith("Call resume()")
    paused_ns = time.monotonic_ns()
    press(twin, "play", b"Failed to execute", b"Starting")  # the watchdog may not have ended it yet
    time.sleep(0.3)
    assert not twin.log.host("setpoint", paused_ns) and not twin.log.host("keepalive", paused_ns)
    json_of(arm.resume())  # ends the program and starts another, without a stop()
    json_of(nudge(arm))


@pytest.mark.parametrize(
    ("order", "undo", "name", "remedy"),
    [
        (
            "safety PROTECTIVE_STOP",
            "safety NORMAL",
            "PROTECTIVE_STOP (3)",
            "unlock the protective stop on the pendant",
        ),
        (
            "mode POWER_OFF",
            "mode RUNNING",
            "POWER_OFF (3)",
            "Power on the arm and release its brakes on the pendant",
        ),
    ],
)
def test_saf_023_an_arm_that_holds_in_a_protective_stop_is_not_answered_armed(
    order: str, undo: str, name: str, remedy: str, arm: RealRobot, twin: Twin
) -> None:
    run_for(arm, wave, 0.3)
    assert state(arm) == "holding"
    twin.order(order)
    which = "safety_mode" if order.startswith("safety") else "robot_mode"
    until(lambda: status(arm)[which] == order.partition(" ")[2], "the arm tells it")
    assert name in why(nudge(arm))
    refused = why(arm.resume())
    assert refused.startswith("resume: ") and name in refused
    assert remedy in refused
    twin.order(undo)
    resumed(arm)
    json_of(nudge(arm))


def test_a_speed_slider_at_0_is_named(arm: RealRobot, twin: Twin) -> None:
    slider = p.frame(p.Kind.INPUTS, b"speed_slider_mask,speed_slider_fraction")
    with socket.create_connection((twin.port.partition(":")[0], p.RTDE_PORT), 10.0) as client:
        client.sendall(slider)
        until(lambda: b"UINT32,DOUBLE" in client.recv(4096), "it may write the slider")
        client.sendall(p.frame(p.Kind.DATA, struct.pack(">BId", 1, 1, 0.0)))
        until(lambda: status(arm)["sensors"]["speed_scaling"] == [0.0], "it is told")
        set_ns = time.monotonic_ns()
        assert "Raise the speed slider" in why(nudge(arm))
        assert not twin.log.host("setpoint", set_ns)
        client.sendall(p.frame(p.Kind.DATA, struct.pack(">BId", 1, 1, 0.5)))
        until(lambda: nudge(arm)["status"] == "success", "it moves again")


def test_a_protective_stop_accepts_a_connection_and_is_named(twin: Twin, run_dir: Path, way: str) -> None:
    twin.order("safety PROTECTIVE_STOP")
    time.sleep(0.1)
    arm = Robot("ur5e", mode="real", port=twin.port, control=way)
    try:
        until(lambda: "PROTECTIVE_STOP (3). Look at the arm" in (arm.connect_eagerly() or ""), "it says so")
        assert not twin.log.host("enable")
        twin.order("safety NORMAL")
        until(lambda: arm.connect_eagerly() is None, "it connects when it is unlocked")
    finally:
        arm.cleanup()


def test_local_control_is_named(twin: Twin, run_dir: Path, way: str) -> None:
    twin.order("remote no")
    time.sleep(0.1)
    arm = Robot("ur5e", mode="real", port=twin.port, control=way)
    try:
        until(lambda: "is in local control" in (arm.connect_eagerly() or ""), "it says so")
    finally:
        arm.cleanup()


# -- processes die and freeze


@both_ways
@pytest.mark.parametrize("fault", [signal.SIGKILL, pytest.param(signal.SIGSTOP, marks=pytest.mark.long)])
def test_saf_003_the_wire_process_dies_or_freezes(moving: RealRobot, twin: Twin, fault: signal.Signals) -> None:
    """The root stops the arm through its own sockets, and restarts the wire."""
    victim = pids(moving)["wire"]
    began_ns = time.monotonic_ns()
    os.kill(victim, fault)
    made_safe(twin.log, began_ns)
    assert twin.log.first_safe(began_ns).data == b"stop\n"  # type: ignore[union-attr]
    comes_back(moving, twin)


# -- the controller freezes, or its network goes


@pytest.mark.long
def test_saf_012_frozen_while_it_moves(moving: RealRobot, twin: Twin) -> None:
    twin.pause()
    answers_status(moving)
    until(lambda: not status(moving)["connected"], "the silence is noticed")
    # While the wire process is being replaced there is no gate. The task ends when its next setpoint is refused.
    refusals = ("move: not connected", "move: the gate of")
    until(lambda: why(nudge_blind(moving)).startswith(refusals), "a motion is refused")
    thawed_ns = time.monotonic_ns()
    twin.go_on()
    until(lambda: state(moving) == "disarmed", "it is back, disarmed")
    assert twin.log.host("safe", thawed_ns)
    # Only a few setpoints were under way when it froze. The watchdog has ended their program by now.
    assert len(twin.log.host("setpoint", thawed_ns)) < 30
    comes_back(moving, twin)


@both_ways
def test_saf_005_stop_of_a_frozen_controller_is_an_error_that_names_every_joint(
    moving: RealRobot, twin: Twin
) -> None:
    twin.pause()
    time.sleep(0.1)
    answer = moving.stop()
    assert all(joint in why(answer) for joint in JOINTS), answer
    answers_status(moving)
    twin.go_on()
    comes_back(moving, twin)


@both_ways
def test_saf_012_unplugged_while_it_moves(moving: RealRobot, twin: Twin, way: str) -> None:
    pulled_ns = time.monotonic_ns()
    twin.unplug()
    until(lambda: not status(moving)["connected"], "it is noticed")
    until(lambda: "cannot connect" in (status(moving)["connect_error"] or ""), "it says why")
    by_itself = ("watchdog",) if way == "ur-rtde" else ("watchdog", "stopj")
    until(lambda: [entry for entry in twin.log.entries(pulled_ns) if entry.kind in by_itself], "it stops by itself")
    assert why(moving.stop())
    twin.plug()
    comes_back(moving, twin)


@pytest.mark.long
def test_it_comes_back_however_often_it_is_unplugged(arm: RealRobot, twin: Twin) -> None:
    for _ in range(5):
        twin.unplug()
        until(lambda: not status(arm)["connected"], "it is noticed")
        twin.plug()
        until(lambda: state(arm) == "disarmed", "it is back")
        json_of(arm.resume())
    json_of(nudge(arm))


@both_ways
def test_a_clock_that_stands_still_is_no_link(moving: RealRobot, twin: Twin) -> None:
    """Samples go on, the socket is open, and every call of the SDK succeeds."""
    twin.fault("stuck")
    until(lambda: not status(moving)["connected"], "it is noticed")
    twin.fault("ok")
    comes_back(moving, twin)


def test_power_cycled(moving: RealRobot, twin: Twin) -> None:
    twin.power_cycle()
    until(lambda: not status(moving)["connected"], "it is noticed")
    until(lambda: state(moving) == "disarmed", "it is back")
    assert "robot is POWER_OFF (3)" in why(moving.resume())
    twin.order("mode RUNNING")
    resumed(moving)
    json_of(nudge(moving))


Stage = Callable[[Sequence[Entry]], bool]

FIRST_STAGES: Mapping[str, Stage] = {
    "hello": lambda frames: len(frames) >= 1,
    "look": lambda frames: any(entry.data[:3] == b"\x00\x03S" for entry in frames),
}
QUICK_STAGES = {"ur-rtde": ("hello", "look"), "script": ("upload",)}
STAGES: Mapping[str, Mapping[str, Stage]] = {
    "ur-rtde": {
        **FIRST_STAGES,
        "receive": lambda frames: sum(entry.data[:3] == b"\x00\x03S" for entry in frames) >= 2,
        "control": lambda frames: sum(b"get serial" in entry.data for entry in frames) >= 2,
        "inputs": lambda frames: any(entry.kind == "config" for entry in frames),
        "upload": lambda frames: any(entry.kind == "enable" for entry in frames),
        "watchdog": lambda frames: any(entry.kind == "config" and len(entry.data) == 16 for entry in frames),
    },
    "script": {
        **FIRST_STAGES,
        "inputs": lambda frames: any(entry.kind == "config" for entry in frames),
        "upload": lambda frames: any(entry.kind == "enable" for entry in frames),
        "watchdog": lambda frames: sum(entry.kind == "keepalive" for entry in frames) >= 2,
    },
}
"""Points of a connect, by the last message that the controller received."""
AT_A_STAGE = [
    pytest.param(
        way,
        stage,
        how,
        id=f"{way}-{stage}-{how}",
        marks=[
            *([pytest.mark.needs("ur-rtde")] if way == "ur-rtde" else []),
            *([] if stage in QUICK_STAGES[way] and how == "frozen" else [pytest.mark.long]),
        ],
    )
    for way in STAGES
    for stage in STAGES[way]
    for how in ("frozen", "unplugged")
]


@pytest.mark.parametrize(("way", "stage", "how"), AT_A_STAGE, indirect=["way"])
def test_saf_012_the_controller_goes_while_connecting(
    twin: Twin, run_dir: Path, way: str, stage: str, how: str
) -> None:
    """The tree still answers, a stop is bounded, and connecting works when the controller is back."""
    import threading

    arm = Robot("ur5e", mode="real", port=twin.port, control=way)
    connecting = threading.Thread(target=arm.connect_eagerly)
    reached = STAGES[way][stage]
    try:
        connecting.start()
        until(lambda: reached([entry for entry in twin.log.entries() if entry.sender == "host"]), stage)
        if how == "frozen":
            twin.pause()
        else:
            twin.unplug()
        answers_status(arm)
        arm.stop()
        twin.go_on()
        twin.plug()
        connecting.join(30.0)
        assert not connecting.is_alive()
        until(lambda: arm.connect_eagerly() is None, "it connects", 60.0)
        json_of(nudge(arm))
    finally:
        twin.go_on()
        arm.cleanup()


def nudge_blind(arm: RealRobot) -> dict[str, object]:
    """Send a command without reading first, since there may be no observation."""
    return dict(arm.send_action({PAN: 0.0}))


def test_a_twin_that_pauses_for_a_moment_misses_no_packet(arm: RealRobot, twin: Twin) -> None:
    """The twin's watchdog (0.1 s) uses the times of sending. The time at which the twin reads does not count."""
    for _ in range(5):
        assert nudge(arm)["status"] == "success"
        twin.pause()
        time.sleep(0.15)
        again_ns = time.monotonic_ns()
        twin.go_on()
        until(lambda: len(twin.log.host("setpoint", again_ns)) > 20, "it is written to again")  # noqa: B023
    assert not [entry for entry in twin.log.entries() if entry.kind == "watchdog"]
    assert state(arm) == "armed"
