"""A thread of the script sends a command directly to the gate, without the event loop of its process. The
result is the same as through the loop.
"""

from __future__ import annotations

import json
import os
import signal
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import msgspec
import pytest

from strands_actors import Robot, estop
from strands_actors.caller.handle.robot import RealRobot
from strands_actors.caller.session.portal import portal
from strands_actors.testing import Twin
from tests.answers import json_of, pids, resumed, status, until, why

from .conftest import NewArm
from .helpers import far

HELD_UP_S = 0.5
"""Shorter than the time that a lease lives without heartbeats from the loop."""


@contextmanager
def no_loop() -> Iterator[None]:
    """Block the event loop of this process."""
    over, begun = threading.Event(), threading.Event()

    async def hold() -> None:
        begun.set()
        over.wait(HELD_UP_S)

    portal().submit(hold)
    begun.wait()
    try:
        yield
    finally:
        over.set()


def test_a_blocked_event_loop_delays_no_command(arm: RealRobot, twin: Twin) -> None:
    target = far(arm)
    with no_loop():
        began_s = time.monotonic()
        since_ns = time.monotonic_ns()
        sent = json_of(arm.send_action({"shoulder_pan": target}))
        seen = arm.get_observation()
        took_s = time.monotonic() - began_s
    assert sent["commanded"] == {"shoulder_pan": pytest.approx(target, abs=0.2)}
    assert set(seen) == set(arm.driver.axes)
    assert took_s < HELD_UP_S / 2
    until(lambda: bool(twin.log.host("setpoint", since_ns)), "the setpoint is on the wire")


def test_a_refusal_has_the_same_text_as_through_the_loop(arm: RealRobot) -> None:
    with no_loop():
        unknown = why(arm.send_action({"elbow": 1.0}))
    assert "elbow" in unknown
    assert arm._tree is not None
    by_loop = portal().call(arm._tree.send_action, {"elbow": 1.0})
    assert by_loop.text in unknown


def test_a_command_after_a_stop_is_refused_and_after_resume_it_is_accepted(arm: RealRobot, twin: Twin) -> None:
    """Both times the thread's lease is stale. The loop acquires a new one, or gets the reason of the
    refusal.
    """
    json_of(arm.send_action({"shoulder_pan": far(arm)}))
    arm.stop()
    stopped_ns = time.monotonic_ns()
    assert "resume()" in why(arm.send_action({"shoulder_pan": 0.0}))
    assert not twin.log.host("setpoint", stopped_ns)
    json_of(arm.resume())
    json_of(arm.send_action({"shoulder_pan": far(arm)}))
    with no_loop():
        json_of(arm.send_action({"shoulder_pan": far(arm)}))


def test_a_command_during_a_rollout_is_refused(arm: RealRobot) -> None:
    here = arm.get_observation()
    json_of(arm.run_policy(lambda _: here, duration=20.0))
    assert "stop_task()" in why(arm.send_action({"shoulder_pan": 0.0}))
    json_of(arm.stop_task())
    json_of(arm.send_action({"shoulder_pan": far(arm)}))


def test_saf_006_a_stop_is_sent_by_the_calling_thread_even_if_the_loop_is_blocked(
    arm: RealRobot, twin: Twin
) -> None:
    json_of(arm.send_action({"shoulder_pan": far(arm)}))
    with no_loop():
        began_ns = time.monotonic_ns()
        stopping = threading.Thread(target=arm.stop)
        stopping.start()
        until(lambda: twin.log.first_safe(began_ns) is not None, "the robot is safe")
        assert time.monotonic_ns() - began_ns < HELD_UP_S * 1e9 / 2
    stopping.join()
    assert twin.log.setpoints_after_safe(began_ns) == 0


def test_a_waiting_thread_returns_when_the_robot_is_cleaned_up(arm: RealRobot) -> None:
    """Its command waits for the answer of a wire that is stopped."""
    wire = pids(arm)["wire"]
    answers: list[str] = []
    os.kill(wire, signal.SIGSTOP)
    asking = threading.Thread(target=lambda: answers.append(why(arm.send_action({"shoulder_pan": 0.0}))))
    asking.start()
    time.sleep(0.02)
    arm.cleanup()
    asking.join(5.0)
    assert answers and "move:" in answers[0]


def in_child(ask: Callable[[], object]) -> Any:
    """Return the answer of a forked child."""
    reading, writing = os.pipe()
    child = os.fork()
    if child == 0:
        try:
            os.write(writing, json.dumps(ask()).encode())
        finally:
            os._exit(0)
    os.close(writing)
    os.waitpid(child, 0)
    with open(reading, "rb") as answer:
        return json.loads(answer.read())


