"""Policies in this process (``run_policy``) and in their own process (``start_task``)."""

from __future__ import annotations

import gc
import math
import threading
import time
import weakref
from collections.abc import Callable, Iterator, Mapping
from typing import Any

import pytest
import trio

from strands_actors.caller.handle.robot import RealRobot
from strands_actors.kernel.messages import Message
from strands_actors.kernel.node import AskTimeout
from strands_actors.kernel.ref import Ref
from strands_actors.supervisors.gate.messages import GetStatus
from strands_actors.testing import Twin
from tests.answers import json_of, pids, state, status, task, task_ended, until, why
from tests.trees import begin_moving, run_to_end

from .helpers import COUNTS_PER_DEGREE, IDS, at, goals, holds, limps

Observed = Mapping[str, float]
Action = dict[str, float]

TASK_KEYS = {"running", "steps", "elapsed_s", "exit_reason", "exit_detail", "refusal", "instruction", "hz"}

GENEROUS_S = 0.3
"""Longest time from the call of stop() to the safe frame, for any policy."""


def ahead(observation: Observed) -> Action:
    return {"shoulder_pan": observation["shoulder_pan"] + 1.0}


class Stepper:
    def step(self, observation: Observed) -> Action:
        return ahead(observation)


class Synchronous:
    def get_actions_sync(self, observation: Observed, instruction: str) -> list[Action]:
        assert instruction == "forward"
        return [ahead(observation)]


class Asynchronous:
    async def get_actions(self, observation: Observed, instruction: str) -> list[Action]:
        assert instruction == "forward"
        return [ahead(observation)]


@pytest.fixture
def blocked() -> Iterator[threading.Event]:
    """Release a blocked policy at the end of the test."""
    event = threading.Event()
    yield event
    event.set()


# # -- which objects are policies, and how long they run


def test_every_form_of_policy_runs(arm: RealRobot, twin: Twin) -> None:
    for policy in (ahead, Stepper(), Synchronous(), Asynchronous()):
        for _ in range(3):  # on a machine that pauses, a rollout may end in a hold
            began_ns = time.monotonic_ns()
            begun = json_of(arm.run_policy(policy, "forward", n_steps=5))
            assert begun.keys() == TASK_KEYS
            ended = task_ended(arm)
            assert ended.keys() == TASK_KEYS
            if ended["exit_reason"] != "stop":
                break
        assert (ended["steps"], ended["exit_reason"], ended["instruction"]) == (5, "n_steps", "forward"), ended
        assert len({entry.data for entry in twin.log.host("setpoint", began_ns)}) >= 1
        assert until(lambda ns=began_ns: holds(twin.log, ns), "the robot is held afterwards")  # type: ignore[misc]
    assert state(arm) == "holding"
    assert arm.send_action({"shoulder_pan": 0.0})["status"] == "success"


def test_objects_from_before_are_not_searched_for_garbage_while_a_policy_moves(arm: RealRobot) -> None:
    """A garbage collection of the whole heap would stop the caller's setpoints for as long as it takes."""

    class Ring:
        """Garbage that only the collector can find."""

        def __init__(self) -> None:
            self.itself = self

    old = weakref.ref(Ring())
    observed: list[Observed] = []
    kept: list[bool] = []

    def policy(observation: Observed) -> list[Action]:
        if observed:  # a command was sent before: the robot moves
            gc.collect()
            kept.append(old() is not None)
        observed.append(observation)
        return [ahead(observation)] * 4

    gc.disable()  # until the policy calls the collector
    try:
        json_of(arm.run_policy(policy, n_steps=5))
        ended = task_ended(arm)
    finally:
        gc.enable()
    assert ended["exit_reason"] == "n_steps", ended
    assert kept and all(kept)

    def searched() -> bool:
        gc.collect()
        return old() is None

    assert until(searched, "the whole heap is searched again")


def test_a_slow_status_does_not_mean_that_the_robot_is_not_connected(
    arm: RealRobot, monkeypatch: pytest.MonkeyPatch
) -> None:
    ask = Ref.ask
    takes_s = [0.25]

    async def slow(self: Ref, message: Message, deadline_s: float) -> Message | None:
        if isinstance(message, GetStatus):
            if takes_s[0] > deadline_s:
                await trio.sleep(deadline_s)
                raise AskTimeout(f"{self.address}: no answer")
            await trio.sleep(takes_s[0])
        return await ask(self, message, deadline_s)

    monkeypatch.setattr(Ref, "ask", slow)
    json_of(arm.run_policy(ahead, n_steps=2))
    assert task_ended(arm)["exit_reason"] == "n_steps"
    takes_s[0] = 5.0
    answer = arm.run_policy(ahead, n_steps=2)
    expected = "the process that talks to the robot has not answered for 500 ms. Try again: the host may be busy"
    assert why(answer) == f"run_policy: {expected}"
    assert answer["content"][1]["json"]["refused"]["code"] == "no_answer"


