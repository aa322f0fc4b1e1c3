"""``run``: one call lets a policy in any form control the arm, and returns what happened."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import pytest
import trio

from strands_actors import open_robot
from strands_actors.caller.handle.robot import RealRobot
from strands_actors.policies import registry
from strands_actors.testing import Twin
from tests.agents.test_policies import forward, server
from tests.answers import json_of, task, until, why

from .conftest import NewArm
from .helpers import completed_run, holds

SLOW_S = 0.6
KEYS = {
    "robot",
    "policy",
    "source",
    "refused",
    "observation_age_s",
    "stopped",
    "unconfirmed",
    "steps",
    "exit_reason",
}

Seen = Mapping[str, float]


def creep(seen: Seen) -> dict[str, float]:
    return {"shoulder_pan": seen["shoulder_pan"] + 0.3}


class SlowToLoad:
    """A policy whose process needs longer to load it than it then runs."""

    def __init__(self, axes: Sequence[str]) -> None:
        time.sleep(SLOW_S)

    def step(self, seen: Seen) -> dict[str, float]:
        return creep(seen)


# -- every form of policy


def test_an_object_a_name_and_a_server_run_and_the_arm_holds_afterwards(arm: RealRobot, twin: Twin) -> None:
    with server(forward) as (port, _):
        for policy, label, kind in (
            (creep, "creep", "object"),
            ("mock", "mock", "name"),
            ("tests.robot.test_run:SlowToLoad", "tests.robot.test_run:SlowToLoad", "name"),
            (f"ws://127.0.0.1:{port}", f"ws://127.0.0.1:{port}", "server"),
        ):
            began_ns = time.monotonic_ns()
            # The time counts from the first action: one of the policies needs longer than that to load.
            report = completed_run(arm, policy, seconds=0.3)
            assert report.keys() >= KEYS
            assert (report["policy"], report["source"]) == (label, kind) and report["elapsed_s"] >= 0.3
            assert twin.log.host("setpoint", began_ns)
            assert until(lambda ns=began_ns: holds(twin.log, ns), "the arm holds")  # type: ignore[misc]


def test_a_class_of_the_script_runs_by_its_registered_name(arm: RealRobot, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(registry, "_registered", {})  # no other test sees the name

    class Local:
        def step(self, seen: Seen) -> dict[str, float]:
            return creep(seen)

    registry.register_policy("of_this_test", lambda: Local)
    assert completed_run(arm, "of_this_test", seconds=0.3)["source"] == "object"


def test_options_and_the_rate_reach_the_policy(arm: RealRobot, twin: Twin) -> None:
    began_ns = time.monotonic_ns()
    options = {"control_frequency": 20, "only": ["gripper"], "amplitude": 1.0}
    report = completed_run(arm, "sine", seconds=0.5, **options)
    assert 0 < report["steps"] <= 12 and twin.log.host("setpoint", began_ns)


# -- progress, Ctrl-C


def test_progress_has_rate_age_and_refusals(arm: RealRobot) -> None:
    seen: list[Mapping[str, Any]] = []

    def keep(look: Mapping[str, Any]) -> None:
        if not look["steps"]:
            seen.clear()  # a new attempt
        seen.append(look)

    completed_run(arm, creep, seconds=0.5, progress=keep)
    assert len(seen) >= 2
    assert seen[-1].keys() == {"running", "steps", "hz", "elapsed_s", "observation_age_s", "refused"}
    assert [look["running"] for look in seen] == [True] * (len(seen) - 1) + [False]
    assert seen[-1]["steps"] >= 1 and 0 <= seen[-1]["observation_age_s"] < 5.0


def test_ctrl_c_and_a_failed_progress_end_in_a_hold(arm: RealRobot, twin: Twin) -> None:
    for raised in (KeyboardInterrupt, ValueError):
        began_ns = time.monotonic_ns()

        def interrupt(look: Mapping[str, Any], raised: type[BaseException] = raised) -> None:
            if look["steps"]:
                raise raised

        with pytest.raises(raised):
            arm.run(creep, seconds=30.0, progress=interrupt)
        assert (task(arm)["running"], task(arm)["exit_reason"]) == (False, "stopped")
        assert until(lambda ns=began_ns: holds(twin.log, ns), "the arm holds")  # type: ignore[misc]


# -- errors end in a hold, with the words of the policy or the server


LIES: dict[str, tuple[Any, str]] = {
    "nan": ({"shoulder_pan": math.nan}, "shoulder_pan is nan. Send a finite number"),
    "unknown axis": ({"elbow": 1.0}, "elbow is not a joint of so101"),
    "text value": ({"shoulder_pan": "left"}, "shoulder_pan is left. Send a finite number"),
    "a text instead of a chunk": ("go left", "the policy returned str, not an action or a list of actions"),
    "numbers without names": ([0.0] * 6, "the policy returned list, not an action or a list of actions"),
    "out of range": ({"shoulder_pan": 400.0}, "shoulder_pan 400.0 deg is past 110.1"),
    "too many keys": ({f"joint{number}": 0.0 for number in range(1000)}, "joint0 is not a joint of so101"),
}


def test_saf_014_a_lie_of_an_object_never_reaches_the_wire(arm: RealRobot, twin: Twin) -> None:
    for lie, (value, text) in LIES.items():
        answer = arm.run(lambda seen, value=value: value, seconds=5.0)
        assert text in why(answer), (lie, answer)
        assert answer["content"][1]["json"]["steps"] == 0, lie
    assert not twin.log.host("setpoint")


def late(request: dict[str, Any]) -> dict[str, Any]:
    time.sleep(1.0)
    return {"actions": [creep(request["observation"])]}


SERVER_LIES: dict[str, tuple[Callable[[dict[str, Any]], Any], str]] = {
    "its own error": (lambda request: {"error": "CUDA out of memory"}, "reports an error: CUDA out of memory"),
    "a text": (lambda request: {"actions": "left"}, "not a chunk of actions: Expected `array`, got `str`"),
    "nan": (lambda request: {"actions": [{"shoulder_pan": math.nan}]}, "shoulder_pan is nan"),
    "unknown axis": (lambda request: {"actions": [{"elbow": 1.0}]}, "elbow is not a joint of so101"),
    "wrong shape": (lambda request: {"actions": [[0.0] * 7]}, "not a chunk of actions: Expected `object`"),
    "100 MB": (lambda request: bytes(100_000_000), "too big"),
}


def test_saf_014_a_lie_of_a_server_never_reaches_the_wire(arm: RealRobot, twin: Twin) -> None:
    for lie, (reply, text) in SERVER_LIES.items():
        with server(reply) as (port, _):
            answer = arm.run(f"ws://127.0.0.1:{port}", seconds=5.0)
        assert text in why(answer), (lie, answer)
    with server(late) as (port, _):
        answer = arm.run(f"ws://127.0.0.1:{port}", seconds=5.0, timeout_s=0.3)
    assert f"ws://127.0.0.1:{port}/ did not answer within 0.3 s" in why(answer)
    assert not twin.log.host("setpoint")


def test_a_lie_after_true_steps_ends_in_a_hold(arm: RealRobot, twin: Twin) -> None:
    steps = iter(range(5))
    began_ns = time.monotonic_ns()

    def changing(seen: Seen) -> dict[str, float]:
        return creep(seen) if next(steps, None) is not None else {"shoulder_pan": math.inf}

    answer = arm.run(changing, seconds=30.0)
    assert "run: changing ended: gate: move: shoulder_pan is inf" in why(answer)
    report = answer["content"][1]["json"]
    assert (report["exit_reason"], report["refusal"], report["unconfirmed"]) == ("gate", "not_finite", [])
    assert report["refused"] >= 1
    assert until(lambda: holds(twin.log, began_ns), "the arm holds")


def test_saf_014_a_chunk_that_comes_late_is_never_sent(arm: RealRobot, twin: Twin) -> None:
    """The first late chunk is computed again, since a policy may load in it. The second one ends the run."""
    calls: list[float] = []

    def late(seen: Seen) -> dict[str, float]:
        calls.append(time.monotonic())
        time.sleep(0.5)
        return creep(seen)

    answer = arm.run(late, seconds=5.0, max_age=0.3)
    assert "computed from a reading that is" in why(answer) and "(limit 0.3 s)" in why(answer)
    assert len(calls) == 2 and not twin.log.host("setpoint")


def test_an_action_that_waits_too_long_in_its_chunk_is_never_sent(arm: RealRobot, twin: Twin) -> None:
    answer = arm.run(lambda seen: [creep(seen)] * 60, seconds=5.0, max_age=0.5)
    assert "(limit 0.5 s)" in why(answer)
    report = answer["content"][1]["json"]
    assert report["exit_reason"] == "policy" and 0 < report["steps"] < 60
    assert 0.0 < report["action_age_s"] <= 0.5


def test_an_action_of_a_loading_policy_is_computed_again(arm: RealRobot) -> None:
    loads = iter([0.5])

    def loading(seen: Seen) -> dict[str, float]:
        time.sleep(next(loads, 0.0))
        return creep(seen)

    assert completed_run(arm, loading, seconds=0.4, max_age=0.3)["action_age_s"] <= 0.3


# -- refusals before anything starts


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        ({"policy": "smock"}, "'smock' (mock?) is no policy's name"),
        ({"policy": None}, "policy is None"),
        ({"policy": 3}, "int is no policy"),
        ({"policy": "grpc://gpu:5555"}, "there is no client for grpc://"),
        ({"policy": creep, "max_age": 0}, "max_age is 0"),
        ({"policy": "./nowhere"}, "there is no folder nowhere"),
        ({"policy": creep, "amplitude": 1.0}, "amplitude: of a policy that is made already"),
        ({"policy": creep, "seconds": 0}, "seconds is 0"),
        ({"policy": creep, "seconds": math.inf}, "seconds is inf"),
        ({"policy": creep, "control_frequency": 0}, "control_frequency is 0"),
        ({"policy": creep, "progress": "yes"}, "progress is 'yes'"),
        ({"policy": creep, "instruction": 3}, "instruction is 3"),
    ],
)
def test_wrong_arguments_start_no_process(new_arm: NewArm, arguments: dict[str, Any], text: str) -> None:
    arm = new_arm(port="/dev/null/none")
    assert text in why(arm.run(**arguments))
    assert arm.tree() is None


def test_a_robot_that_runs_no_policies_says_so(run_dir: Path) -> None:
    from strands_actors import Robot

    duck = Robot("microduck", mode="real", transport="twin")
    assert "run: microduck: " in why(duck.run("mock", seconds=1))
    assert duck.tree() is None


# -- trio


def test_the_coroutine_runs_and_a_cancelled_one_holds(twin: Twin, run_dir: Path) -> None:
    async def main() -> None:
        async with open_robot("so101", mode="real", port=twin.port) as arm:
            first = await arm.run(creep, seconds=0.3)
            assert first["content"][-1]["json"]["policy"] == "creep"
            began_ns = time.monotonic_ns()
            with trio.CancelScope() as scope:
                await arm.run("mock", seconds=30.0, progress=lambda look: look["steps"] and scope.cancel())
            assert scope.cancelled_caught
            assert json_of(await arm.get_task_status())["exit_reason"] == "stopped"
            assert holds(twin.log, began_ns)
            assert "is no policy" in why(await arm.run(3))

    trio.run(main)
