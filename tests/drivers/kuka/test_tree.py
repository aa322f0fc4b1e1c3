"""Test a KUKA arm with its real tree: real processes, and the twin's FRI session. The twin's log decides."""

from __future__ import annotations

import contextlib
import math
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import pytest
from strands import Agent

from strands_actors import Robot
from strands_actors.caller.handle.robot import RealRobot
from strands_actors.drivers.kuka.protocol import JOINTS, decode_command
from strands_actors.surfaces.recording import read, replay
from strands_actors.testing import WireLog
from tests.agents.scripted import Scripted
from tests.answers import json_of, pids, state, status, task, task_ended, until, why
from tests.drivers.common.twin_process import TwinProcess
from tests.trees import armed, made_safe, wave

AXES = [f"joint{number}" for number in range(1, JOINTS + 1)]
PROGRAM = "from strands_actors.surfaces.cli import main; main()"
"""Added to the published bounds, for a busy machine."""


class Arm:
    """A connected and armed robot, its twin, and the twin's log."""

    def __init__(self, robot: RealRobot, twin: TwinProcess) -> None:
        self.robot = robot
        self.twin = twin
        self.log = WireLog(twin.log_path)

    def nudge(self, joint: str = "joint1", rad: float = 0.01) -> Mapping[str, Any]:
        """Send a small step from the joint's commanded position."""
        answer: Mapping[str, Any] = self.robot.send_action({joint: self.commanded(joint) + rad})
        return answer

    def commanded(self, joint: str = "joint1") -> float:
        until(lambda: "commanded_rad" in status(self.robot)["sensors"], "it says what it was commanded")
        row: list[float] = status(self.robot)["sensors"]["commanded_rad"]
        return row[AXES.index(joint)]

    def commandable(self) -> None:
        """Wait for an active session, and resume if it was disarmed."""
        until(lambda: status(self.robot).get("connected"), "it is connected")
        armed(self.robot)
        until(lambda: self.nudge(rad=0.0)["status"] == "success", "it may be commanded")

    def roll_out(self) -> None:
        """Run a policy that moves joint1. Start it again if a busy machine ends it early."""

        def runs() -> bool:
            if not task(self.robot)["running"]:
                self.commandable()
                began_ns[0] = time.monotonic_ns()
                json_of(self.robot.run_policy(wave({"joint1": 0.2}, 0.04), duration=60.0))
                return False
            return len(self.log.host("setpoint", began_ns[0])) > 30

        began_ns = [0]
        until(runs, "it moves")

    def sessions(self, since_ns: int = 0) -> list[str]:
        """Return the session's states, each with its reason."""
        entries = self.log.entries(since_ns)
        return [entry.data.decode() for entry in entries if entry.kind == "session"]

    def comes_back(self) -> None:
        """Assert that the robot reconnects by itself, disarmed, and moves only after a resume."""
        until(lambda: state(self.robot) == "disarmed", "it is back, disarmed")
        until(lambda: not task(self.robot)["running"], "the rollout has ended")
        back_ns = time.monotonic_ns()
        assert "resume() first" in why(self.robot.send_action({"joint1": 0.0}))
        time.sleep(0.2)
        assert not self.log.host("setpoint", back_ns), "no motion continues by itself"
        self.commandable()
        until(lambda: self.log.host("setpoint", back_ns), "a setpoint")


@contextlib.contextmanager
def arm(directory: Path, options: Mapping[str, Any] | None = None, **keywords: Any) -> Iterator[Arm]:
    directory.mkdir(exist_ok=True)
    with TwinProcess(directory, "kuka_iiwa", "kuka", options={"sample_ms": 5, **(options or {})}) as twin:
        robot = Robot("kuka_iiwa", mode="real", **{"port": twin.port, **keywords})
        with robot:
            connected = Arm(robot, twin)
            connected.commandable()
            yield connected


# -- the verbs


def test_connect_observe_act_stop_resume(tmp_path: Path) -> None:
    with arm(tmp_path) as iiwa:
        seen = iiwa.robot.get_observation()
        assert list(seen) == AXES
        target = iiwa.commanded() + 0.02
        answer = json_of(iiwa.robot.send_action({"joint1": target}))
        assert (answer["robot"], answer["joints"], answer["control_period"]) == ("kuka_iiwa", ["joint1"], 0.02)
        assert answer["targets"] == {"joint1": target}
        until(lambda: abs(iiwa.robot.get_observation()["joint1"] - target) < 0.002, "it is there")
        told = status(iiwa.robot)
        assert (told["sample_ms"], told["receive_multiplier"]) == (5, 1)
        assert "drops it to monitoring" in told["firmware_watchdog"]
        assert set(told["fallbacks"].values()) == {"hold"}

        began_ns = time.monotonic_ns()
        stopped = json_of(iiwa.robot.stop())
        assert (stopped["safe_state"], stopped["unconfirmed"], list(stopped["motors"])) == ("hold", [], AXES)
        made_safe(iiwa.log, began_ns)
        assert "resume() first" in why(iiwa.robot.send_action({"joint1": 0.0}))
        iiwa.comes_back()
        assert not [line for line in iiwa.sessions() if "aborted" in line]