def test_the_policy_keyword_of_the_reference_works_too(arm: RealRobot) -> None:
    json_of(arm.run_policy(policy_object=ahead, n_steps=2))
    assert task_ended(arm)["steps"] == 2


def test_a_chunk_is_executed_action_by_action_at_the_control_rate(arm: RealRobot, twin: Twin) -> None:
    called_s: list[float] = []

    class Chunks:
        """Return eight actions a call, each half a degree further than the last."""

        def get_actions_sync(self, observation: Observed, instruction: str) -> list[Action]:
            first = len(called_s) * 8
            called_s.append(time.monotonic())
            return [{"shoulder_pan": (first + number) * 0.5} for number in range(8)]

    json_of(arm.send_action({"shoulder_pan": 0.0}))
    at(arm, "shoulder_pan", 0.0)
    began_ns = time.monotonic_ns()
    json_of(arm.run_policy(Chunks(), n_steps=24, control_frequency=50))
    ended = task_ended(arm)
    assert (ended["steps"], ended["exit_reason"]) == (24, "n_steps"), ended
    # with only the first action of each chunk it would take 8 times as long
    assert ended["elapsed_s"] < 24 * 8 / 50 / 2
    assert 3 <= len(called_s) <= 5
    written = [goals(entry)[1] for entry in twin.log.host("setpoint", began_ns)]
    steps = [goal for index, goal in enumerate(written) if index == 0 or goal != written[index - 1]]
    # The hold that ends a rollout overtakes setpoints that are not sent yet. So the last one may be
    # missing.
    assert len(steps) >= 23
    assert steps == [round(2047.5 + number * 0.5 * COUNTS_PER_DEGREE) for number in range(len(steps))]


def test_a_duration_ends_a_rollout_and_n_steps_wins_over_it(arm: RealRobot) -> None:
    ended = run_to_end(arm, lambda: arm.run_policy(ahead, duration=0.5))
    assert 0.45 <= ended["elapsed_s"] < 2.0
    ended = run_to_end(arm, lambda: arm.run_policy(ahead, duration=0.05, n_steps=20), "n_steps")
    assert ended["steps"] == 20, ended


def test_a_refused_action_ends_the_rollout_with_the_reason(arm: RealRobot, twin: Twin) -> None:
    began_ns = time.monotonic_ns()
    json_of(arm.run_policy(lambda observation: {"shoulder_pan": 105.0}, n_steps=5))
    ended = task_ended(arm)
    assert (ended["exit_reason"], ended["refusal"], ended["steps"]) == ("gate", "too_fast", 0), ended
    assert "steps 105.0 deg" in ended["exit_detail"] or "Step at most" in ended["exit_detail"]
    assert not twin.log.host("setpoint", began_ns)


def test_a_policy_that_raises_ends_the_rollout_with_the_text_of_its_exception(arm: RealRobot, twin: Twin) -> None:
    def broken(observation: Observed) -> Action:
        raise LookupError("no weights here")

    json_of(arm.run_policy(broken))
    ended = task_ended(arm)
    assert ended["exit_reason"] == "policy"
    assert ended["exit_detail"].startswith("LookupError: no weights here (test_rollouts.py:")
    json_of(arm.run_policy(lambda observation: 3))
    assert "the policy returned int" in task_ended(arm)["exit_detail"]
    assert state(arm) in ("armed", "holding")


# -- refusals

BAD = [0, -1.0, math.nan, math.inf, True, "3", None]


