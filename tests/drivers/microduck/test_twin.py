"""Test the twin with the unmodified microduck-cli and a client on plain sockets, and the duck behind it."""

from __future__ import annotations

import contextlib
import json
import math
import os
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from typing import Any

import pytest

from strands_actors.drivers.common.codecs.json_rpc import Call
from strands_actors.drivers.common.physics.body import Commander
from strands_actors.drivers.common.twin import Fault
from strands_actors.drivers.microduck import protocol as p
from strands_actors.drivers.microduck.body import Duck
from strands_actors.drivers.microduck.robots import TABLES
from strands_actors.drivers.microduck.twin import DuckTwin
from strands_actors.testing import Twin
from tests.answers import until

CLI = "microduck-cli==0.9.7"


@pytest.fixture(scope="module")
def cli(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """Return an environment in which ``python -m microduck_cli`` runs.

    Its metadata require Python 3.12, which it does not need. Where it is not installed, it gets a separate
    folder.
    """
    environment = {**os.environ, "HOME": str(tmp_path_factory.mktemp("home"))}
    if find_spec("microduck_cli") is None:
        folder = tmp_path_factory.mktemp("cli")
        install = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--ignore-requires-python"]
        subprocess.run([*install, "--target", str(folder), CLI], check=True, timeout=300)
        environment["PYTHONPATH"] = str(folder)
    return environment


@pytest.fixture(scope="module")
def twin(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Twin]:
    with Twin("microduck", tmp_path_factory.mktemp("twin")) as process:
        yield process


def test_microduck_cli_drives_reads_and_gets_refusals(cli: dict[str, str], twin: Twin) -> None:
    def run(*words: str) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            [sys.executable, "-m", "microduck_cli", "duck", *words, "--socket", twin.port],
            capture_output=True,
            text=True,
            env=cli,
            stdin=subprocess.DEVNULL,
            timeout=60.0,
            check=False,
        )

    def told(*words: str) -> Any:
        done = run(*words, "--json")
        assert done.returncode == 0, done.stderr
        return json.loads(done.stdout.splitlines()[-1])

    assert told("health")["healthy"] is True
    assert told("version")["api_skew"] == [31, 16], "the version difference is reported, not refused"
    refused = run("do", "kick-left", "--apply")
    assert refused.returncode != 0 and "enable it first" in refused.stderr
    assert told("enable", "--apply")["result"] == {"accepted": True, "reason": "driving"}
    until(lambda: told("monitor", "--frames", "1")["policy"] == "stand", "it stands up")
    began_ns = time.monotonic_ns()
    assert told("move", "--vx", "0.2", "--duration", "1", "--apply")["intents_sent"] >= 10
    kinds = [
        one.kind for one in twin.log.entries(began_ns) if one.sender == "host" and one.kind in ("setpoint", "safe")
    ]
    assert kinds[-1] == "safe" and kinds.count("setpoint") >= 10
    seen = told("monitor", "--frames", "1")
    assert 0.05 < seen["odom"]["position"][0] < 0.5 and seen["move"]["requested"] == [0.0] * 3
    assert told("look", "--x", "1", "--y", "1", "--apply")["result"]["head"]["head_yaw"] == pytest.approx(
        0.785, abs=0.01
    )
    assert told("do", "kick-left", "--apply")["result"]["accepted"] is True
    assert told("mode")["mode"] == "walk"
    assert told("stop")["accepted"] is True
    assert told("quack")["accepted"] is True
    recorded = run("record", "--seconds", "0.5")
    sources = {json.loads(line)["source"] for line in recorded.stdout.splitlines()}
    assert {"hello", "state", "health"} <= sources


# -- a client on plain sockets


class Client:
    def __init__(self, path: str) -> None:
        self._socket = socket.socket(socket.AF_UNIX)
        self._socket.settimeout(5.0)
        self._socket.connect(path)
        self._file = self._socket.makefile("r")
        self._number = 0

    def say(self, text: str) -> None:
        self._socket.sendall(text.encode() + b"\n")

    def hear_line(self) -> str:
        return self._file.readline()

    def hear(self) -> Any:
        return json.loads(self.hear_line())

    def ask(self, method: str, **params: Any) -> Any:
        self._number += 1
        self.say(json.dumps({"jsonrpc": "2.0", "id": self._number, "method": method, "params": params}))
        while (told := self.hear()).get("id") != self._number:
            pass
        return told.get("result", told.get("error"))

    def close(self) -> None:
        self._file.close()
        self._socket.close()