@pytest.mark.quick_cases(1)
@pytest.mark.parametrize("sample_ms", [10, 5, 2])
def test_a_stream_moves_the_arm_at_every_sample_time(tmp_path: Path, sample_ms: int) -> None:
    """0.3 rad at 0.5 rad/s. A machine that pauses ends the stream: then it goes on from where it
    is."""
    with arm(tmp_path, {"sample_ms": sample_ms}) as iiwa:
        began = iiwa.commanded()
        deadline_s = time.monotonic() + 60.0
        while iiwa.commanded() < began + 0.3 - 1e-6:
            assert time.monotonic() < deadline_s, iiwa.sessions()
            if iiwa.robot.send_action({"joint1": min(iiwa.commanded() + 0.01, began + 0.3)})["status"] != "success":
                iiwa.commandable()
            time.sleep(0.02)
        until(lambda: abs(iiwa.robot.get_observation()["joint1"] - began - 0.3) < 0.005, "it is there")
        assert not [line for line in iiwa.sessions() if "aborted" in line]


def test_saf_014_refusals_name_the_joint_and_write_nothing(tmp_path: Path) -> None:
    with arm(tmp_path) as iiwa:
        json_of(iiwa.robot.stop())
        json_of(iiwa.robot.resume())
        began_ns = time.monotonic_ns()
        assert "joint4 is nan" in why(iiwa.robot.send_action({"joint4": math.nan}))
        assert "joint4 2.5000 rad is past 2.0943" in why(iiwa.robot.send_action({"joint4": 2.5}))
        assert "the limit is 0.02617 at 50 Hz" in why(iiwa.robot.send_action({"joint4": 0.0}))
        assert "elbow is not a joint of kuka_iiwa" in why(iiwa.robot.send_action({"elbow": 0.0}))
        time.sleep(0.1)
        assert not iiwa.log.host("setpoint", began_ns)


def test_without_a_port_the_sender_is_the_controller(tmp_path: Path) -> None:
    with arm(tmp_path, {"port": 30277, "from_port": 30278}, port=None, fri_port=30277) as iiwa:
        assert status(iiwa.robot)["address"] == iiwa.twin.port
        json_of(iiwa.nudge())


def test_keywords_are_checked_before_any_process_starts() -> None:
    with pytest.raises(ValueError, match=r"'fri_prot' -> 'fri_port'"):
        Robot("kuka_iiwa", mode="real", fri_prot=30201)
    with pytest.raises(ValueError, match="control_frequency is 1000"):
        Robot("kuka_iiwa", mode="real", control_frequency=1000)


def test_1_ms_is_refused_at_connect_by_name(tmp_path: Path) -> None:
    with TwinProcess(tmp_path, "kuka_iiwa", "kuka", options={"sample_ms": 1}) as twin:
        robot = Robot("kuka_iiwa", mode="real", port=twin.port)
        try:
            problem = robot.connect_eagerly()
            assert problem is not None and "FRI sample time 1 ms" in problem and "2 ms or more" in problem
        finally:
            robot.cleanup()


# -- the pendant


@pytest.mark.quick_cases(1)
@pytest.mark.parametrize(
    ("order", "undo", "code", "text"),
    [
        (
            "motion stop",
            "motion start",
            "fri_state",
            "FRI session is MONITORING_READY. Start the motion on the pendant",
        ),
        ("safety 1", "safety 0", "safety", "safety stop, level 1"),
        ("drive 3 0", "drive 3 2", "drives", "drive of joint3 is OFF"),
        ("client_mode 3", "client_mode 1", "client_mode", "FRI client command mode is TORQUE"),
        ("control_mode 2", "control_mode 0", "control_mode", "control mode is JOINT_IMPEDANCE"),
        ("overlay 0", "overlay 1", "overlay", "the controller has ended the FRI overlay"),
    ],
)
def test_saf_003_the_end_of_commanding_ends_the_live_command(
    tmp_path: Path, order: str, undo: str, code: str, text: str
) -> None:
    """No setpoint arrives that could be refused. The tree notices the fault, holds and gives the reason. No
    motion continues when the fault is lifted."""
    with arm(tmp_path) as iiwa:
        iiwa.roll_out()
        ordered_ns = time.monotonic_ns()
        iiwa.twin.command(order)
        ended = task_ended(iiwa.robot)
        # Either the refused setpoint or the watchdog's tick may notice it first.
        until(lambda: state(iiwa.robot) in ("holding", "disarmed"), "it is held")
        assert text.partition(". ")[0] in f"{ended['exit_detail']}, {status(iiwa.robot)['cause']}"
        made_safe(iiwa.log, ordered_ns)
        refusal = iiwa.robot.resume()  # a holding robot is refused; a disarmed one is armed again
        if refusal["status"] == "success":
            refusal = iiwa.robot.send_action({"joint1": iiwa.commanded()})
        assert text in why(refusal)
        assert refusal["content"][1]["json"]["refused"]["code"] == code
        iiwa.twin.command(undo)
        iiwa.twin.command("motion start")  # by a person: after a stop the program does not start again by itself
        lifted_ns = time.monotonic_ns()
        until(lambda: status(iiwa.robot)["sensors"]["fri_state"] == [4.0], "it is active again")
        time.sleep(0.2)
        assert not iiwa.log.host("setpoint", lifted_ns), "no motion continues by itself"
        iiwa.commandable()


