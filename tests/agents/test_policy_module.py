"""``strands_actors.policies`` as a script uses it, and a server that speaks first."""

from __future__ import annotations

import contextlib
import time
from typing import Any

import pytest

import strands_actors
from strands_actors import Robot
from strands_actors.caller.handle.robot import RealRobot
from strands_actors.policies import MockPolicy, Policy, create_policy, list_providers, register_policy, registry
from strands_actors.policies.remote import Remote
from strands_actors.testing import Twin
from tests.answers import json_of, task_ended, until, why
from tests.robot.helpers import holds

from .greeting_server import greeting_server
from .own_policies import Creep

AXES = ["a", "b"]
OBSERVATION = {"a": 0.0, "b": 1.0}


@pytest.fixture(autouse=True)
def fresh(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(registry, "_registered", {})
    monkeypatch.setattr(registry, "_aliases", {})


def forward(observation: dict[str, float]) -> list[dict[str, float]]:
    start = observation["shoulder_pan"]
    return [{"shoulder_pan": start + 0.2 * step} for step in range(1, 9)]


# -- policies of a script


def test_the_names_are_where_scripts_look_for_them() -> None:
    assert strands_actors.create_policy is create_policy
    assert strands_actors.Policy is Policy and strands_actors.MockPolicy is MockPolicy
    assert {"mock", "remote", "sine", "lerobot_local"} <= set(list_providers())


def test_a_mock_of_the_script_drives_a_simulation() -> None:
    with Robot("so101") as arm:
        json_of(arm.run_policy(create_policy("mock", amplitude=2.0), "wave", n_steps=20))
        ended = task_ended(arm)
    assert (ended["exit_reason"], ended["steps"]) == ("n_steps", 20), ended


def test_a_policy_of_ones_own_drives_by_object_and_by_name(arm: RealRobot, twin: Twin) -> None:
    register_policy("creep", lambda: Creep, aliases=["crawl"])
    made = create_policy("crawl", step=0.2)
    assert isinstance(made, Creep) and made.step == 0.2
    json_of(arm.run_policy(made, n_steps=8, control_frequency=20))
    assert task_ended(arm)["exit_reason"] == "n_steps"
    began_ns = time.monotonic_ns()
    json_of(arm.start_task("go on", policy_provider="creep", step=0.3, control_frequency=20))
    until(lambda: len(twin.log.host("setpoint", began_ns)) > 8, "its own process drives")
    assert json_of(arm.stop_task())["exit_reason"] == "stopped"


def test_a_class_of_the_script_itself_goes_to_run_policy(arm: RealRobot) -> None:
    class Here(Creep):
        pass

    register_policy("here", lambda: Here)
    refusal = why(arm.start_task("x", policy_provider="here"))
    assert "stands in the script itself" in refusal and "run_policy(create_policy(...))" in refusal
    assert isinstance(create_policy("here"), Here)


@pytest.mark.parametrize(
    ("given", "error", "text"),
    [
        (lambda: register_policy("mock", lambda: Creep), ValueError, "mock is known already. pass overwrite=True"),
        (lambda: register_policy("my", lambda: Creep, ["sine"]), ValueError, "sine is known already"),
        (lambda: register_policy("my", Creep), TypeError, "give a function that returns the class"),
        (lambda: register_policy("a/b", lambda: Creep), TypeError, "without : and /"),
        (lambda: create_policy("smooth_talk"), ValueError, "use one of lerobot_local, mock, remote, sine"),
        (lambda: create_policy(""), ValueError, "give a name, or ws://host:port"),
        (lambda: create_policy("mock", amplitud=1), ValueError, r"\('amplitud' -> 'amplitude'\?\)"),
        (lambda: create_policy("mock", amplitude=-1), ValueError, "amplitude is -1"),
        (lambda: create_policy("sine"), ValueError, r"use start_task\(policy_provider='sine', ...\)"),
        (lambda: create_policy("ws://:x"), ValueError, "give ws://host:port"),
        (lambda: Policy(), TypeError, "abstract"),  # type: ignore[abstract]
    ],
)
def test_what_is_wrong_is_refused(given: Any, error: type[Exception], text: str) -> None:
    with pytest.raises(error, match=text):
        given()


def test_a_loader_that_returns_no_class_is_told() -> None:
    register_policy("mine", lambda: Creep())  # type: ignore[arg-type,return-value]
    with pytest.raises(ValueError, match="it has to return the class"):
        create_policy("mine")


def test_overwrite_replaces_ours_for_this_process() -> None:
    register_policy("mock", lambda: Creep, overwrite=True)
    assert isinstance(create_policy("mock"), Creep)


# -- a server that speaks first


def test_a_server_that_greets_drives_the_arm_by_name(arm: RealRobot, twin: Twin) -> None:
    with greeting_server(forward) as (port, heard):
        began_ns = time.monotonic_ns()
        json_of(arm.start_task("forward", port, "127.0.0.1", "remote", control_frequency=20))
        until(lambda: len(twin.log.host("setpoint", began_ns)) > 16, "it moves by chunks")
        assert json_of(arm.stop_task())["exit_reason"] == "stopped"
    assert holds(twin.log, began_ns)
    keys = list(arm.get_observation())
    assert {"type": "set_state_keys", "keys": keys} in heard
    assert {"type": "set_control_frequency", "hz": 20.0} in heard
    assert {"type": "reset", "seed": None} in heard
    asked = [each for each in heard if each["type"] == "get_actions"]
    assert asked[0]["instruction"] == "forward" and list(asked[0]["observation"]) == keys
    assert (asked[0]["rtc_observed_delay_steps"], asked[0]["kwargs"]) == (None, {})
    # each chunk is executed, not its first step alone
    assert len(asked) < len(twin.log.host("setpoint", began_ns)) / 4


def test_the_address_of_a_server_is_a_policy(arm: RealRobot) -> None:
    with greeting_server(forward) as (port, _):
        policy = create_policy(f"ws://127.0.0.1:{port}")
        json_of(arm.run_policy(policy, n_steps=8, control_frequency=20))
        assert task_ended(arm)["exit_reason"] == "n_steps"
        policy.close()
        json_of(arm.start_task("x", policy_provider=f"ws://127.0.0.1:{port}", duration=0.5))
        assert task_ended(arm)["exit_reason"] == "duration"


def test_a_greeting_that_comes_late_is_heeded() -> None:
    with (
        greeting_server(lambda seen: [{"a": seen["a"] + 1.0}], greet_after_s=0.6) as (port, heard),
        contextlib.closing(Remote(AXES, "127.0.0.1", port)) as remote,
    ):
        remote.set_control_frequency(25.0)
        for expected in (1.0, 2.0):
            assert remote.get_actions_sync({"a": expected - 1.0, "b": 0.0}, "go") == [{"a": expected}]
    assert {"type": "set_state_keys", "keys": AXES} in heard
    assert {"type": "set_control_frequency", "hz": 25.0} in heard


def test_what_it_says_of_its_policy_counts_here() -> None:
    with (
        greeting_server(lambda seen: [{"a": 1.0}] * 4, supports_rtc=True, execution_horizon=2) as (port, _),
        contextlib.closing(Remote(AXES, "127.0.0.1", port)) as remote,
    ):
        assert (remote.supports_rtc, remote.execution_horizon, remote.requires_images) == (True, 2, False)


def refuse(seen: dict[str, float]) -> list[dict[str, float]]:
    raise KeyError("image")


@pytest.mark.parametrize(
    ("chunk", "facts", "text"),
    [
        (refuse, {}, "says: KeyError: 'image'"),
        (lambda seen: "left", {}, "answered what its protocol does not have"),
        (lambda seen: [], {"version": 2}, "speaks version 2 of its protocol, not 1"),
        (lambda seen: [], {"execution_horizon": 0}, "advertises execution_horizon 0"),
        (lambda seen: [], {"requires_images": "no"}, "began with what is no greeting"),
    ],
)
def test_what_it_says_wrongly_is_told(chunk: Any, facts: dict[str, Any], text: str) -> None:
    def asked(port: int) -> None:
        with contextlib.closing(Remote(AXES, "127.0.0.1", port)) as remote:
            remote.get_actions_sync(OBSERVATION, "go")

    with greeting_server(chunk, **facts) as (port, _), pytest.raises(ConnectionError, match=text):
        asked(port)


def test_an_error_of_the_server_ends_the_rollout_and_the_arm_holds(arm: RealRobot, twin: Twin) -> None:
    began_ns = time.monotonic_ns()
    with greeting_server(refuse) as (port, _):
        json_of(arm.start_task("x", port, "127.0.0.1", "remote"))
        ended = task_ended(arm)
    assert ended["exit_reason"] == "policy" and "KeyError: 'image'" in ended["exit_detail"]
    assert not twin.log.host("setpoint", began_ns)
