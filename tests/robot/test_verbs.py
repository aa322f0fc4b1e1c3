"""The public verbs connect, observe, move, stop, resume and clean up. The wire log decides."""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import logging
import math
import os
import signal
import threading
import time
from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest
import trio

from strands_actors import open_robot
from strands_actors.caller.handle.robot import RealRobot
from strands_actors.drivers.feetech import protocol as p
from strands_actors.testing import Twin
from tests.answers import json_of, pids, state, status, task, until, why
from tests.trees import begin_moving

from .conftest import NewArm
from .helpers import (
    COUNTS_PER_DEGREE,
    IDS,
    armed_at,
    at,
    goals,
    limps,
    moves,
    register_now,
    torque_now,
)

COMMANDED_10 = {
    "status": "success",
    "content": [
        {"json": {"commanded": {"shoulder_pan": 10.0}, "unit": "degrees (gripper: percent open)"}},
    ],
}


# -- connect, observe, move


def test_connecting_energises_every_servo_at_its_position(arm: RealRobot, twin: Twin) -> None:
    assert state(arm) == "armed"
    assert arm.is_connected
    assert torque_now(twin.log) == dict.fromkeys(IDS.values(), 1)
    assert sorted(armed_at(twin.log)) == sorted(IDS.values())
    assert not twin.log.host("setpoint")


def test_an_observation_has_every_joint(arm: RealRobot) -> None:
    observation = arm.get_observation()
    assert list(observation) == list(IDS)
    assert all(math.isfinite(value) for value in observation.values())


@pytest.mark.parametrize("key", ["shoulder_pan", "shoulder_pan.pos"])
def test_an_action_is_written_and_answered_as_on_the_drivers_page(arm: RealRobot, twin: Twin, key: str) -> None:
    assert arm.send_action({key: 10.0}) == COMMANDED_10
    setpoint = until(lambda: twin.log.host("setpoint"), "a setpoint on the wire")[0]
    targets = goals(setpoint)
    assert targets.pop(1) == round(2047.5 + 10 * COUNTS_PER_DEGREE)
    resting = armed_at(twin.log)
    assert targets == {servo: resting[servo] for servo in targets}  # the other servos keep their positions
    at(arm, "shoulder_pan", 10.0)


def test_numpy_numbers_are_accepted(arm: RealRobot, twin: Twin) -> None:
    for value in (np.float32(10), np.float64(10), np.int64(10), np.array(10.0), 10):
        assert arm.send_action({"shoulder_pan": value}) == COMMANDED_10


REFUSALS: list[tuple[Any, str]] = [
    ({"elbow": 1.0}, "elbow is not a joint of so101. Use shoulder_pan, shoulder_lift, elbow_flex"),
    ({"shoulder_pan": 1.0, "shoulder_pan.pos": 1.0}, "both given. Send one of them"),
    ({"shoulder_pan": math.nan}, "shoulder_pan is nan. Send a finite number"),
    ({"shoulder_pan": math.inf}, "shoulder_pan is inf"),
    ({"shoulder_pan": -math.inf}, "shoulder_pan is -inf"),
    ({"shoulder_pan": 10**400}, "shoulder_pan is"),
    ({"shoulder_pan": True}, "shoulder_pan is True"),
    ({"shoulder_pan": np.bool_(True)}, "shoulder_pan is True"),
    ({"shoulder_pan": np.float32("nan")}, "shoulder_pan is nan"),
    ({"shoulder_pan": np.array([1.0, 2.0])}, "shoulder_pan is array"),
    ({"shoulder_pan": "10"}, "shoulder_pan is '10', a text. Send a finite number"),
    ({"shoulder_pan": None}, "shoulder_pan is None"),
    ({"shoulder_pan": {"value": 1.0}}, "shoulder_pan is"),
    ({"shoulder_pan": 181.0}, "past 110.1. Stay within -110.0..110.1"),
    ({"shoulder_pan": 10.0, "gripper": 101.0}, "gripper 101.0 % is past 100.0. Stay within 0.0..100.0"),
    ({"gripper": -1.0}, "gripper -1.0 % is past 0.0"),
    ({}, "names no joint. Use shoulder_pan"),
    ({1: 10.0}, "1 is not a joint"),
    ({"x" * 70_000: 1.0}, "is not a joint"),
    ({"shoulder_pan": "x" * 70_000}, "shoulder_pan is xxx"),
    (None, "a mapping of joints to numbers"),
    ([10.0, 20.0], "a mapping of joints to numbers"),
]


