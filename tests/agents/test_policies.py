"""Choose policies by name, check what they receive and return, and run one on a real policy server."""

from __future__ import annotations

import contextlib
import importlib.metadata
import json
import math
import socket
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from websockets.sync.server import ServerConnection, serve

from strands_actors.caller.handle.robot import RealRobot
from strands_actors.policies.mock import Mock
from strands_actors.policies.registry import choose_provider
from strands_actors.policies.remote import Remote
from strands_actors.supervisors.policy import as_infer, prepare
from strands_actors.testing import Twin
from tests.answers import json_of, pids, task_ended, until, why
from tests.robot.helpers import holds

AXES = ["a", "b"]

Answer = Callable[[dict[str, Any]], dict[str, Any] | bytes | None]


@contextlib.contextmanager
def server(answer: Answer) -> Iterator[tuple[int, list[dict[str, Any]]]]:
    """Run a third-party policy server and yield its port and the requests that it received. It answers in the
    encoding of the request. If ``answer`` returns None, it sends no answer."""
    requests: list[dict[str, Any]] = []
    done = threading.Event()

    def handle(connection: ServerConnection) -> None:
        for message in connection:
            codec = msgspec.json if isinstance(message, str) else msgspec.msgpack
            requests.append(codec.decode(message))
            reply = answer(requests[-1])
            if reply is None:
                done.wait(20.0)
                return
            connection.send(
                reply if isinstance(reply, bytes) else codec.encode(reply), text=isinstance(message, str)
            )

    with serve(handle, "127.0.0.1", 0) as listening:
        thread = threading.Thread(target=listening.serve_forever)
        thread.start()
        try:
            yield listening.socket.getsockname()[1], requests
        finally:
            done.set()
            listening.shutdown()
            thread.join()


def forward(request: dict[str, Any]) -> dict[str, Any]:
    """Return eight steps of 0.2 degrees, from the arm's present position."""
    start = request["observation"]["shoulder_pan"]
    return {"actions": [{"shoulder_pan": start + 0.2 * step} for step in range(1, 9)]}


# -- choosing a policy


def test_the_default_policy_needs_lerobot(arm: RealRobot) -> None:
    refusal = why(arm.start_task("wave"))
    assert "policy_provider 'lerobot_local' needs lerobot: pip install 'strands-actors[lerobot]'" in refusal
    assert "Policies that need no package are mock, remote, sine" in refusal


@pytest.mark.parametrize("port", [0, -1, 65536, True, "8000", 1.5])
def test_an_invalid_port_is_refused(port: Any) -> None:
    with pytest.raises(ValueError, match="policy_port is"):
        choose_provider("remote", "localhost", port, {})


def test_only_a_remote_policy_takes_an_address() -> None:
    with pytest.raises(ValueError, match="takes no policy_port"):
        choose_provider("mock", "localhost", 8000, {})
    assert choose_provider("mock", "localhost", None, {"amplitude": 1.0})[1] == {"amplitude": 1.0}
    assert choose_provider("remote", "10.0.0.7", 8000, {})[1] == {"host": "10.0.0.7", "port": 8000}
    assert choose_provider("mine.policies:Fast", "there", 1, {})[0].where == "mine.policies:Fast"


@pytest.mark.parametrize("name", ["smooth_talk", "", None, 3])
def test_an_unknown_policy_name_is_refused_with_the_known_names(name: Any) -> None:
    with pytest.raises(ValueError, match="Use one of groot, lerobot_local, mock, onnx, remote, sine"):
        choose_provider(name, "localhost", None, {})


def test_another_package_adds_a_provider_but_cannot_replace_one(monkeypatch: pytest.MonkeyPatch) -> None:
    points = [
        EntryPoint("wbc", "other.wbc:Wbc", "strands_actors.policies"),
        EntryPoint("mock", "other.bad:Mock", "strands_actors.policies"),
    ]
    monkeypatch.setattr(importlib.metadata, "entry_points", lambda group: points)
    provider, options = choose_provider("wbc", "localhost", 8000, {})
    assert (provider.where, options) == ("other.wbc:Wbc", {"host": "localhost", "port": 8000})
    assert choose_provider("mock", "localhost", None, {})[0].where == "strands_actors.policies.mock:Mock"


# -- inputs and outputs of a policy


