"""Test a Gen3's whole tree on its twin: real processes and real sockets. The twin's log decides."""

from __future__ import annotations

import math
import os
import signal
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

import pytest

from strands_actors import Robot
from strands_actors.caller.handle.robot import RealRobot
from strands_actors.caller.session.portal import portal
from strands_actors.contract.driver import Reason
from strands_actors.drivers.kinova.protocol import Call, Decoder, Feedback
from strands_actors.testing import WireLog
from tests.answers import json_of, pids, resumed, state, status, task_ended, until, why
from tests.drivers.common.twin_process import TwinProcess
from tests.trees import connected, first_safe, is_resumed, made_safe, set_moving, wave

"""Added to the published bounds, for a busy machine."""

ROLLS_S = 0.1
"""The twin's arm comes to rest this long after its speeds were set to zero."""
AXES = [f"joint_{number}" for number in range(1, 8)]
STEP_RAD = 0.02


class Bench:
    """A twin with an arm on it."""

    def __init__(self, twin: TwinProcess, arm: RealRobot) -> None:
        self.twin = twin
        self.arm = arm
        self.log = WireLog(twin.log_path)

    def nudge(self, joint: str = "joint_1", step: float = STEP_RAD) -> Mapping[str, object]:
        return self.arm.send_action({joint: self.arm.get_observation().get(joint, 0.0) + step})

    def works(self) -> None:
        """Wait until it moves. A busy machine may need a second try: a reading of 75 ms ago does not count."""

        def moves() -> bool:
            if self.nudge()["status"] == "success":
                return True
            self.arm.resume()
            return False

        until(moves, "it moves")

    def move(self) -> None:
        """Start a motion by a policy."""
        set_moving(self.arm, self.log, lambda: wave({"joint_1": 0.2}, 0.05), setpoints=20)

    def comes_back(self) -> None:
        """Assert that it reconnects by itself, disarmed, and moves only after a resume, from its present
        position."""
        back_ns = is_resumed(self.arm, self.log, self.nudge)
        self.works()
        until(lambda: self.log.host("setpoint", back_ns), "a setpoint")


@contextmanager
def bench_of(directory: Path, connect: bool = True, **options: object) -> Iterator[Bench]:
    with TwinProcess(directory, "kinova_gen3", "kinova", options=options) as twin:
        bench = Bench(twin, Robot("kinova_gen3", mode="real", port=twin.port))
        try:
            if connect:
                connected(bench.arm)
            yield bench
        finally:
            twin.process.send_signal(signal.SIGCONT)
            bench.arm.cleanup()


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[Bench]:
    with bench_of(tmp_path) as made:
        yield made


# -- the verbs


def test_connect_observe_act_refuse_stop_resume(bench: Bench) -> None:
    arm, log = bench.arm, bench.log
    reported = status(arm)
    assert (reported["state"], reported["actuators"], reported["address"]) == ("armed", 7, bench.twin.port)
    assert set(reported["fallbacks"].values()) == {"hold", "stop"}
    assert "never expire" in reported["firmware_watchdog"]
    assert reported["sensors"]["arm_state"] == [7.0]
    seen = arm.get_observation()
    assert list(seen) == AXES
    assert seen == pytest.approx(dict(zip(AXES, (0, 0.262, 3.142, -2.269, 0, 0.96, 1.571), strict=True)), abs=1e-3)

    target = seen["joint_4"] + STEP_RAD
    answer = json_of(arm.send_action({"joint_4": target}))
    assert answer == {
        "robot": "kinova_gen3",
        "joints": ["joint_4"],
        "joint_speeds": {"joint_4": pytest.approx(STEP_RAD / 0.025, rel=0.01)},
    }
    until(lambda: abs(arm.get_observation()["joint_4"] - target) < 1e-3, "it is there")
    since_ns = time.monotonic_ns()
    time.sleep(0.5)
    assert 10 < len(log.host("setpoint", since_ns)) < 30, "the target is re-sent at 40 Hz while the caller lives"
    assert state(arm) == "armed"

    assert "joint_4 needs" in why(arm.send_action({"joint_4": target + 0.1}))
    assert "joint_8 is not a joint of kinova_gen3" in why(arm.send_action({"joint_8": 0.0}))
    since_ns = time.monotonic_ns()
    stopped = json_of(arm.stop())
    assert (stopped["safe_state"], list(stopped["motors"])) == ("stop", AXES)
    made_safe(bench.log, since_ns)
    bench.comes_back()


