"""Use ``strands_actors.policies`` from a script, and a policy server that sends the first message."""

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
    assert "is defined in the script" in refusal and "run_policy(create_policy(...))" in refusal
    assert isinstance(create_policy("here"), Here)


@pytest.mark.parametrize(
    ("given", "error", "text"),
    [
        (lambda: register_policy("mock", lambda: Creep), ValueError, "mock is known already. Pass overwrite=True"),
        (lambda: register_policy("my", lambda: Creep, ["sine"]), ValueError, "sine is known already"),
        (lambda: register_policy("my", Creep), TypeError, "Give a function that returns the class"),
        (lambda: register_policy("a/b", lambda: Creep), TypeError, "without : and /"),
        (
            lambda: create_policy("smooth_talk"),
            ValueError,
            "Use one of groot, lerobot_local, mock, onnx, remote, sine",
        ),
        (lambda: create_policy(""), ValueError, "Give a name, or ws://host:port"),
        (lambda: create_policy("mock", amplitud=1), ValueError, r"\('amplitud' -> 'amplitude'\?\)"),
        (lambda: create_policy("mock", amplitude=-1), ValueError, "amplitude is -1"),
        (lambda: create_policy("sine"), ValueError, r"Use start_task\(policy_provider='sine', ...\)"),
        (lambda: create_policy("ws://:x"), ValueError, "Give ws://host:port"),
        (lambda: Policy(), TypeError, "abstract"),  # type: ignore[abstract]
    ],
)
def test_invalid_options_are_refused(given: Any, error: type[Exception], text: str) -> None:
    with pytest.raises(error, match=text):
        given()


def test_a_loader_that_returns_no_class_is_refused() -> None:
    register_policy("mine", lambda: Creep())  # type: ignore[arg-type,return-value]
    with pytest.raises(ValueError, match="It has to return the class"):
        create_policy("mine")


def test_overwrite_replaces_ours_for_this_process() -> None:
    register_policy("mock", lambda: Creep, overwrite=True)
    assert isinstance(create_policy("mock"), Creep)


# -- a server that sends the first message


def test_a_server_that_greets_drives_the_arm_by_name(arm: RealRobot, twin: Twin) -> None:
    with greeting_server(forward) as (port, received):
        began_ns = time.monotonic_ns()
        json_of(arm.start_task("forward", port, "127.0.0.1", "remote", control_frequency=20))
        until(lambda: len(twin.log.host("setpoint", began_ns)) > 16, "it moves by chunks")
        assert json_of(arm.stop_task())["exit_reason"] == "stopped"
    assert holds(twin.log, began_ns)
    keys = list(arm.get_observation())
    assert {"type": "set_state_keys", "keys": keys} in received
    assert {"type": "set_control_frequency", "hz": 20.0} in received
    assert {"type": "reset", "seed": None} in received
    requests = [each for each in received if each["type"] == "get_actions"]
    assert requests[0]["instruction"] == "forward" and list(requests[0]["observation"]) == keys
    assert (requests[0]["rtc_observed_delay_steps"], requests[0]["kwargs"]) == (None, {})
    # all steps of each chunk are executed, not only the first
    assert len(requests) < len(twin.log.host("setpoint", began_ns)) / 4


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
        greeting_server(lambda seen: [{"a": seen["a"] + 1.0}], greet_after_s=0.6) as (port, received),
        contextlib.closing(Remote(AXES, "127.0.0.1", port)) as remote,
    ):
        remote.set_control_frequency(25.0)
        for expected in (1.0, 2.0):
            assert remote.get_actions_sync({"a": expected - 1.0, "b": 0.0}, "go") == [{"a": expected}]
    assert {"type": "set_state_keys", "keys": AXES} in received
    assert {"type": "set_control_frequency", "hz": 25.0} in received


def test_a_remote_policy_has_the_properties_from_the_servers_greeting() -> None:
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
        (refuse, {}, "reports an error: KeyError: 'image'"),
        (lambda seen: "left", {}, "sent a response that its protocol does not have"),
        (lambda seen: [], {"version": 2}, "uses version 2 of its protocol, not 1"),
        (lambda seen: [], {"execution_horizon": 0}, "reports execution_horizon 0"),
        (lambda seen: [], {"requires_images": "no"}, "sent a wrong first message"),
    ],
)
def test_an_invalid_greeting_is_reported(chunk: Any, facts: dict[str, Any], text: str) -> None:
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
