"""A script's thread asks the gate itself, past the loop of its process, and it means what it means
by way of it."""

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
"""Less than the lease lives without heartbeats of the loop."""


@contextmanager
def no_loop() -> Iterator[None]:
    """The process's loop can do nothing."""
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


def test_a_loop_that_is_held_up_holds_up_no_command(arm: RealRobot, twin: Twin) -> None:
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
    until(lambda: bool(twin.log.host("setpoint", since_ns)), "it is on the wire")


def test_what_is_refused_is_refused_in_the_same_words(arm: RealRobot) -> None:
    with no_loop():
        unknown = why(arm.send_action({"elbow": 1.0}))
    assert "elbow" in unknown
    assert arm._tree is not None
    by_loop = portal().call(arm._tree.send_action, {"elbow": 1.0})
    assert by_loop.text in unknown


def test_after_a_stop_nothing_is_moved_and_after_resume_it_is(arm: RealRobot, twin: Twin) -> None:
    """The lease that the thread knows is stale both times: the loop takes it anew, or is told why
    not."""
    json_of(arm.send_action({"shoulder_pan": far(arm)}))
    arm.stop()
    stopped_ns = time.monotonic_ns()
    assert "resume()" in why(arm.send_action({"shoulder_pan": 0.0}))
    assert not twin.log.host("setpoint", stopped_ns)
    json_of(arm.resume())
    json_of(arm.send_action({"shoulder_pan": far(arm)}))
    with no_loop():
        json_of(arm.send_action({"shoulder_pan": far(arm)}))


def test_a_rollout_is_not_spoken_between(arm: RealRobot) -> None:
    here = arm.get_observation()
    json_of(arm.run_policy(lambda _: here, duration=20.0))
    assert "stop_task()" in why(arm.send_action({"shoulder_pan": 0.0}))
    json_of(arm.stop_task())
    json_of(arm.send_action({"shoulder_pan": far(arm)}))


def test_saf_006_a_stop_leaves_in_the_thread_that_calls_whatever_the_loop_does(arm: RealRobot, twin: Twin) -> None:
    json_of(arm.send_action({"shoulder_pan": far(arm)}))
    with no_loop():
        began_ns = time.monotonic_ns()
        stopping = threading.Thread(target=arm.stop)
        stopping.start()
        until(lambda: twin.log.first_safe(began_ns) is not None, "it is safe")
        assert time.monotonic_ns() - began_ns < HELD_UP_S * 1e9 / 2
    stopping.join()
    assert twin.log.setpoints_after_safe(began_ns) == 0


def test_a_thread_that_waits_is_woken_when_the_robot_is_cleaned_up(arm: RealRobot) -> None:
    """Its question has reached a wire that does not answer any more."""
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
    """Return what a forked child answers."""
    reading, writing = os.pipe()
    child = os.fork()
    if child == 0:
        try:
            os.write(writing, json.dumps(ask()).encode())
        finally:
            os._exit(0)
    os.close(writing)
    os.waitpid(child, 0)
    with open(reading, "rb") as told:
        return json.loads(told.read())


def test_saf_023_a_forked_child_takes_nothing_for_success(arm: RealRobot) -> None:
    """Its handle is that of a robot of another process: it says so, who can, and which motors."""
    verbs = ("cleanup", "release", "stop_task", "get_task_status", "resume")

    def ask() -> dict[str, Any]:
        said = {verb: getattr(arm, verb)() for verb in verbs}
        said["send_action"] = arm.send_action({"shoulder_pan": 0.0})
        return {**said, "seen": arm.get_observation(), "status": arm.get_status(), "tree": arm.tree()}

    said = in_child(ask)
    for verb in (*verbs, "send_action"):
        assert said[verb]["status"] == "error", verb
        text = said[verb]["content"][0]["text"]
        assert f"process {os.getpid()}, from which this one was forked, has the robot" in text
        assert f"`strands-actors stop {arm.name}`" in text
    assert said["cleanup"]["content"][1]["json"]["unconfirmed"] == list(arm.driver.axes)
    assert said["seen"] == {}
    assert said["status"]["content"][0]["json"]["state"] == said["tree"]["state"] == "unreachable"
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
    """Neither is refused for the other's sake."""
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


def test_saf_001_a_wire_that_is_killed_is_no_longer_spoken_to(arm: RealRobot, twin: Twin) -> None:
    json_of(arm.send_action({"shoulder_pan": far(arm)}))
    killed_ns = time.monotonic_ns()
    os.kill(pids(arm)["wire"], signal.SIGKILL)
    began_s = time.monotonic()
    until(lambda: arm.send_action({"shoulder_pan": 0.0})["status"] == "error", "the end is known")
    assert time.monotonic() - began_s < 5.0
    until(lambda: twin.log.first_safe(killed_ns) is not None, "it is safe")
    assert twin.log.setpoints_after_safe(killed_ns) == 0
    resumed(arm)
    json_of(arm.send_action({"shoulder_pan": far(arm)}))
    with no_loop():
        json_of(arm.send_action({"shoulder_pan": far(arm)}))


def test_saf_002_a_command_to_a_frozen_wire_is_not_done_late(arm: RealRobot, twin: Twin) -> None:
    """It waits in the socket of a process that stands still; that process never reads it."""
    wire, target = pids(arm)["wire"], far(arm)
    frozen_ns = time.monotonic_ns()
    os.kill(wire, signal.SIGSTOP)
    refusal = why(arm.send_action({"shoulder_pan": target}))
    assert "move:" in refusal
    until(lambda: twin.log.first_safe(frozen_ns) is not None, "it is safe")
    assert not twin.log.host("setpoint", frozen_ns)
    until(lambda: not os.path.exists(f"/proc/{wire}"), "it was fenced")


def test_a_robot_that_was_cleaned_up_says_so(twin: Twin, new_arm: NewArm) -> None:
    arm = new_arm(port=twin.port)
    assert arm.connect_eagerly() is None
    arm.cleanup()
    assert "cleaned up" in why(arm.send_action({"shoulder_pan": 0.0}))
    assert arm.get_observation() == {}


def test_a_service_goes_past_the_loop_and_is_refused_by_it_when_it_must_be() -> None:
    with Robot("so101") as sim:
        with no_loop():
            first = json_of(sim.step(10))["sim_time_s"]
            assert json_of(sim.step(10))["sim_time_s"] >= first + 0.02
        assert "0" in why(sim.step(0))
        sim.stop()
        stepped = json_of(sim.step(5))  # with a lease taken anew: physics passes, whoever is limp
        assert stepped["sim_time_s"] > first
