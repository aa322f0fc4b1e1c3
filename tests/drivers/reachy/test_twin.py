"""Test the twin's service with httpx and websockets, and its likeness to the real daemon."""

from __future__ import annotations

import json
import math
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import httpx
import pytest
from websockets.sync.client import ClientConnection, connect

from strands_actors.drivers.common.codecs.http_messages import Request
from strands_actors.drivers.common.twin import Fault
from strands_actors.drivers.reachy import protocol as p
from strands_actors.drivers.reachy.twin import ReachyTwin
from strands_actors.testing import Twin
from tests.answers import until


class Clock:
    """A clock that the test advances."""

    def __init__(self) -> None:
        self.now_s = 0.0

    def __call__(self) -> float:
        return self.now_s


@pytest.fixture(scope="module")
def twin(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Twin]:
    with Twin("reachy_mini", tmp_path_factory.mktemp("twin")) as process:
        yield process


@pytest.fixture
def client(twin: Twin) -> Iterator[httpx.Client]:
    with httpx.Client(base_url=f"http://{twin.port}", trust_env=False, timeout=5.0) as one:
        yield one


@contextmanager
def listening(twin: Twin, path: str) -> Iterator[ClientConnection]:
    with connect(f"ws://{twin.port}{path}", proxy=None, close_timeout=0.2) as socket:
        yield socket


def told(socket: ClientConnection, kind: str = "") -> dict[str, Any]:
    while True:
        message: dict[str, Any] = json.loads(socket.recv(5.0))
        if not kind or message.get("type") == kind:
            return message


def test_clients_of_another_make_move_look_and_stop(client: httpx.Client, twin: Twin) -> None:
    assert client.get(p.STATUS).json()["state"] == "running"
    with listening(twin, p.UPDATES) as updates, listening(twin, p.SDK) as sdk:
        pose = {"yaw": 0.3, "pitch": 0.2}
        move = client.post(p.GOTO, json={"head_pose": pose, "antennas": [0.5, -0.5], "duration": 0.4}).json()
        assert client.get(p.RUNNING).json() == [move]
        ignored = client.post(p.SET_TARGET, json={"target_antennas": [0, 0]}).json()
        assert ignored == {"status": "ignored", "reason": "move_running"}
        assert told(updates) == {"type": "move_completed", "uuid": move["uuid"], "details": ""}
        seen = told(sdk, "joint_positions")
        until(lambda: told(sdk, "head_pose")["head_pose"][1][0] > 0.28, "the head has turned")
        assert len(seen["head_joint_positions"]) == 7
        assert client.get("/api/state/full").json()["antennas_position"] == pytest.approx([0.5, -0.5], abs=1e-3)
        long = client.post(p.GOTO, json={"antennas": [1.0, 1.0], "duration": 9.0}).json()
        sdk.send('{"type": "stop_move"}')
        assert told(updates) == {"type": "move_cancelled", "uuid": long["uuid"], "details": ""}
        assert client.get(p.RUNNING).json() == []
        assert client.post(p.STOP, json=long).status_code == 500


@pytest.mark.parametrize("kind", ["[]", "{}", "null", "7", '"unknown"'])
def test_a_message_without_a_known_type_is_dropped_and_the_connection_stays(kind: str, twin: Twin) -> None:
    with listening(twin, p.SDK) as sdk:
        sdk.send(f'{{"type": {kind}}}')
        told(sdk, "joint_positions")
        sdk.send('{"type": "stop_move"}')
        told(sdk, "joint_positions")


def test_targets_and_states_over_their_own_websockets(client: httpx.Client, twin: Twin) -> None:
    with (
        listening(twin, "/api/state/ws/full?frequency=50") as states,
        listening(twin, "/api/move/ws/set_target") as targets,
    ):
        targets.send(json.dumps({"target_body_yaw": 0.5}))
        until(lambda: math.isclose(told(states)["body_yaw"], 0.5, abs_tol=0.01), "the body has turned")
        targets.send("nonsense")
        assert told(targets)["status"] == "error"
        began_s = time.monotonic()
        for _ in range(25):
            told(states)
        assert 0.2 < time.monotonic() - began_s < 4.0