@pytest.mark.long
def test_a_policy_runs_at_40_hz_and_ends_in_a_hold_that_the_next_command_leaves(bench: Bench) -> None:
    for _ in range(5):  # a machine that pauses for 75 ms ends a rollout
        json_of(bench.arm.run_policy(wave({"joint_1": 0.2}, 0.05), duration=2.0))
        ended = task_ended(bench.arm)
        if ended["exit_reason"] == "duration":
            break
        resumed(bench.arm)
    assert ended["exit_reason"] == "duration", ended
    assert ended["steps"] > 40, "half of the rate on a free machine"
    assert state(bench.arm) == "holding"
    held_ns = time.monotonic_ns()
    time.sleep(0.3)
    assert not bench.log.host("setpoint", held_ns)
    bench.works()
    assert state(bench.arm) == "armed"


def test_an_emergency_stop_locks(bench: Bench) -> None:
    tree = bench.arm._tree
    assert tree is not None
    bench.move()
    since_ns = time.monotonic_ns()
    portal().call(tree.stop, Reason.ESTOP, True)
    made_safe(bench.log, since_ns)
    assert "e-stopped by" in why(bench.nudge())
    json_of(bench.arm.resume())
    bench.works()


# -- the base


@pytest.mark.parametrize(
    ("line", "named"), [("state IN_FAULT", "base in fault (bank 0x1)"), ("state IDLE", "IDLE (2)")]
)
def test_saf_003_a_base_that_is_no_longer_ready_disarms_the_tree_with_the_reason(
    bench: Bench, line: str, named: str
) -> None:
    bench.move()
    bench.twin.command(line)
    task_ended(bench.arm)
    until(lambda: state(bench.arm) == "disarmed", "it is disarmed")
    assert named in why(bench.arm.resume())
    bench.twin.command("state SERVOING_READY")
    since_ns = time.monotonic_ns()
    time.sleep(0.3)
    assert not bench.log.host("setpoint", since_ns), "no motion continues by itself"
    bench.comes_back()


def test_low_level_servoing_of_another_client_disarms_the_tree_and_a_resume_ends_it(bench: Bench) -> None:
    bench.move()
    bench.twin.command("mode LOW_LEVEL")
    task_ended(bench.arm)
    until(lambda: state(bench.arm) == "disarmed", "it is disarmed")
    bench.comes_back()


def test_a_base_in_fault_is_refused_at_connect(tmp_path: Path) -> None:
    with bench_of(tmp_path, connect=False) as bench:
        bench.twin.command("state IN_FAULT")
        time.sleep(0.2)
        until(lambda: "Clear the fault, then reconnect" in (bench.arm.connect_eagerly() or ""), "it says so")
        assert not bench.log.host("enable") and not bench.log.host("setpoint")
        bench.twin.command("state SERVOING_READY")
        connected(bench.arm)


def test_a_wrong_password_is_named_and_not_shown(tmp_path: Path) -> None:
    with TwinProcess(tmp_path, "kinova_gen3", "kinova") as twin:
        arm = Robot("kinova_gen3", mode="real", port=twin.port, password="hunter2")
        try:
            until(lambda: "INVALID_PASSWORD" in (arm.connect_eagerly() or ""), "it says so")
            assert "hunter2" not in str(arm.get_status())
            assert "hunter2" not in repr(arm)
        finally:
            arm.cleanup()
        assert b"hunter2".hex() not in twin.log_path.read_text()


# -- processes die and freeze


@pytest.mark.quick_cases(2)
@pytest.mark.parametrize("second", ["accepted", "refused", "powerless"])
@pytest.mark.parametrize("fault", [signal.SIGKILL, signal.SIGSTOP])
def test_saf_003_the_wire_process_dies_or_freezes_on_every_kind_of_base(
    tmp_path: Path, second: str, fault: signal.Signals
) -> None:
    with bench_of(tmp_path, second=second) as bench:
        bench.move()
        wire, since_ns = pids(bench.arm)["wire"], time.monotonic_ns()
        os.kill(wire, fault)
        made_safe(bench.log, since_ns)
        until(lambda: abs(arm_velocity(bench)) < 0.01, "it stands")
        bench.comes_back()
        assert not [entry for entry in bench.log.entries() if call_of(entry.data) == Call.APPLY_EMERGENCY_STOP]


def test_saf_003_the_stop_channel_stands_before_anything_is_energised(bench: Bench) -> None:
    calls = [call_of(entry.data) for entry in bench.log.entries() if entry.sender == "host"]
    logins = [at for at, call in enumerate(calls) if call == Call.CREATE_SESSION]
    assert len(logins) >= 3 and logins[2] < calls.index(Call.SEND_JOINT_SPEEDS)


# -- the base freezes, or its network goes


def test_saf_012_frozen_while_it_moves(bench: Bench) -> None:
    """Commands under way are carried out when it wakes up, and then the stop."""
    bench.move()
    bench.twin.process.send_signal(signal.SIGSTOP)
    until(lambda: not status(bench.arm)["connected"], "it is noticed")
    assert why(bench.arm.stop())
    thawed_ns = time.monotonic_ns()
    bench.twin.process.send_signal(signal.SIGCONT)
    bench.comes_back()
    received = [entry.kind for entry in bench.log.entries(thawed_ns) if entry.sender == "host"]
    assert "safe" in received
    before_safe = received[: received.index("safe")].count("setpoint")
    assert before_safe <= 6, "at most three periods of setpoints precede the safe frame"