@contextmanager
def client(path: str) -> Iterator[Client]:
    one = Client(path)
    try:
        yield one
    finally:
        one.close()


def test_unknown_requests_are_refused_by_name_and_nothing_is_clamped(twin: Twin) -> None:
    with client(twin.port) as one:
        one.say("nonsense")
        assert one.hear()["error"]["code"] == -32700
        one.say('{"jsonrpc": "2.0", "id": 3, "result": 1}')
        assert one.hear()["error"]["code"] == -32600
        assert one.ask("robot.fly") == {"code": -32601, "message": "unknown method 'robot.fly'"}
        assert "unknown field `x`" in one.ask(p.ENABLE, on=True, x=1)["message"]
        assert "missing field `skill`" in one.ask(p.DO)["message"]
        assert one.ask(p.MOVE, vx="fast")["code"] == -32602
        assert one.ask(p.SUBSCRIBE, hz=True)["code"] == -32602
        assert one.ask(p.POSE, z=1.0, active=False) == {"accepted": True}
        assert one.ask(p.HELLO, api_version=16)["api_version"] == 31


def test_states_have_the_requested_rate_and_a_flood_of_bytes_ends_only_its_sender(twin: Twin) -> None:
    with client(twin.port) as one, client(twin.port) as other:
        with contextlib.suppress(ConnectionError):
            other.say("x" * 70_000)
            assert other.hear_line() == ""
        assert one.ask(p.SUBSCRIBE, hz=10)["accepted"] is True
        stamps = [one.hear()["params"]["t"] for _ in range(8)]
        assert 0.4 < stamps[-1] - stamps[0] < 3.0


# -- the duck itself


class Clock:
    """A clock that the test advances."""

    def __init__(self) -> None:
        self.now_s = 0.0

    def __call__(self) -> float:
        return self.now_s


def twin_of(**options: Any) -> tuple[DuckTwin, Clock]:
    clock = Clock()
    return DuckTwin("microduck", clock, **options), clock


def ask(twin: DuckTwin, method: str, **params: Any) -> Any:
    return twin.answer(Call(method, params, 1, False))


def run(duck: Duck, clock: Clock, seconds: float) -> None:
    for _ in range(round(seconds / 0.05)):
        clock.now_s += 0.05
        duck.pass_time()


def test_a_twist_that_is_not_re_sent_ends_after_half_a_second() -> None:
    twin, clock = twin_of(enabled=True)
    ask(twin, p.MOVE, vx=0.3)
    run(twin.body, clock, 0.45)
    assert twin.body.applied == (pytest.approx(0.3, abs=0.01), 0.0, 0.0)
    assert "limited_by" not in twin.state()["move"]
    run(twin.body, clock, 0.6)
    moves = twin.state()["move"]
    assert moves["requested"] == [0.3, 0.0, 0.0] and moves["limited_by"] == ["deadman"]
    assert 0.0 < moves["applied"][0] < 0.01 and twin.body.moves == (0.0, 0.0, 0.0)
    assert 0.1 < twin.body.x_m < 0.25
    never, clock = twin_of(enabled=True, deadman_s=0)
    ask(never, p.MOVE, vx=0.3)
    run(never.body, clock, 5.0)
    assert never.body.moves[0] == pytest.approx(0.3)


def test_the_policy_and_its_limits_are_reported() -> None:
    twin, clock = twin_of()
    ask(twin, p.MOVE, vx=0.3)
    run(twin.body, clock, 0.3)
    assert twin.state()["policy"] == "held" and twin.body.applied[0] > 0.2, "it is smoothed all the same"
    assert twin.body.moves == (0.0, 0.0, 0.0) and twin.body.x_m == 0.0
    ask(twin, p.ENABLE, on=True)
    ask(twin, p.STOP)
    assert twin.state()["policy"] == "homing"
    run(twin.body, clock, 0.6)
    assert twin.state()["policy"] == "stand"
    assert ask(twin, p.DO, skill="kick_left") == {"accepted": True}
    assert "kick_left is playing" in ask(twin, p.DO, skill="kick_right")["reason"]
    assert "known: ground_pick" in ask(twin, p.DO, skill="fly")["reason"]
    ask(twin, p.MOVE, vx=0.3)
    run(twin.body, clock, 0.3)
    assert twin.state()["policy"] == "kick_left" and twin.body.moves == (0.0, 0.0, 0.0)
    twin.body.fallen = True
    assert twin.state()["move"]["limited_by"] == ["fallen"] and twin.state()["safety"]["limp"]
    twin.body.fallen = False
    ask(twin, p.HEAD, head_yaw=4.0)
    run(twin.body, clock, 2.0)
    assert twin.state()["move"]["limited_by"] == ["deadman", "range"]
    assert twin.state()["head"][2] == 2.967, "it is at its mechanical stop"
    ask(twin, p.RELAX)
    assert twin.state()["policy"] == "held"
    assert "enable it first" in ask(twin, p.DO, skill="kick_left")["reason"]