def test_saf_023_verbs_in_a_forked_child_return_errors(arm: RealRobot) -> None:
    """The robot belongs to another process. The answers name that process, a command that stops the
    robot, and the motors.
    """
    verbs = ("cleanup", "release", "stop_task", "get_task_status", "resume")

    def ask() -> dict[str, Any]:
        answers = {verb: getattr(arm, verb)() for verb in verbs}
        answers["send_action"] = arm.send_action({"shoulder_pan": 0.0})
        return {**answers, "seen": arm.get_observation(), "status": arm.get_status(), "tree": arm.tree()}

    answers = in_child(ask)
    for verb in (*verbs, "send_action"):
        assert answers[verb]["status"] == "error", verb
        text = answers[verb]["content"][0]["text"]
        assert f"process {os.getpid()}, from which this one was forked, has the robot" in text
        assert f"`strands-actors stop {arm.name}`" in text
    assert answers["cleanup"]["content"][1]["json"]["unconfirmed"] == list(arm.driver.axes)
    assert answers["seen"] == {}
    assert answers["status"]["content"][0]["json"]["state"] == answers["tree"]["state"] == "unreachable"
    json_of(arm.send_action({"shoulder_pan": far(arm)}))


def test_saf_023_a_forked_child_can_stop_the_robot(arm: RealRobot, twin: Twin) -> None:
    json_of(arm.send_action({"shoulder_pan": far(arm)}))
    before_ns = time.monotonic_ns()
    answer = in_child(arm.stop)
    assert answer["status"] == "success" and answer["content"][0]["json"]["stopped"] is True
    assert set(answer["content"][0]["json"]["motors"]) == set(arm.driver.axes)
    assert next(entry for entry in twin.log.host("safe", before_ns)).safe_state == "limp"
    assert status(arm)["state"] == "disarmed"
    outcomes = in_child(lambda: [msgspec.to_builtins(outcome) for outcome in estop()])
    assert [(outcome["robot"], outcome["outcome"]) for outcome in outcomes] == [(arm.name, "safe")]
    assert status(arm)["locked_by"]


def test_two_threads_command_one_robot(arm: RealRobot) -> None:
    """Neither thread is refused because of the other one."""
    here = arm.get_observation()["wrist_roll"]
    answers: list[str] = []

    def many() -> None:
        answers.extend(arm.send_action({"wrist_roll": here})["status"] for _ in range(50))

    threads = [threading.Thread(target=many) for _ in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert answers == ["success"] * 100


def test_saf_001_no_command_is_sent_to_a_killed_wire(arm: RealRobot, twin: Twin) -> None:
    json_of(arm.send_action({"shoulder_pan": far(arm)}))
    killed_ns = time.monotonic_ns()
    os.kill(pids(arm)["wire"], signal.SIGKILL)
    began_s = time.monotonic()
    until(
        lambda: arm.send_action({"shoulder_pan": 0.0})["status"] == "error",
        "commands are refused after the end of the wire",
    )
    assert time.monotonic() - began_s < 5.0
    until(lambda: twin.log.first_safe(killed_ns) is not None, "the robot is safe")
    assert twin.log.setpoints_after_safe(killed_ns) == 0
    resumed(arm)
    json_of(arm.send_action({"shoulder_pan": far(arm)}))
    with no_loop():
        json_of(arm.send_action({"shoulder_pan": far(arm)}))


def test_saf_002_a_command_to_a_frozen_wire_is_never_carried_out(arm: RealRobot, twin: Twin) -> None:
    """The command waits in the socket of a stopped process. The root kills that process before it can
    read it.
    """
    wire, target = pids(arm)["wire"], far(arm)
    frozen_ns = time.monotonic_ns()
    os.kill(wire, signal.SIGSTOP)
    refusal = why(arm.send_action({"shoulder_pan": target}))
    assert "move:" in refusal
    until(lambda: twin.log.first_safe(frozen_ns) is not None, "the robot is safe")
    assert not twin.log.host("setpoint", frozen_ns)
    until(lambda: not os.path.exists(f"/proc/{wire}"), "the wire was fenced")


def test_the_refusal_of_a_cleaned_up_robot_says_so(twin: Twin, new_arm: NewArm) -> None:
    arm = new_arm(port=twin.port)
    assert arm.connect_eagerly() is None
    arm.cleanup()
    assert "cleaned up" in why(arm.send_action({"shoulder_pan": 0.0}))
    assert arm.get_observation() == {}


def test_a_service_is_sent_without_the_loop_and_refused_through_it() -> None:
    with Robot("so101") as sim:
        with no_loop():
            first = json_of(sim.step(10))["sim_time_s"]
            assert json_of(sim.step(10))["sim_time_s"] >= first + 0.02
        assert "0" in why(sim.step(0))
        sim.stop()
        stepped = json_of(sim.step(5))  # with a new lease; the physics is stepped although the robot is limp
        assert stepped["sim_time_s"] > first