class Told:
    """A policy with the interface that the drivers page describes."""

    supports_rtc = False
    execution_horizon = 2

    def __init__(self) -> None:
        self.calls: list[tuple[str, Any]] = []

    def set_robot_state_keys(self, keys: Sequence[str]) -> None:
        self.calls.append(("keys", keys))

    def set_control_frequency(self, hz: float) -> None:
        self.calls.append(("hz", hz))

    def reset(self, seed: int | None = None) -> None:
        self.calls.append(("reset", seed))

    async def get_actions(self, observation: Mapping[str, float], instruction: str, **_: Any) -> list[Any]:
        return [{"a": np.float32(0.5), "b": step} for step in range(4)]


def test_a_policy_with_the_documented_interface_gets_the_robots_axes_and_rate() -> None:
    policy = Told()
    prepare(policy, ("a", "b"), 30.0)
    assert policy.calls == [("keys", ["a", "b"]), ("hz", 30.0), ("reset", None)]
    prepare(lambda observation: {}, ("a",), 30.0)


def test_a_chunk_is_plain_numbers_and_whole_unless_chunks_are_blended() -> None:
    policy = Told()
    chunk = as_infer(policy)({"a": 0.0}, "go")
    assert chunk == [{"a": 0.5, "b": float(step)} for step in range(4)]
    assert {type(value) for action in chunk for value in action.values()} == {float}
    policy.supports_rtc = True
    assert len(as_infer(policy)({"a": 0.0}, "go")) == 2


@pytest.mark.parametrize("answer", [3, None, "ab", ["a"], {"a"}])
def test_an_invalid_action_is_refused(answer: Any) -> None:
    with pytest.raises(TypeError, match=f"returned {type(answer).__name__}, not an action"):
        as_infer(lambda observation: answer)({}, "")


@pytest.mark.parametrize("policy", [None, 3, "mock", object(), {"step": 1}])
def test_an_invalid_policy_is_refused(policy: Any) -> None:
    with pytest.raises(TypeError, match="is no policy"):
        as_infer(policy)


def test_the_mock_is_the_pages_mock() -> None:
    mock = Mock(AXES)
    first, second = (mock.get_actions_sync({"a": 10.0, "b": 0.0}, "") for _ in range(2))
    assert len(first) == len(second) == 8
    assert first[0] == {"a": 10.0, "b": 0.0}  # no jump
    for step, action in enumerate(first + second):
        t_s = 0.02 * step
        wave = math.sin(2 * math.pi * 0.45 * t_s + math.pi / 3) - math.sin(math.pi / 3)
        assert action["a"] == pytest.approx(10.0 + 0.5 * math.sin(2 * math.pi * 0.3 * t_s))
        assert action["b"] == pytest.approx(0.5 * wave)
    mock.reset()
    assert mock.get_actions_sync({"a": 3.0, "b": 1.0}, "")[0] == {"a": 3.0, "b": 1.0}


def test_numbers_of_numpy_drive_the_arm(arm: RealRobot) -> None:
    def ahead(observation: Mapping[str, float]) -> dict[str, Any]:
        return {"shoulder_pan": np.float32(observation["shoulder_pan"] + 0.5)}

    json_of(arm.run_policy(ahead, n_steps=5))
    ended = task_ended(arm)
    assert (ended["exit_reason"], ended["steps"]) == ("n_steps", 5), ended


# -- refusals of run_policy, in their order


def test_run_policy_is_refused_for_the_first_thing_that_is_wrong(arm: RealRobot) -> None:
    def hold(observation: Mapping[str, float]) -> dict[str, float]:
        return {"gripper": observation["gripper"]}

    everything = {"duration": -1, "n_steps": 0, "policy": 3}
    assert "duration is -1" in why(arm.run_policy(**everything))
    assert "n_steps is 0" in why(arm.run_policy(**everything | {"duration": 1.0}))
    assert "int is no policy" in why(arm.run_policy(**everything | {"duration": 1.0, "n_steps": 1}))
    assert "both given" in why(arm.run_policy(hold, policy_object=hold))
    json_of(arm.run_policy(hold))
    json_of(arm.stop())
    assert "the robot is disarmed" in why(arm.run_policy(hold))
    json_of(arm.resume())
    json_of(arm.run_policy(policy=hold))
    assert "already running. Call stop_task() first" in why(arm.run_policy(policy_object=hold))
    json_of(arm.stop_task())
    arm.cleanup()
    assert "int is no policy" in why(arm.run_policy(3))
    assert "cleaned up" in why(arm.run_policy(hold))


class Late:
    """A policy that loads slowly."""

    def __init__(self, axes: Sequence[str], ready: str, wait_s: float = 20.0) -> None:
        Path(ready).touch()
        deadline_s = time.monotonic() + wait_s
        while not Path(f"{ready}.go").exists() and time.monotonic() < deadline_s:
            time.sleep(0.005)

    def step(self, observation: Mapping[str, float]) -> dict[str, float]:
        return {"shoulder_pan": observation["shoulder_pan"] + 0.5}