# -- the host stalls, the wire or the root freezes


@pytest.mark.parametrize(("sample_ms", "dropped"), [(5, False), (2, True)])
def test_saf_003_a_stall_of_31_ms_ends_the_motion_and_the_session_comes_back(
    tmp_path: Path, sample_ms: int, dropped: bool
) -> None:
    with arm(tmp_path, {"sample_ms": sample_ms}) as iiwa:
        iiwa.roll_out()
        wire, stalled_ns = pids(iiwa.robot)["wire"], time.monotonic_ns()
        os.kill(wire, signal.SIGSTOP)
        time.sleep(0.031)
        os.kill(wire, signal.SIGCONT)
        task_ended(iiwa.robot)
        until(lambda: state(iiwa.robot) in ("holding", "disarmed"), "it is held")
        iiwa.log.no_setpoint_after_safe(stalled_ns)
        lost = [line for line in iiwa.sessions(stalled_ns) if line == "MONITORING_WAIT: no answers"]
        assert bool(lost) >= dropped  # a stall may last longer than intended
        ended_ns = time.monotonic_ns()
        until(lambda: status(iiwa.robot)["sensors"]["fri_quality"] >= [2.0], "the connection is good again")
        time.sleep(0.2)
        assert not iiwa.log.host("setpoint", ended_ns), "no motion continues by itself"
        iiwa.commandable()


@pytest.mark.quick_cases(1)
@pytest.mark.parametrize("fault", [signal.SIGKILL, signal.SIGSTOP])
def test_saf_003_the_wire_process_dies_or_freezes_and_the_root_answers(
    tmp_path: Path, fault: signal.Signals
) -> None:
    """At 10 ms a session barely survives 100 ms of silence. The root then continues from the wire's last
    position. A session that was dropped is only monitored."""
    with arm(tmp_path, {"sample_ms": 10}) as iiwa:
        iiwa.roll_out()
        began_ns = time.monotonic_ns()
        last = decode_command(iiwa.log.host("setpoint")[-1].data)
        os.kill(pids(iiwa.robot)["wire"], fault)
        made_safe(iiwa.log, began_ns)
        safe = decode_command(iiwa.log.host("safe", began_ns)[0].data)
        assert safe.sequence > last.sequence
        iiwa.comes_back()


def test_without_our_processes_the_session_ends_and_the_arm_is_held(tmp_path: Path) -> None:
    with arm(tmp_path) as iiwa:
        iiwa.roll_out()
        victims, gone_ns = [pids(iiwa.robot)["root"], pids(iiwa.robot)["wire"]], time.monotonic_ns()
        for pid in victims:
            os.kill(pid, signal.SIGKILL)
        until(lambda: "MONITORING_WAIT: no answers" in iiwa.sessions(gone_ns), "the controller drops it")
        assert len(iiwa.log.host("setpoint", gone_ns)) <= 1, "one setpoint may have been under way"


# -- holding


def test_saf_019_neither_a_hold_nor_a_later_command_moves_an_unnamed_joint(tmp_path: Path) -> None:
    """The measured position lags behind the commanded one. The hold uses the commanded position."""
    with arm(tmp_path) as iiwa:
        iiwa.roll_out()
        until(lambda: abs(iiwa.commanded() - iiwa.robot.get_observation()["joint1"]) > 0.001, "it lags behind")
        json_of(iiwa.robot.stop_task())
        until(lambda: state(iiwa.robot) == "holding", "it is held")
        held = decode_command(iiwa.log.host("safe")[-1].data).position
        json_of(iiwa.nudge("joint2"))
        time.sleep(0.2)
        json_of(iiwa.robot.stop())
        now = decode_command(iiwa.log.host("safe")[-1].data).position
        assert now[0] == pytest.approx(held[0], abs=1e-9)
        assert now[1] == pytest.approx(held[1] + 0.01, abs=1e-9)