def test_a_refused_action_never_reaches_the_wire(arm: RealRobot, twin: Twin) -> None:
    for action, text in REFUSALS:
        refusal = why(arm.send_action(action))
        assert refusal.startswith("move: "), refusal
        assert text in refusal, refusal
    assert arm.send_action({"gripper": 50.0})["status"] == "success"
    written = until(lambda: twin.log.host("setpoint"), "the valid action is on the wire")
    pan = {goals(entry)[1] for entry in written}
    assert pan == {armed_at(twin.log)[1]}  # later actions contain no value of a refused one
    assert status(arm)["refusals"] > 0


@pytest.mark.parametrize("name", ["so101", "SO-101", "so101_follower"])
def test_an_action_for_this_robot_by_name_is_written(arm: RealRobot, twin: Twin, name: str) -> None:
    json_of(arm.send_action({"shoulder_pan": 5.0}, robot_name=name))
    until(lambda: twin.log.host("setpoint"), "the action is written")


@pytest.mark.parametrize("name", ["left", "ur5e", "", 7, "x" * 1000])
def test_saf_014_an_action_for_another_robot_is_refused(arm: RealRobot, twin: Twin, name: Any) -> None:
    answer = arm.send_action({"shoulder_pan": 5.0}, robot_name=name)
    assert why(answer).startswith(
        f"move: robot_name is {str(name)[:40]!r}, and this robot is so101 (so101). Send it"
    )
    assert answer["content"][1]["json"]["refused"]["code"] == "other_robot"
    assert not twin.log.host("setpoint")


def test_saf_014_a_robot_with_its_own_name_cannot_be_addressed_by_its_type(new_arm: NewArm) -> None:
    left = new_arm(port="/dev/nowhere", tool_name="left")
    assert "this robot is left (so101)" in why(left.send_action({"gripper": 5.0}, robot_name="so101"))
    assert "not connected" in why(left.send_action({"gripper": 5.0}, robot_name="left"))


def test_a_refusal_gives_the_offered_value_and_the_limit(arm: RealRobot) -> None:
    details = arm.send_action({"gripper": 101.0})["content"][1]["json"]["refused"]
    assert details == {
        "verb": "move",
        "code": "past_travel",
        "reason": "gripper 101.0 % is past 100.0",
        "remedy": "stay within 0.0..100.0",
        "offered": "101.0",
        "limit": "0.0..100.0",
    }


# -- without a connection


def test_before_connecting_every_verb_is_refused_with_the_reason(
    new_arm: NewArm, caplog: pytest.LogCaptureFixture
) -> None:
    arm = new_arm(port="/dev/nowhere")
    not_connected = "not connected. Call connect_eagerly() first"
    verbs = (
        arm.stop,
        arm.resume,
        arm.state,
        arm.stop_task,
        lambda: arm.run_policy(lambda observation: observation),
        lambda: arm.start_task(policy_provider="mock"),
    )
    for verb in verbs:
        assert not_connected in why(verb())
    with caplog.at_level(logging.WARNING, "strands_actors"):
        for _ in range(3):
            assert arm.get_observation() == {}
    assert [record.getMessage() for record in caplog.records] == [f"observe: {not_connected}"]  # only once
    idle = task(arm)
    assert (idle["running"], idle["steps"]) == (False, 0)
    reported = status(arm)
    assert (reported["connected"], reported["connect_error"]) == (False, not_connected)
    assert not arm.is_connected
    assert arm.tree() is None


# -- stop and resume


