"""Test the T1's whole tree on its twin: real processes on RTPS. The twin's log decides."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import pytest
from strands import Agent

from strands_actors import Robot, estop
from strands_actors.caller.handle.robot import RealRobot
from strands_actors.drivers.booster import protocol as p
from strands_actors.drivers.booster import rpc
from strands_actors.drivers.booster.protocol import IDLE, Command, Fall
from strands_actors.drivers.booster.rpc import Api, Request
from strands_actors.testing import Bench, Faults, Victims, WireLog, cells_of, run_cell
from strands_actors.testing.bench import driver_of
from strands_actors.testing.wirelog import Entry
from tests.agents.scripted import Scripted
from tests.answers import json_of, pids, state, status, until, why
from tests.drivers.common.twin_process import TwinProcess
from tests.trees import armed, connected, first_safe

ROLLS_S = 0.2
"""The twin stands this long after a zero."""
"""Added to the published bounds, for a busy machine."""
TWIST_S = 0.3
ELBOW = 4


class T1:
    """A robot on its twin."""

    def __init__(self, robot: RealRobot, twin: TwinProcess) -> None:
        self.robot = robot
        self.twin = twin
        self.log = WireLog(twin.log_path)

    def enable(self) -> None:
        armed(self.robot)
        json_of(self.robot.enable_upper_body())

    def elbow(self, rad: float) -> None:
        json_of(self.robot.send_action({"left_elbow_pitch": rad}))

    @contextlib.contextmanager
    def commanded(self) -> Iterator[None]:
        """Send targets for its elbow throughout the block."""
        self.enable()
        over = threading.Event()
        writer = steadily(lambda: self.robot.send_action({"left_elbow_pitch": 0.1}), over)
        try:
            until(lambda: self.log.host("setpoint"), "it is commanded")
            yield
        finally:
            over.set()
            writer.join()

    def busy(self) -> int:
        """Start a motion of an arm and of the base. Return when they were ordered."""
        self.enable()
        self.elbow(self.robot.get_observation()["left_elbow_pitch"] + 0.15)
        json_of(self.robot.move(vx=0.3))
        at_ns = time.monotonic_ns()
        self.elbow(self.robot.get_observation()["left_elbow_pitch"] + 0.1)
        return at_ns

    def commands(self, since_ns: int = 0) -> list[tuple[Entry, Command]]:
        """Return every LowCmd."""
        entries = (entry for entry in self.log.entries(since_ns) if entry.sender == "host")
        return [(entry, p.decode_command(entry.data)) for entry in entries if b"api_id" not in entry.data]

    def requests(self, api: Api, since_ns: int = 0) -> list[tuple[Entry, Request]]:
        entries = (entry for entry in self.log.entries(since_ns) if b"api_id" in entry.data)
        found = [(entry, rpc.decode_request(entry.data)) for entry in entries if entry.sender == "host"]
        return [(entry, request) for entry, request in found if request.api == api]

    def moves(self, since_ns: int = 0) -> list[tuple[int, float]]:
        """Return the time and the forward speed of each command to the base."""
        return [
            (entry.t_ns, json.loads(request.body)["vx"]) for entry, request in self.requests(Api.MOVE, since_ns)
        ]

    def events(self, kind: str, since_ns: int = 0) -> list[str]:
        entries = self.log.entries(since_ns)
        return [entry.data.decode() for entry in entries if entry.sender == "robot" and entry.kind == kind]

    def sensor(self, name: str) -> list[float]:
        row: list[float] = status(self.robot)["sensors"].get(name, [])
        return row


@contextlib.contextmanager
def t1(
    directory: Path, twin: Mapping[str, Any] | None = None, port: str | None = None, **keywords: Any
) -> Iterator[T1]:
    with TwinProcess(directory, "booster_t1", "booster", options=dict(twin or {})) as served:
        robot = Robot("booster_t1", mode="real", port=served.port if port is None else port, **keywords)
        try:
            connected(robot)
            yield T1(robot, served)
        finally:
            robot.cleanup()


@pytest.fixture
def robot(tmp_path: Path, run_dir: Path) -> Iterator[T1]:
    with t1(tmp_path) as standing:
        yield standing


def steadily(act: Callable[[], object], over: threading.Event) -> threading.Thread:
    def run() -> None:
        while not over.is_set():
            act()
            time.sleep(0.02)

    thread = threading.Thread(target=run)
    thread.start()
    return thread


# -- the arms


def test_connecting_and_arming_write_no_command(robot: T1) -> None:
    time.sleep(0.5)
    assert {entry.kind for entry in robot.log.entries() if entry.sender == "host"} == {"read"}
    facts = status(robot.robot)
    assert (facts["motors"], facts["mode"]) == (23, "walking")


def test_saf_014_a_refused_command_is_not_written(robot: T1) -> None:
    here = robot.robot.get_observation()["left_elbow_pitch"]
    assert "Call enable_upper_body() first" in why(robot.robot.send_action({"left_elbow_pitch": here}))
    robot.enable()
    for action, words in (
        ({"left_knee_pitch": 0.4}, "(slot 14) is moved only by the onboard controller"),
        ({"head_yaw": 0.1}, "Call rotate_head"),
        ({"vx": 0.1}, "Call move(vx, vy, vyaw)"),
        ({"left_elbow_pitch": {"kp": 60.0}}, "has no q"),
        ({"left_elbow_pitch": 2.5}, "past"),
        ({"left_elbow_pitch": here + 0.5}, "steps"),
        ({"left_elbow_pitch": float("nan")}, "finite"),
    ):
        assert words in why(robot.robot.send_action(action))
    assert "outside -0.8..0.8 m/s" in why(robot.robot.move(vx=2.0))
    assert "outside" in why(robot.robot.rotate_head(pitch=2.0))
    assert "Use one of damping" in why(robot.robot.change_mode(mode="custom"))
    assert robot.log.host("setpoint") == []


def test_a_command_moves_one_joint_and_every_other_slot_is_zero(robot: T1) -> None:
    robot.enable()
    here = robot.robot.get_observation()
    answer = json_of(robot.robot.send_action({"left_elbow_pitch": 0.1}))
    assert answer == {
        "robot": "booster_t1",
        "joints": ["left_elbow_pitch"],
        "slots": [ELBOW],
        "targets": {"left_elbow_pitch": 0.1},
        "unit": "radians",
    }
    until(lambda: robot.robot.get_observation()["left_elbow_pitch"] > 0.08, "it moves")
    entry, first = robot.commands()[0]
    assert entry.kind == "setpoint" and len(first.motors) == 23
    for slot, motor in enumerate(first.motors):
        if 2 <= slot <= 9:
            assert (motor.mode, motor.kp, motor.kd, motor.tau) == (10, 60.0, 3.0, 0.0)
        else:
            assert motor == IDLE
    assert first.motors[5].q == pytest.approx(here["left_elbow_yaw"], abs=1e-3), (
        "a joint that the command does not name keeps its position"
    )
    again = robot.commands(entry.t_ns)
    assert len(again) > 5 and all(command == first for _, command in again), "the command is latched and re-sent"


def test_saf_003_a_frozen_caller_s_arms_are_held_where_they_are(run_dir: Path) -> None:
    driver = driver_of("booster_t1")
    cell = next(one for one in cells_of(driver) if (one.victim, one.fault) == (Victims.CALLER, Faults.FREEZE))
    with Bench("booster_t1") as bench:
        outcome = run_cell(cell, bench)
        assert (outcome.safe_state, outcome.all_motors, outcome.setpoints_after) == ("hold", True, 0), outcome.story
        hold = next(entry for entry in bench.log.host("safe") if entry.safe_state == "hold")
        before = next(entry for entry in reversed(bench.log.host("setpoint")) if entry.t_ns <= hold.t_ns)
        commanded, held = (p.decode_command(entry.data).motors[2].q for entry in (before, hold))
        assert held == pytest.approx(commanded, abs=0.05), "the arms are held at their positions in the motion"


def test_the_upper_body_can_be_given_back(robot: T1) -> None:
    robot.enable()
    robot.elbow(0.1)
    json_of(robot.robot.stop())
    assert robot.events("upper_body") == ["host", "back"]
    assert "Call resume() first" in why(robot.robot.send_action({"left_elbow_pitch": 0.1}))
    json_of(robot.robot.resume())
    assert "Call enable_upper_body() first" in why(robot.robot.send_action({"left_elbow_pitch": 0.1}))
    robot.enable()
    robot.elbow(robot.robot.get_observation()["left_elbow_pitch"] + 0.1)
    json_of(robot.robot.enable_upper_body(on=False))  # the same as disable_upper_body()
    assert "Call enable_upper_body() first" in why(robot.robot.send_action({"left_elbow_pitch": 0.1}))
    at_ns = time.monotonic_ns()
    robot.enable()
    time.sleep(0.3)
    assert robot.commands(at_ns) == [], "an older target is not sent when the arms are taken again"


def test_a_change_of_mode_takes_the_arms_away(robot: T1) -> None:
    robot.enable()
    robot.elbow(0.1)
    until(lambda: robot.log.host("setpoint"), "a setpoint")
    robot.twin.command("mode soccer")
    until(lambda: robot.sensor("upper_body") == [0.0], "it is seen")
    at_ns = time.monotonic_ns()
    time.sleep(0.3)
    assert robot.commands(at_ns) == [], "nothing is sent while the robot's controller has the arms"
    assert "enable_upper_body" in why(robot.robot.send_action({"left_elbow_pitch": 0.1}))


def test_in_custom_mode_no_frame_is_sent_that_would_let_go_of_the_legs(robot: T1) -> None:
    robot.enable()  # no command was sent yet
    robot.twin.command("mode custom")
    until(lambda: state(robot.robot) == "disarmed", "it is stopped")
    assert "custom mode" in status(robot.robot)["cause"]
    assert robot.commands() == []
    assert "custom mode" in why(robot.robot.resume())
    wire = pids(robot.robot)["wire"]
    os.kill(wire, signal.SIGKILL)
    until(lambda: state(robot.robot) == "disarmed" and pids(robot.robot)["wire"] != wire, "another one is there")
    assert robot.commands() == [], "the root sends no frame either"
    assert robot.events("fall") == []


# -- the base and the head


def test_saf_001_a_twist_ends_by_itself(robot: T1) -> None:
    assert json_of(robot.robot.move(vx=0.4, vyaw=0.2)) == {"vx": 0.4, "vy": 0.0, "vyaw": 0.2, "for_s": TWIST_S}
    until(lambda: len(robot.moves()) > 1, "it is ended")
    (began_ns, vx), (ended_ns, zero) = robot.moves()[:2]
    assert (vx, zero) == (0.4, 0.0)
    assert (ended_ns - began_ns) / 1e9 > TWIST_S - 0.05
    time.sleep(0.5)
    assert len(robot.moves()) == 2, "the twist ends with one zero, once that is answered"
    x_m, _ = robot.sensor("odometry_xy_m")
    assert 0.08 < x_m < 0.4 * ((ended_ns - began_ns) / 1e9 + ROLLS_S)


def test_a_repeated_twist_goes_on(robot: T1) -> None:
    for _ in range(8):
        json_of(robot.robot.move(vx=0.3))
        time.sleep(0.1)
    assert [vx for _, vx in robot.moves()] == [0.3] * 8
    until(lambda: robot.moves()[-1][1] == 0.0, "it ends")


def test_walking_leaves_the_arms_where_they_are(robot: T1) -> None:
    robot.enable()
    robot.elbow(0.15)
    until(lambda: robot.robot.get_observation()["left_elbow_pitch"] > 0.13, "it moves")
    for _ in range(5):
        json_of(robot.robot.move(vx=0.1))
        robot.robot.send_action({"right_elbow_pitch": 0.0})
        time.sleep(0.05)
    commanded = {command.motors[ELBOW].q for _, command in robot.commands() if command.motors[ELBOW].q > 0.1}
    assert commanded and all(q == pytest.approx(0.15) for q in commanded), (
        "the arm's target does not sink with each step"
    )


def test_it_walks_in_walking_mode_only(robot: T1) -> None:
    json_of(robot.robot.change_mode(mode="prepare"))
    assert "does not walk in prepare mode" in why(robot.robot.move(vx=0.1))
    assert robot.moves() == []
    json_of(robot.robot.change_mode(mode="walking"))
    json_of(robot.robot.move(vx=0.1))


def test_its_head_turns(robot: T1) -> None:
    assert json_of(robot.robot.rotate_head(pitch=0.2, yaw=-0.3)) == {"pitch": 0.2, "yaw": -0.3}
    (_, request), *rest = robot.requests(Api.ROTATE_HEAD)
    assert json.loads(request.body) == {"pitch": 0.2, "yaw": -0.3} and not rest


# -- stops


def test_a_stop_makes_it_stand_and_gives_the_arms_back(robot: T1) -> None:
    robot.busy()
    began_ns = time.monotonic_ns()
    stopped = json_of(robot.robot.stop())
    assert (stopped["safe_state"], stopped["path"], stopped["unconfirmed"]) == ("stop", "wire", [])
    first = robot.log.first_safe(began_ns)
    assert first is not None and b'"vx": 0.0' in first.data, "the base is stopped first"
    back = first_safe(robot.log, began_ns, "stop")
    held = [entry for entry, _ in robot.commands(first.t_ns) if entry.t_ns <= back.t_ns]
    assert held and all(entry.kind == "safe" for entry in held), "the arms are held until they are returned"
    robot.log.no_setpoint_after_safe(first.t_ns)
    assert robot.events("upper_body", began_ns) == ["back"]
    time.sleep(0.3)
    here = robot.sensor("odometry_xy_m")
    time.sleep(0.6)
    assert robot.sensor("odometry_xy_m") == here, "the base stands"
    assert len(robot.moves(began_ns)) == 1


def test_saf_007_an_estop_puts_it_into_damping(robot: T1) -> None:
    robot.busy()
    began_ns = time.monotonic_ns()
    (outcome,) = estop(by="a button", within_s=5.0)
    assert (outcome.outcome, outcome.safe_state) == ("safe", "damp")
    damp = first_safe(robot.log, began_ns, "damp")
    robot.log.no_setpoint_after_safe(damp.t_ns)
    assert "damping" in robot.events("mode", began_ns)
    assert "e-stopped by" in why(robot.robot.move(vx=0.1))


@pytest.mark.parametrize("role", ["wire", "root"])
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSTOP], ids=["kill", "stop"])
def test_saf_003_after_any_broken_process_the_robot_stands_and_has_its_arms_back(
    robot: T1, role: str, number: signal.Signals
) -> None:
    robot.busy()
    pid = pids(robot.robot)[role]
    began_ns = time.monotonic_ns()
    os.kill(pid, number)
    safe = first_safe(robot.log, began_ns, "stop")
    first = robot.log.first_safe(began_ns)
    assert first is not None
    robot.log.no_setpoint_after_safe(first.t_ns)
    assert b'"vx": 0.0' in first.data, "the base is stopped first"
    held = [entry for entry, _ in robot.commands(first.t_ns) if entry.t_ns <= safe.t_ns]
    assert held and all(entry.kind == "safe" for entry in held), "the arms are held until they are returned"
    assert robot.moves(began_ns)[-1][1] == 0.0
    until(lambda: robot.events("upper_body", began_ns) == ["back"], "its arms are its own")
    if number == signal.SIGSTOP:
        with contextlib.suppress(ProcessLookupError):
            os.kill(pid, signal.SIGCONT)
        time.sleep(0.3)
        robot.log.no_setpoint_after_safe(first.t_ns)


def test_saf_016_root_and_wire_at_once_leave_it_to_the_standby(robot: T1) -> None:
    robot.busy()
    victims = [pids(robot.robot)[role] for role in ("root", "wire")]
    began_ns = time.monotonic_ns()
    for pid in victims:
        os.kill(pid, signal.SIGKILL)
    first_safe(robot.log, began_ns, "stop")
    assert robot.moves(began_ns)[-1][1] == 0.0
    first = robot.log.first_safe(began_ns)
    assert first is not None
    robot.log.no_setpoint_after_safe(first.t_ns)


@pytest.mark.long
def test_saf_010_a_late_twist_is_followed_by_zero(robot: T1) -> None:
    """The robot's computer pauses with a twist under way, and continues after the caller has given up."""
    robot.enable()
    os.kill(robot.twin.process.pid, signal.SIGSTOP)
    assert "not answered" in why(robot.robot.move(vx=0.5))
    assert "not confirmed" in why(robot.robot.stop())
    back_ns = time.monotonic_ns()
    os.kill(robot.twin.process.pid, signal.SIGCONT)
    until(lambda: state(robot.robot) == "disarmed", "it is confirmed when it can be")
    moves = robot.moves(back_ns)
    assert moves, "the command that waited in the socket was carried out"
    assert moves[-1][1] == 0.0 and robot.events("upper_body", back_ns)[-1:] == ["back"]
    began = [at for at, (_, vx) in enumerate(moves) if vx]
    assert all(any(vx == 0.0 for _, vx in moves[at:]) for at in began)
    time.sleep(0.3)
    here = robot.sensor("odometry_xy_m")
    time.sleep(0.5)
    assert robot.sensor("odometry_xy_m") == here