def test_saf_008_a_policy_that_loads_through_a_stop_does_not_move_after_the_resume(
    arm: RealRobot, twin: Twin, tmp_path: Path
) -> None:
    ready = tmp_path / "ready"
    json_of(arm.start_task("x", policy_provider="tests.agents.test_policies:Late", ready=str(ready)))
    until(ready.exists, "it loads")
    json_of(arm.stop())
    json_of(arm.resume())
    Path(f"{ready}.go").touch()
    until(lambda: "policy" not in pids(arm), "it ends")
    assert not twin.log.host("setpoint")
    assert json_of(arm.get_task_status())["running"] is False
    assert arm.send_action({"gripper": 40.0})["status"] == "success"


# -- a policy on a server


@pytest.mark.parametrize("encoding", ["msgpack", "json"])
def test_a_remote_policy_drives_the_arm(arm: RealRobot, twin: Twin, encoding: str) -> None:
    with server(forward) as (port, requests):
        began_ns = time.monotonic_ns()
        json_of(arm.start_task("forward", port, "127.0.0.1", "remote", encoding=encoding, control_frequency=20))
        until(lambda: len(requests) >= 3 and len(twin.log.host("setpoint", began_ns)) > 16, "it moves by chunks")
        ended = json_of(arm.stop_task())
    assert (ended["exit_reason"], ended["instruction"]) == ("stopped", "forward"), ended
    first = requests[0]
    assert (first["instruction"], first["axes"], first["hz"]) == ("forward", list(first["observation"]), 20.0)
    # All steps of each chunk are executed, not only the first.
    assert len(requests) < len(twin.log.host("setpoint", began_ns)) / 4
    assert holds(twin.log, began_ns)


def ended_with(arm: RealRobot, port: int, **options: Any) -> str:
    json_of(arm.start_task("x", port, "127.0.0.1", "remote", **options))
    ended = task_ended(arm)
    assert ended["exit_reason"] == "policy", ended
    return str(ended["exit_detail"])


def test_a_server_that_goes_silent_ends_the_rollout_and_the_arm_holds(arm: RealRobot, twin: Twin) -> None:
    answers = iter([forward, forward])
    began_ns = time.monotonic_ns()
    with server(lambda request: next(answers, lambda _: None)(request)) as (port, _):
        assert "no action for" in ended_with(arm, port)
    assert holds(twin.log, began_ns)


def test_an_unreachable_policy_server_is_reported(arm: RealRobot, twin: Twin) -> None:
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    assert f"ConnectionError: ws://127.0.0.1:{port}/: " in ended_with(arm, port)
    assert not twin.log.host("setpoint")


OBSERVATION = {"a": 0.0, "b": math.nan}


@pytest.mark.parametrize(
    ("answer", "error", "text"),
    [
        (lambda request: {"error": "no such task"}, ConnectionError, "reports an error: no such task"),
        (
            lambda request: {"actions": [{"a": "left"}]},
            ConnectionError,
            "not a chunk of actions: Expected `float`, got `str`",
        ),
        (lambda request: b"\xc1", ConnectionError, "not a chunk of actions"),
        (lambda request: b"\x00" * (1 << 21), ConnectionError, "too big"),
        (lambda request: None, TimeoutError, "did not answer within 0.2 s"),
    ],
)
def test_an_invalid_chunk_is_reported(answer: Answer, error: type[Exception], text: str) -> None:
    with (
        server(answer) as (port, _),
        contextlib.closing(Remote(AXES, "127.0.0.1", port, timeout_s=0.2)) as remote,
        pytest.raises(error, match=text),
    ):
        remote.get_actions_sync(OBSERVATION, "go")


def test_a_missing_reading_is_null_in_json() -> None:
    with (
        server(lambda request: {"actions": [{"a": 1}]}) as (port, requests),
        contextlib.closing(Remote(AXES, "127.0.0.1", port, encoding="json")) as remote,
    ):
        assert remote.get_actions_sync(OBSERVATION, "go") == [{"a": 1.0}]
    assert json.dumps(requests[0]["observation"]) == '{"a": 0.0, "b": null}'


def test_a_silent_policy_server_ends_in_a_timeout() -> None:
    with socket.create_server(("127.0.0.1", 0)) as mute, pytest.raises(TimeoutError, match=r"within 0\.2 s"):
        Remote(AXES, "127.0.0.1", mute.getsockname()[1], timeout_s=0.2)
    with pytest.raises(ValueError, match="Use one of msgpack, json"):
        Remote(AXES, encoding="pickle")