def test_stop_releases_every_motor_and_lists_it(arm: RealRobot, twin: Twin) -> None:
    arm.send_action({"shoulder_pan": 10.0})
    began_ns = time.monotonic_ns()
    report = json_of(arm.stop())
    twin.log.safe_within(began_ns, 0.3)
    assert limps(twin.log, began_ns)
    assert torque_now(twin.log, began_ns) == dict.fromkeys(IDS.values(), 0)
    assert {name: motor["id"] for name, motor in report["motors"].items()} == IDS
    assert all(motor["safe"] and motor["written"] for motor in report["motors"].values())
    assert (report["stopped"], report["safe_state"], report["unconfirmed"]) == (True, "limp", [])

    assert "Call resume() first" in why(arm.send_action({"shoulder_pan": 0.0}))
    assert "resume() first" in why(arm.run_policy(lambda observation: observation))
    assert state(arm) == "disarmed"
    time.sleep(0.2)  # a few keepalive periods
    assert twin.log.setpoints_after_safe(began_ns) == 0

    assert json_of(arm.resume())["armed"] is True
    assert arm.send_action({"shoulder_pan": 0.0})["status"] == "success"
    at(arm, "shoulder_pan", 0.0)


def test_stop_and_resume_can_be_repeated(arm: RealRobot) -> None:
    for _ in range(3):
        json_of(arm.stop())
        json_of(arm.stop())
        json_of(arm.resume())
        json_of(arm.resume())
    assert state(arm) == "armed"


def test_resume_starts_at_the_position_to_which_the_arm_has_fallen(arm: RealRobot, twin: Twin) -> None:
    arm.send_action({"shoulder_lift": 20.0, "elbow_flex": -30.0})
    at(arm, "shoulder_lift", 20.0, within=4.0)
    raised = arm.get_observation()
    json_of(arm.stop())
    until(lambda: abs(arm.get_observation()["shoulder_lift"] - raised["shoulder_lift"]) > 10.0, "the arm falls")

    resumed_ns = time.monotonic_ns()
    json_of(arm.resume())
    resting = armed_at(twin.log, resumed_ns)
    time.sleep(0.3)  # longer than any lifetime, so no setpoint starts by itself
    assert not twin.log.host("setpoint", resumed_ns)

    arm.send_action({"gripper": 40.0})
    first = until(lambda: twin.log.host("setpoint", resumed_ns), "the first setpoint")[0]
    kept = {servo: goal for servo, goal in goals(first).items() if servo != IDS["gripper"]}
    assert kept == {servo: resting[servo] for servo in kept}


def test_a_command_from_before_a_stop_is_not_continued_after_resume(arm: RealRobot, twin: Twin) -> None:
    moves(arm)
    target = goals(twin.log.host("setpoint")[-1])[1]
    json_of(arm.stop())
    json_of(arm.resume())
    resumed_ns = time.monotonic_ns()
    arm.send_action({"gripper": 40.0})
    first = until(lambda: twin.log.host("setpoint", resumed_ns), "a setpoint")[0]
    assert abs(goals(first)[1] - target) > 10 * COUNTS_PER_DEGREE


def test_resume_reports_soon_that_the_wire_has_ended_while_arming(twin: Twin, new_arm: NewArm) -> None:
    arm = new_arm(port=twin.port)
    assert arm.connect_eagerly() is None
    json_of(arm.stop())
    wire = pids(arm)["wire"]
    twin.fault("delayed:6")  # so that arming takes long
    until(lambda: "gripper" in status(arm)["faults"], "the faults include the gripper")
    answers: list[Any] = []
    resuming = threading.Thread(target=lambda: answers.append(arm.resume()))
    resuming.start()
    until(lambda: state(arm) == "arming", "the robot is arming")
    killed_s = time.monotonic()
    os.kill(wire, signal.SIGKILL)
    resuming.join()
    assert time.monotonic() - killed_s < 5.0
    assert "ended while it armed the robot" in why(answers[0])
    twin.fault("ok")
    # Unconfirmed if the next wire made the robot safe while servo 6 still answered late.
    until(lambda: state(arm) in ("disarmed", "unconfirmed"), "the next wire runs")
    json_of(arm.resume())