def test_saf_020_a_lost_link_is_made_safe_when_it_is_back(robot: T1) -> None:
    robot.busy()
    robot.twin.command("unplug")
    until(lambda: state(robot.robot) in ("lost", "down", None), "it is noticed")
    back_ns = time.monotonic_ns()
    robot.twin.command("plug")
    until(lambda: state(robot.robot) == "disarmed", "it is back, disarmed")
    first_safe(robot.log, back_ns, "stop")
    orders = [entry for entry in robot.log.entries(back_ns) if entry.sender == "host" and entry.kind != "read"]
    assert b'"vx": 0.0' in orders[0].data, "the base is stopped first"
    assert robot.log.host("setpoint", back_ns) == []


def test_saf_012_a_fall_gives_it_its_arms_back(robot: T1) -> None:
    with robot.commanded():
        began_ns = time.monotonic_ns()
        robot.twin.command("fall")
        safe = first_safe(robot.log, began_ns, "stop")
    first = robot.log.first_safe(began_ns)
    assert first is not None and first.t_ns <= safe.t_ns
    robot.log.no_setpoint_after_safe(first.t_ns)
    until(lambda: robot.events("fall", began_ns) == ["IS_FALLING", "HAS_FALLEN"], "it lies")
    assert "HAS_FALLEN" in str(status(robot.robot)["cause"]) or "IS_FALLING" in str(status(robot.robot)["cause"])
    until(lambda: state(robot.robot) == "disarmed", "it is disarmed")
    until(lambda: robot.sensor("fall_state")[0] == Fall.HAS_FALLEN, "it is told")
    assert "the robot reports HAS_FALLEN" in why(robot.robot.resume())
    assert robot.robot.enable_upper_body()["status"] == "error"
    assert robot.robot.move(vx=0.1)["status"] == "error"
    robot.twin.command("get-up")
    robot.enable()
    robot.elbow(robot.robot.get_observation()["left_elbow_pitch"])