def test_bad_arguments_start_nothing(arm: RealRobot, twin: Twin) -> None:
    for duration in BAD:
        assert f"run_policy: duration is {duration!r}" in why(arm.run_policy(ahead, duration=duration))
        assert f"start_task: duration is {duration!r}" in why(arm.start_task("x", duration=duration))
    for n_steps in (0, -1, 1.5, True, "3"):
        assert f"n_steps is {n_steps!r}" in why(arm.run_policy(ahead, n_steps=n_steps))  # type: ignore[arg-type]
    for hz in (0, -1.0, math.nan, 1001, True, "3"):
        assert "control_frequency is" in why(arm.run_policy(ahead, control_frequency=hz))  # type: ignore[arg-type]
        assert "control_frequency is" in why(arm.start_task("x", control_frequency=hz))  # type: ignore[arg-type]
    assert "policy is None" in why(arm.run_policy())
    assert "object is no policy" in why(arm.run_policy(object()))
    assert "Use one of groot, lerobot_local, mock, onnx, remote, sine" in why(
        arm.start_task("x", policy_provider="smooth_talk")
    )
    idle = task(arm)
    assert (idle["running"], idle["steps"]) == (False, 0)
    assert not twin.log.host("setpoint")


def test_one_rollout_at_a_time(arm: RealRobot) -> None:
    json_of(arm.run_policy(ahead))
    assert "already running" in why(arm.run_policy(ahead))
    assert "already running" in why(arm.start_task("x", policy_provider="mock"))
    assert "a task is running. Call stop_task() first" in why(arm.send_action({"gripper": 50.0}))
    assert json_of(arm.stop_task())["exit_reason"] == "stopped"
    assert arm.send_action({"gripper": 50.0})["status"] == "success"