def test_saf_010_a_stop_of_a_frozen_base_is_not_confirmed_and_follows_earlier_commands(
    bench: Bench,
) -> None:
    bench.move()
    bench.twin.process.send_signal(signal.SIGSTOP)
    answer = bench.arm.stop()
    assert all(axis in why(answer) for axis in AXES)
    thawed_ns = time.monotonic_ns()
    bench.twin.process.send_signal(signal.SIGCONT)
    made_safe(bench.log, thawed_ns)
    bench.comes_back()


@pytest.mark.quick_cases(1)
@pytest.mark.parametrize("second", ["accepted", "refused"])
def test_saf_020_unplugged_while_it_moves_the_first_frame_on_the_new_link_is_the_safe_one(
    tmp_path: Path, second: str
) -> None:
    """A base with room for one session has to end the old one first."""
    with bench_of(tmp_path, second=second) as bench:
        bench.move()
        bench.twin.command("unplug")
        until(lambda: not status(bench.arm)["connected"], "it is noticed")
        assert why(bench.nudge())
        since_ns = time.monotonic_ns()
        bench.twin.command("plug")
        bench.comes_back()
        written = [entry.kind for entry in bench.log.entries(since_ns) if entry.sender == "host"]
        assert next(kind for kind in written if kind in ("safe", "setpoint", "enable")) == "safe"


def test_it_comes_back_however_often_it_is_unplugged(bench: Bench) -> None:
    for _ in range(5):
        bench.twin.command("unplug")
        until(lambda: not status(bench.arm)["connected"], "it is noticed")
        bench.twin.command("plug")
        until(lambda: state(bench.arm) == "disarmed", "it is back")
        json_of(bench.arm.resume())
    bench.works()


def test_the_power_is_cut(bench: Bench) -> None:
    bench.move()
    bench.twin.command("power-cycle")
    until(lambda: state(bench.arm) != "armed", "it is noticed")
    bench.comes_back()


def test_the_power_is_off_for_a_while(bench: Bench) -> None:
    bench.move()
    bench.twin.command("fault off")
    until(lambda: not status(bench.arm)["connected"], "it is noticed")
    bench.twin.command("fault ok")
    bench.comes_back()


def test_saf_012_feedback_that_stands_still_ends_a_motion_and_the_link(bench: Bench) -> None:
    """The base answers, and its arm obeys."""
    bench.move()
    since_ns = time.monotonic_ns()
    bench.twin.command("fault stuck")
    made_safe(bench.log, since_ns)
    until(lambda: not status(bench.arm)["connected"], "it is noticed")
    bench.twin.command("fault ok")
    task_ended(bench.arm)
    until(lambda: abs(arm_velocity(bench)) < 0.01, "it stands")
    bench.comes_back()


def test_saf_012_answers_that_are_late_end_a_motion(bench: Bench) -> None:
    bench.move()
    since_ns = time.monotonic_ns()
    bench.twin.command("fault delayed")
    made_safe(bench.log, since_ns)
    bench.twin.command("fault ok")
    task_ended(bench.arm)
    resumed(bench.arm)
    bench.works()


# -- in numbers


def test_after_a_killed_wire_the_arm_is_stopped_within_the_published_bound(bench: Bench) -> None:
    """Joint speeds never expire. How far the arm goes depends on the root."""
    bench.move()
    until(lambda: arm_velocity(bench) > 0.05, "it is on its way")
    since_ns = time.monotonic_ns()
    before = bench.arm.get_observation()["joint_1"]
    os.kill(pids(bench.arm)["wire"], signal.SIGKILL)
    stopped_s = (first_safe(bench.log, since_ns).t_ns - since_ns) / 1e9
    until(lambda: state(bench.arm) == "disarmed", "it is back")
    went = abs(bench.arm.get_observation()["joint_1"] - before)
    assert went < 0.2 * (stopped_s + ROLLS_S), "the arm moved no longer than until the stop"


def arm_velocity(bench: Bench) -> float:
    """Return the velocity of the fastest joint in the twin's newest feedback."""
    for entry in reversed(list(bench.log.entries())):
        if entry.sender == "robot" and entry.kind == "read":
            for frame in Decoder().feed(entry.data):
                if frame.call == Call.REFRESH_FEEDBACK:
                    seen = Feedback.decode(frame.payload)
                    return max(abs(math.radians(one.velocity_deg_s)) for one in seen.actuators)
    return math.inf


def call_of(data: bytes) -> int:
    return next((frame.call for frame in Decoder().feed(data)), 0)