def test_saf_009_a_stop_during_a_hand_over_wins(robot: T1) -> None:
    robot.twin.command("freeze 0.3")
    asking = threading.Thread(target=robot.robot.enable_upper_body)
    asking.start()
    time.sleep(0.1)
    json_of(robot.robot.stop())
    asking.join()
    time.sleep(0.2)
    assert robot.events("upper_body")[-1:] != ["host"], "the upper body is not left to the host"
    assert "resume() first" in why(robot.robot.send_action({"left_elbow_pitch": 0.0}))


# -- its address and its name


def test_a_named_robot_has_separate_topics(tmp_path: Path, run_dir: Path) -> None:
    with t1(tmp_path, {"robot_name": "alice"}, robot_name="alice", cmd_type="serial") as robot:
        robot.enable()
        robot.elbow(0.1)
        until(lambda: robot.commands(), "a command")
        assert robot.commands()[0][1].command_type.name == "SERIAL"


@pytest.mark.long
def test_without_a_port_the_one_robot_on_the_network_is_found(tmp_path: Path, run_dir: Path) -> None:
    domain = 60 + os.getpid() % 30
    options = {"domain": domain, "multicast": True}
    with t1(tmp_path, options, port="", domain_id=domain, network_interface="127.0.0.1") as robot:
        assert status(robot.robot)["address"] == robot.twin.port.partition(":")[0]
        second = tmp_path / "second"
        second.mkdir()
        with TwinProcess(second, "booster_t1", "booster", options=options):
            other = Robot(
                "booster_t1", mode="real", domain_id=domain, network_interface="127.0.0.1", tool_name="other"
            )
            try:
                assert "several robots answer: " in str(other.connect_eagerly()), (
                    "with several robots the driver does not choose one"
                )
            finally:
                other.cleanup()