@pytest.mark.parametrize("named", [False, True])
def test_after_a_resume_the_caller_commands_the_robot(arm: RealRobot, named: bool) -> None:
    """The earlier rollout has lost its lease with the wire, even if it does not know that yet."""

    def begin() -> Mapping[str, Any]:
        if named:
            return arm.start_task("wave", policy_provider="sine", duration=60.0)
        return arm.run_policy(lambda seen: {"shoulder_pan": seen["shoulder_pan"]}, duration=60.0)

    begin_moving(arm, begin, lambda progress, _: progress["steps"] > 0)
    processes = pids(arm)
    if named:
        os.kill(processes["policy"], signal.SIGSTOP)  # so that it does not learn of the end
    os.kill(processes["wire"], signal.SIGKILL)
    until(lambda: state(arm) == "disarmed", "the next wire runs")
    json_of(arm.resume())
    json_of(arm.send_action({"gripper": 40.0}))
    assert not task(arm)["running"]


def test_a_stop_while_it_connects_wins(twin: Twin, new_arm: NewArm) -> None:
    twin.pause()
    arm = new_arm(port=twin.port)
    outcomes: list[str | None] = []
    connecting = threading.Thread(target=lambda: outcomes.append(arm.connect_eagerly()))
    connecting.start()
    until(lambda: arm.tree() is not None, "the processes have started")
    arm.stop()
    twin.go_on()
    connecting.join()
    assert outcomes[0] is not None
    assert state(arm) != "armed"
    assert not twin.log.host("enable")
    assert arm.connect_eagerly() is None


# -- asyncio


def test_inside_asyncio_stop_and_status_do_not_block_the_loop(arm: RealRobot, twin: Twin) -> None:
    twin.fault("off:3")  # so that the stop takes long
    until(lambda: "elbow_flex" in status(arm)["faults"], "the fault of servo 3 is reported")

    async def main() -> tuple[Any, Any, list[float]]:
        turns: list[float] = []

        async def turn() -> None:
            while True:
                turns.append(time.monotonic())
                await asyncio.sleep(0.005)

        turning = asyncio.create_task(turn())
        await asyncio.sleep(0.01)
        reported = await arm.get_status()
        stopping = arm.stop()
        stopped = await stopping
        turning.cancel()
        return reported, stopped, turns

    reported, stopped, turns = asyncio.run(main())
    assert json_of(reported)["state"] == "armed"
    took_s = stopped["content"][1]["json"]["took_ms"] / 1e3
    assert took_s > 0.15
    gaps = [later - earlier for earlier, later in itertools.pairwise(turns)]
    assert turns[-1] - turns[0] >= 0.8 * took_s
    assert max(gaps) < 0.5 * took_s, gaps


def test_a_stop_inside_asyncio_starts_before_it_is_awaited(arm: RealRobot, twin: Twin) -> None:
    async def main() -> Any:
        began_ns = time.monotonic_ns()
        stopping = arm.stop()
        while not limps(twin.log, began_ns):  # noqa: ASYNC110  # the wire log has no event
            await asyncio.sleep(0.005)
        return await stopping

    assert json_of(asyncio.run(main()))["stopped"] is True


def test_outside_a_loop_a_verb_returns_its_answer(arm: RealRobot) -> None:
    assert arm.stop()["status"] == "success"
    assert arm.get_status()["status"] == "success"


# -- several threads


def test_verbs_may_be_called_from_several_threads_at_once(arm: RealRobot) -> None:
    problems: list[Any] = []
    barrier = threading.Barrier(6)

    def work(joint: str) -> None:
        barrier.wait()
        for step in range(40):
            answers = (arm.send_action({joint: 20.0 + step / 10}), arm.get_status(), arm.get_task_status())
            problems.extend(answer for answer in answers if answer["status"] != "success")
            if list(arm.get_observation()) != list(IDS):
                problems.append("no observation")

    threads = [threading.Thread(target=work, args=(joint,)) for joint in IDS]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert problems == []
    assert state(arm) == "armed"


def test_threads_that_command_a_held_robot_at_the_same_time_all_succeed(arm: RealRobot) -> None:
    """After a hold each command acquires a new lease. The threads must not take it from each other."""
    problems: list[Any] = []
    for _ in range(10):
        json_of(arm.run_policy(lambda observation: {"gripper": observation["gripper"]}, n_steps=1))
        until(lambda: not task(arm)["running"], "the rollout ends")
        barrier = threading.Barrier(4)

        def command(joint: str, barrier: threading.Barrier = barrier) -> None:
            barrier.wait()
            answer = arm.send_action({joint: 20.0})
            if answer["status"] != "success":
                problems.append(answer)

        threads = [threading.Thread(target=command, args=(joint,)) for joint in list(IDS)[:4]]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    assert problems == []