def test_an_unknown_path(client: httpx.Client, twin: Twin) -> None:
    assert client.get("/api/nothing").status_code == 404
    assert client.post(p.GOTO, content=b"{").status_code == 422
    assert client.post(p.GOTO, json={"duration": "long"}).status_code == 422


# -- the robot itself


def reachy(**options: Any) -> tuple[ReachyTwin, Clock]:
    clock = Clock()
    return ReachyTwin("reachy_mini", clock, **options), clock


def ask(twin: ReachyTwin, method: str, target: str, body: object = None) -> Any:
    data = b"" if body is None else json.dumps(body).encode()
    answer = twin.answer(Request(method, target, {}, data, b""))
    return json.loads(answer.body) if answer.status == p.OK else answer.status


def run(twin: ReachyTwin, clock: Clock, seconds: float) -> None:
    for _ in range(round(seconds / 0.05)):
        clock.now_s += 0.05
        twin.body.pass_time()


def test_any_number_is_ok_as_with_the_daemon() -> None:
    twin, clock = reachy()
    assert ask(twin, "POST", p.SET_TARGET, {"target_head_pose": {"yaw": 9.0}}) == {"status": "ok"}
    run(twin, clock, 5.0)
    assert twin.body.position[p.YAW] == pytest.approx(math.degrees(9.0))


def test_motors_without_torque_take_commands_and_do_not_move() -> None:
    twin, clock = reachy(motors="disabled")
    assert ask(twin, "POST", p.SET_TARGET, {"target_body_yaw": 0.5}) == {"status": "ok"}
    run(twin, clock, 1.0)
    assert twin.body.position[p.BODY] == 0.0
    ask(twin, "POST", f"{p.SET_MODE}enabled")
    run(twin, clock, 1.0)
    assert twin.body.position[p.BODY] == 0.0, "torque starts at the present position"
    assert ask(twin, "POST", f"{p.SET_MODE}on") == 422


def test_a_second_move_is_over_at_once_and_changes_nothing() -> None:
    twin, clock = reachy()
    ask(twin, "POST", p.GOTO, {"body_yaw": 0.5, "duration": 1.0})
    ask(twin, "POST", p.GOTO, {"body_yaw": -0.5, "duration": 1.0})
    run(twin, clock, 1.2)
    assert twin.body.position[p.BODY] == pytest.approx(math.degrees(0.5), abs=0.5)


def test_faults() -> None:
    twin, clock = reachy()
    ask(twin, "POST", p.SET_TARGET, {"target_body_yaw": 0.2})
    twin.set_fault(Fault.STUCK)
    run(twin, clock, 0.5)
    assert twin.body.position[p.BODY] == 0.0
    twin.set_fault(Fault.WRONG)
    run(twin, clock, 0.5)
    assert ask(twin, "GET", "/api/state/full")["body_yaw"] == pytest.approx(0.2 + math.radians(5.0), abs=1e-3)
    with pytest.raises(ValueError, match="Use disabled, enabled, gravity_compensation"):
        reachy(motors="on")


@pytest.mark.parametrize("battery", [None, 0.0, 71.0])
def test_the_status_has_a_charge_only_with_the_option(battery: float | None) -> None:
    """Daemon 1.13.0 reports none, neither of a Lite nor of a Wireless."""
    twin = ReachyTwin("reachy_mini", Clock(), battery=battery)
    status = json.loads(twin.answer(Request("GET", p.STATUS, {}, b"", b"")).body)
    assert status.get("battery_pct") == battery
    assert ("battery_pct" in status) == (battery is not None)


@pytest.mark.parametrize(
    ("wireless", "battery", "why"), [(False, 71.0, "a Lite has no"), (True, 101.0, "0 to 100")]
)
def test_an_impossible_battery_is_refused(wireless: bool, battery: float, why: str) -> None:
    with pytest.raises(ValueError, match=why):
        ReachyTwin("reachy_mini", Clock(), wireless=wireless, battery=battery)