@pytest.mark.long
def test_without_a_robot_the_error_lists_the_searched_addresses(run_dir: Path) -> None:
    domain = 90 + os.getpid() % 10
    robot = Robot("booster_t1", mode="real", port="", domain_id=domain, network_interface="127.0.0.1")
    try:
        assert f"no robot answers in domain {domain}. Give the robot's address with port=" in str(
            robot.connect_eagerly()
        )
    finally:
        robot.cleanup()


# -- with others


def test_an_agent_can_look_and_stop_and_nothing_else_unasked(robot: T1) -> None:
    robot.busy()
    began_ns = time.monotonic_ns()
    model = Scripted(
        [("booster_t1", {"action": "move", "vx": 0.5})],
        [("booster_t1", {"action": "sensors"})],
        [("booster_t1", {"action": "stop"})],
        "done",
    )
    Agent(model=model, tools=[robot.robot], callback_handler=None)("look, then stop it")
    (spec,) = model.offered
    services = ["enable_upper_body", "disable_upper_body", "move", "rotate_head", "change_mode"]
    verbs = spec["inputSchema"]["json"]["properties"]["action"]["enum"]
    assert verbs == ["sensors", "status", "stop", *services], (
        "the agent's verbs are the services, which need approval, and three more"
    )
    assert "needs an operator's approval" in model.heard[0][0]["content"][0]["text"]
    assert [results[0]["status"] for results in model.heard] == ["error", "success", "success"]
    first_safe(robot.log, began_ns, "stop")
    assert 0.5 not in [vx for _, vx in robot.moves(began_ns)]
    assert state(robot.robot) == "disarmed"


def test_it_runs_no_policy(robot: T1) -> None:
    assert "a T1 runs no policies" in why(robot.robot.run_policy(lambda _: []))
    assert "a T1 runs no policies" in why(robot.robot.start_task("wave"))