# -- the end


def test_cleanup_releases_every_motor_and_ends_every_process(arm: RealRobot, twin: Twin) -> None:
    arm.send_action({"shoulder_pan": 10.0})
    tree = arm.tree()
    assert tree is not None
    pids = [process["pid"] for process in tree["processes"] if process["role"] != "caller"]
    assert len(pids) == 4, "root, wire, standby, spawner"
    began_ns = time.monotonic_ns()
    assert json_of(arm.cleanup())["stopped"] is True
    assert limps(twin.log, began_ns)
    assert torque_now(twin.log, began_ns) == dict.fromkeys(IDS.values(), 0)
    assert twin.log.setpoints_after_safe(began_ns) == 0
    for pid in pids:
        until(lambda pid=pid: not _runs(pid), f"process {pid} ends")  # type: ignore[misc]

    assert json_of(arm.cleanup())["stopped"] is True
    for verb in (
        lambda: arm.send_action({"shoulder_pan": 0.0}),
        arm.stop,
        arm.resume,
        arm.stop_task,
        lambda: arm.run_policy(lambda observation: observation),
        lambda: arm.start_task(policy_provider="mock"),
    ):
        assert "cleaned up. Make a new one" in why(verb())
    assert "cleaned up. Make a new one" in (arm.connect_eagerly() or "")
    assert arm.get_observation() == {}
    assert status(arm)["connected"] is False


def _runs(pid: int) -> bool:
    with contextlib.suppress(ProcessLookupError):
        os.kill(pid, 0)
        return True
    return False


def test_the_port_is_free_again_after_cleanup(arm: RealRobot, twin: Twin, new_arm: NewArm) -> None:
    arm.cleanup()
    again = new_arm(port=twin.port)
    assert again.connect_eagerly() is None
    assert again.send_action({"shoulder_pan": 10.0}) == COMMANDED_10


def test_a_with_block_connects_and_cleans_up(twin: Twin, new_arm: NewArm) -> None:
    with new_arm(port=twin.port) as arm:
        assert arm.send_action({"shoulder_pan": 10.0}) == COMMANDED_10
        left_ns = time.monotonic_ns()
    assert limps(twin.log, left_ns)
    assert status(arm)["connected"] is False


def test_a_with_block_without_a_robot_is_not_entered(new_arm: NewArm, tmp_path: Any) -> None:
    nothing = str(tmp_path / "nothing")
    with pytest.raises(ConnectionError, match=nothing), new_arm(port=nothing):
        pytest.fail("the block is entered")


# -- trio


def test_open_robot_in_a_trio_program(twin: Twin) -> None:
    async def main() -> tuple[list[dict[str, float]], float]:
        seen = []
        async with open_robot("so101", mode="real", port=twin.port) as arm:
            assert "this robot is so101" in why(await arm.send_action({"shoulder_pan": 50.0}, "right"))
            await arm.send_action({"shoulder_pan": 10.0})
            began_s = trio.current_time()
            async for observation in arm.observations(20):
                seen.append(observation)
                if len(seen) == 20:
                    break
            took_s = trio.current_time() - began_s
        return seen, took_s

    seen, took_s = trio.run(main)
    assert all(list(observation) == list(IDS) for observation in seen)
    assert seen[-1]["shoulder_pan"] == pytest.approx(10.0, abs=2.0)
    assert 0.9 <= took_s < 3.0
    assert limps(twin.log)
    assert register_now(twin.log, p.TORQUE_ENABLE) == dict.fromkeys(IDS.values(), 0)


def test_open_robot_raises_the_reason_if_it_cannot_connect(tmp_path: Any) -> None:
    async def main() -> None:
        async with open_robot("so101", mode="real", port=str(tmp_path / "nothing")):
            pytest.fail("the block is entered")

    with pytest.raises(ConnectionError, match="nothing"):
        trio.run(main)