@pytest.mark.long
def test_saf_004_a_script_that_is_stopped_is_held_and_its_session_goes_on(tmp_path: Path) -> None:
    """A latched target lives as long as its caller."""
    program = (
        "import sys, time; from strands_actors import Robot\n"
        "robot = Robot('kuka_iiwa', mode='real', port=sys.argv[1]); robot.connect_eagerly()\n"
        "while True:\n"
        "    told = robot.get_status()['content'][0]['json']['sensors']['commanded_rad'][0]\n"
        "    robot.send_action({'joint1': told + 0.005}); time.sleep(0.02)\n"
    )
    with TwinProcess(tmp_path, "kuka_iiwa", "kuka") as twin:
        log = WireLog(twin.log_path)
        environment = {**os.environ, "PYTHONPATH": os.pathsep.join(path for path in sys.path if path)}
        with subprocess.Popen([sys.executable, "-c", program, twin.port], env=environment) as script:
            try:
                until(lambda: len(log.host("setpoint")) > 30, "it moves")
                stopped_ns = time.monotonic_ns()
                script.send_signal(signal.SIGSTOP)
                until(lambda: log.first_safe(stopped_ns), "a safe frame")
                time.sleep(0.5)
                log.no_setpoint_after_safe(stopped_ns)
                assert not [entry for entry in log.entries(stopped_ns) if entry.kind == "session"]
            finally:
                script.kill()


def test_saf_010_late_answers_in_a_frozen_controller_end_in_a_hold(tmp_path: Path) -> None:
    with arm(tmp_path) as iiwa:
        iiwa.roll_out()
        iiwa.twin.process.send_signal(signal.SIGSTOP)
        answer = iiwa.robot.stop()
        assert all(joint in why(answer) for joint in AXES), "the refusal names every joint that is not confirmed"
        thawed_ns = time.monotonic_ns()
        iiwa.twin.process.send_signal(signal.SIGCONT)
        until(lambda: state(iiwa.robot) == "disarmed", "it is confirmed when it is heard again")
        kinds = [entry.kind for entry in iiwa.log.entries(thawed_ns) if entry.sender == "host"]
        assert "setpoint" not in kinds[kinds.index("safe") :]


# -- others


@pytest.mark.long
def test_a_recording_of_it_is_decided_the_same_again(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(path for path in sys.path if path)}
    with arm(tmp_path / "twin") as iiwa:
        command = [sys.executable, "-c", PROGRAM, "record", "kuka_iiwa", "-o", str(path)]
        with subprocess.Popen(command, stderr=subprocess.PIPE, env=environment, text=True) as recorder:
            try:
                assert recorder.stderr is not None
                assert recorder.stderr.readline().startswith("recording kuka_iiwa")
                iiwa.roll_out()
                json_of(iiwa.robot.stop())
                iiwa.comes_back()
                assert "joint4 2.5000 rad is past" in why(iiwa.robot.send_action({"joint4": 2.5}))
                recorder.send_signal(signal.SIGINT)
                _, told = recorder.communicate(timeout=60.0)
                assert recorder.returncode == 0, told
            finally:
                recorder.kill()
    outcome = replay(read(path))
    assert outcome.equal, outcome.difference
    assert outcome.steps > 50


def test_its_simulation_yields_to_the_wire(run_dir: Path) -> None:
    with Robot("kuka_iiwa") as sim:
        json_of(sim.send_action({"joint1": 0.5, "joint4": -1.0}))
        until(lambda: abs(sim.get_observation()["joint1"] - 0.5) < 0.01, "it is simulated")
        with Robot("kuka_iiwa", mode="real", transport="twin", sim=sim) as real:
            until(lambda: real.send_action({"joint1": 0.5})["status"] == "success", "the wire commands it")
            assert abs(real.get_observation()["joint1"] - 0.5) < 0.02, "the joint does not jump"
            until(lambda: "held by the robot on its wire" in str(sim.send_action({"joint1": 0.0})), "it yields")


def test_an_agent_keeps_it_and_stops_it(tmp_path: Path) -> None:
    with arm(tmp_path) as iiwa:
        iiwa.roll_out()
        began_ns = time.monotonic_ns()
        model = Scripted([("kuka_iiwa", {"action": "stop"})], "done")
        agent = Agent(model=model, tools=[iiwa.robot], callback_handler=None)
        assert agent.tool_names == ["kuka_iiwa"]
        agent("stop it")
        assert model.heard[0][0]["status"] == "success"
        made_safe(iiwa.log, began_ns)