def test_it_walks_where_it_looks_and_turns_to_the_left() -> None:
    twin, clock = twin_of(enabled=True, deadman_s=0)
    ask(twin, p.MOVE, vyaw=1.0)
    run(twin.body, clock, math.pi / 2 + 0.1)
    ask(twin, p.MOVE, vx=0.3)
    run(twin.body, clock, 1.0)
    assert twin.body.y_m > 0.15 and twin.body.y_m > 2 * abs(twin.body.x_m)


def test_an_older_robotd_has_fewer_requests() -> None:
    twin, _ = twin_of(api_version=16)
    assert ask(twin, p.HELLO, api_version=31)["api_version"] == 16
    assert "kick_left" in ask(twin, p.SUBSCRIBE) and "skills" not in ask(twin, p.SUBSCRIBE)
    with pytest.raises(Exception, match=r"unknown method 'robot\.policies'"):
        ask(twin, p.POLICIES)


def test_its_legs_always_keep_its_feet_flat_and_within_reach() -> None:
    table = TABLES.table("microduck")
    twin, clock = twin_of(enabled=True, deadman_s=0)
    for vx, z in ((0.3, 0.0), (-0.3, -0.025), (0.0, 0.01)):
        ask(twin, p.MOVE, vx=vx)
        ask(twin, p.POSE, z=z)
        for _ in range(40):
            run(twin.body, clock, 0.05)
            row = dict(zip(table["joints"], twin.body.joints_rad, strict=True))
            for side in ("left", "right"):
                pitch, knee, ankle = (row[f"{side}_{joint}"] for joint in ("hip_pitch", "knee", "ankle"))
                assert pitch + knee + ankle == pytest.approx(0.0, abs=1e-9)
                assert all(abs(angle) <= 1.571 for angle in (pitch, knee, ankle))
    spec = twin.body.spec
    assert len(twin.body.pose()) == spec.compile().nq == 6 + 15


def test_the_simulation_does_not_walk_while_the_wire_does() -> None:
    twin, clock = twin_of(enabled=True)
    body = twin.body
    ask(twin, p.MOVE, vx=0.2)
    body.energise(True)
    body.set_targets((0.0,) * 12)
    assert set(body.commanders) == {Commander.WIRE} and body.requested == (0.2, 0.0, 0.0)
    run(body, clock, 0.7)
    body.energise(True)
    body.set_targets((0.1, 0.0, 0.0, *(0.0,) * 9))
    assert set(body.commanders) == {Commander.SIM} and body.requested[0] == 0.1
    body.hold()
    assert body.requested == (0.0, 0.0, 0.0)


def test_a_robot_without_supply_forgets_and_one_that_is_stuck_stays() -> None:
    twin, clock = twin_of(enabled=True, deadman_s=0)
    ask(twin, p.MOVE, vx=0.2)
    run(twin.body, clock, 0.5)
    twin.set_fault(Fault.STUCK)
    before = twin.state()
    run(twin.body, clock, 1.0)
    assert twin.state() == before
    twin.set_fault(Fault.OFF)
    assert twin.body.requested == (0.0, 0.0, 0.0) and twin.body.x_m == 0.0
    with pytest.raises(ValueError, match="Use walk, roller"):
        DuckTwin("microduck", mode="fly")


def test_a_seated_duck_may_rise_at_once_and_rises_to_the_end() -> None:
    twin, clock = twin_of(enabled=True)
    run(twin.body, clock, 1.0)
    assert ask(twin, p.DO, skill=p.SIT_TOGGLE) == {"accepted": True} and twin.state()["policy"] == "sit"
    assert ask(twin, p.DO, skill=p.SIT_TOGGLE) == {"accepted": True} and twin.state()["policy"] == "rise"
    assert ask(twin, p.DO, skill=p.SIT_TOGGLE)["reason"] == "already standing up"
    run(twin.body, clock, 2.0)
    assert twin.state()["policy"] == "stand" and not twin.body.sitting