def test_when_four_threads_start_a_rollout_at_once_one_of_them_succeeds(arm: RealRobot) -> None:
    barrier = threading.Barrier(4)
    outcomes: list[str] = []

    def begin() -> None:
        barrier.wait()
        outcomes.append(arm.run_policy(ahead)["status"])

    threads = [threading.Thread(target=begin) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert sorted(outcomes) == ["error", "error", "error", "success"]
    json_of(arm.stop_task())


# -- ending a rollout


def test_stop_task_holds_the_robot_and_allows_commands_again(arm: RealRobot, twin: Twin) -> None:
    begin_moving(arm, lambda: arm.run_policy(ahead, "forward"), lambda progress, _: progress["steps"] > 5)
    began_ns = time.monotonic_ns()
    ended = json_of(arm.stop_task())
    assert (ended["running"], ended["exit_reason"]) == (False, "stopped")
    assert holds(twin.log, began_ns)
    time.sleep(0.2)
    assert twin.log.setpoints_after_safe(began_ns) == 0
    assert state(arm) == "holding"
    assert json_of(arm.stop_task()) == ended  # no task runs, so the answer is the result of the last one


def block(until_released: threading.Event) -> Callable[[Observed], Action]:
    """Move for ten steps, then sleep."""
    calls = [0]

    def policy(observation: Observed) -> Action:
        calls[0] += 1
        if calls[0] > 10:
            until_released.wait(5.0)
        return ahead(observation)

    return policy


def block_at_once(until_released: threading.Event) -> Callable[[Observed], Action]:
    def policy(observation: Observed) -> Action:
        until_released.wait(5.0)
        return ahead(observation)

    return policy


def spin(until_released: threading.Event) -> Callable[[Observed], Action]:
    """Move for ten steps, then keep a processor and the interpreter's lock busy."""
    calls = [0]

    def policy(observation: Observed) -> Action:
        calls[0] += 1
        while calls[0] > 10 and not until_released.is_set():
            pass
        return ahead(observation)

    return policy


Faulty = Callable[[threading.Event], Callable[[Observed], Action]]


def begin(arm: RealRobot, policy: Faulty, blocked: threading.Event) -> None:
    json_of(arm.run_policy(policy(blocked), control_frequency=50))
    if policy is not block_at_once:
        until(lambda: status(arm)["writes"] >= 5, "the robot moves")


@pytest.mark.parametrize("policy", [block, block_at_once, spin])
def test_stop_task_does_not_wait_for_the_policy(
    arm: RealRobot, twin: Twin, blocked: threading.Event, policy: Faulty
) -> None:
    began_ns = time.monotonic_ns()
    begin(arm, policy, blocked)
    called_s = time.monotonic()
    ended = json_of(arm.stop_task())
    assert time.monotonic() - called_s < 0.5
    assert ended["running"] is False
    assert ended["exit_reason"] in ("stopped", "policy")
    time.sleep(0.2)
    if policy is not block_at_once:
        assert holds(twin.log, began_ns)
        assert twin.log.setpoints_after_safe(began_ns) == 0
    assert not limps(twin.log)
    blocked.set()
    time.sleep(0.2)
    # an action that the policy returns now is too late
    assert not twin.log.host("setpoint", round(called_s * 1e9) + 500_000_000)
    assert json_of(arm.run_policy(ahead, n_steps=3))["running"]
    assert task_ended(arm)["exit_reason"] == "n_steps"


@pytest.mark.parametrize("policy", [block, block_at_once, spin])
def test_stop_does_not_wait_for_the_policy(
    arm: RealRobot, twin: Twin, blocked: threading.Event, policy: Faulty
) -> None:
    begin(arm, policy, blocked)
    stopped_ns = time.monotonic_ns()
    report = json_of(arm.stop())
    assert until(lambda: limps(twin.log, stopped_ns), "limp")[0].t_ns - stopped_ns < GENEROUS_S * 1e9
    assert (report["safe_state"], report["unconfirmed"]) == ("limp", [])
    blocked.set()
    time.sleep(0.3)
    assert twin.log.setpoints_after_safe(stopped_ns) == 0
    ended = task(arm)
    assert (ended["running"], ended["exit_reason"]) in ((False, "stop"), (False, "policy")), ended


def test_a_policy_that_sends_no_action_leads_to_a_hold_and_the_rollout_gives_the_reason(
    arm: RealRobot, twin: Twin, blocked: threading.Event
) -> None:
    json_of(arm.run_policy(block(blocked), control_frequency=50))
    ended = task_ended(arm)
    assert ended["exit_reason"] == "policy", ended
    assert "no action for 100 ms" in ended["exit_detail"]
    assert holds(twin.log, twin.log.host("setpoint")[0].t_ns)
    assert state(arm) == "holding"


def test_stop_ends_a_healthy_rollout_for_good(arm: RealRobot, twin: Twin) -> None:
    begin_moving(arm, lambda: arm.run_policy(ahead), lambda progress, _: progress["steps"] > 5)
    stopped_ns = time.monotonic_ns()
    json_of(arm.stop())
    ended = task(arm)
    assert (ended["running"], ended["exit_reason"]) == (False, "stop"), ended
    json_of(arm.resume())
    time.sleep(0.3)
    assert twin.log.setpoints_after_safe(stopped_ns) == 0


# # -- a policy in its own process


@pytest.mark.parametrize("provider", ["mock", "sine"])
def test_a_named_policy_runs_in_its_own_process(arm: RealRobot, twin: Twin, provider: str) -> None:
    def begin() -> Mapping[str, Any]:
        answer = arm.start_task("wave", policy_provider=provider)
        begun = json_of(answer)
        assert begun.keys() == TASK_KEYS and begun["running"] is True
        return answer

    begin_moving(arm, begin, lambda progress, _: progress["steps"] >= 8)
    assert pids(arm).keys() >= {"root", "wire", "policy"}
    assert "already running" in why(arm.run_policy(ahead))
    stopped_ns = time.monotonic_ns()
    ended = json_of(arm.stop_task())
    assert (ended["running"], ended["exit_reason"]) == (False, "stopped"), ended
    assert ended["instruction"] == "wave"
    assert holds(twin.log, stopped_ns)
    assert arm.send_action({"gripper": 50.0})["status"] == "success"


def test_a_named_policy_ends_after_its_duration(arm: RealRobot) -> None:
    run_to_end(arm, lambda: arm.start_task("wave", policy_provider="sine", duration=0.5))
    # The remaining processes: caller, root, wire, standby, spawner.
    until(lambda: len((arm.tree() or {})["processes"]) == 5, "the policy's process ends")
    run_to_end(arm, lambda: arm.start_task("wave", policy_provider="mock", duration=0.5))


def test_options_that_the_policy_does_not_take_are_reported(arm: RealRobot) -> None:
    json_of(arm.start_task("wave", policy_provider="sine", loudness=11))
    ended = task_ended(arm)
    assert ended["exit_reason"] == "policy", ended
    assert "loudness" in ended["exit_detail"]


def test_stop_ends_a_named_policy_too(arm: RealRobot, twin: Twin) -> None:
    begin_moving(
        arm, lambda: arm.start_task("wave", policy_provider="sine"), lambda progress, _: progress["steps"] >= 8
    )
    stopped_ns = time.monotonic_ns()
    assert json_of(arm.stop())["safe_state"] == "limp"
    twin.log.safe_within(stopped_ns, GENEROUS_S)
    ended = task_ended(arm)
    assert ended["exit_reason"] in ("stop", "gate"), ended
    time.sleep(0.2)
    assert twin.log.setpoints_after_safe(stopped_ns) == 0
    assert list(goals(twin.log.host("setpoint")[0])) == list(IDS.values())
