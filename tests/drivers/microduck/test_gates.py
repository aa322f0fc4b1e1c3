"""Test which commands are refused before they reach robotd, and the values of accepted actions."""

from __future__ import annotations

import math
from typing import Any

import pytest

from strands_actors.contract.driver import Candidate, GateState, Live
from strands_actors.contract.wire import Observation
from strands_actors.drivers.microduck.config import Endpoint, endpoint_of_environment, parse_port
from strands_actors.drivers.microduck.driver import Microduck
from strands_actors.drivers.microduck.gates import HEADS, MOUTHS, MOVES, POSES, UNTIL
from strands_actors.kernel.messages import Refused

NOW_NS = 10**12
SENSORS = {"driven": (1.0,), "mode": (0.0,), "sitting": (0.0,)}


def duck(**options: Any) -> Microduck:
    return Microduck("microduck", "/run/robotd.sock", options)


def answer(
    action: dict[str, Any],
    *,
    sensors: dict[str, Any] | None = None,
    age_ns: int = 0,
    target: dict[str, float] | None = None,
    live: Live | None = None,
) -> Candidate | Refused:
    """Judge an action as the gate does."""
    driver = duck()
    row = tuple((target or {}).get(key, 0.0) for key in driver.axes)
    t_ns = NOW_NS - age_ns
    seen = Observation(t_ns, row, (t_ns,) * len(row), sensors={**SENSORS, **(sensors or {})})
    known = GateState(NOW_NS, seen, row, t_ns, False, live=live)
    for condition in driver.conditions:
        refusal = condition.check(seen, NOW_NS)
        if refusal is not None:
            return refusal
    candidate = driver.parse(action, known)
    if isinstance(candidate, Refused):
        return candidate
    return next((no for gate in driver.gates if (no := gate(candidate, known)) is not None), candidate)


def accepted(action: dict[str, Any], **known: Any) -> Candidate:
    candidate = answer(action, **known)
    assert isinstance(candidate, Candidate), candidate
    return candidate


def refused(action: dict[str, Any], **known: Any) -> Refused:
    refusal = answer(action, **known)
    assert isinstance(refusal, Refused), refusal
    assert refusal.remedy and refusal.reason
    return refusal


def test_a_twist_lasts_a_second_or_its_duration() -> None:
    usual = accepted({"vx": 0.2, "vyaw": 0.5})
    assert usual.until_ns == NOW_NS + 10**9
    assert usual.values[:3] == (0.2, 0.0, 0.5)
    assert (usual.values[MOVES], usual.values[HEADS], usual.values[UNTIL]) == (1.0, 0.0, 1001.0)
    assert accepted({"vx": 0.2, "duration": 0.1}).until_ns == NOW_NS + 10**8
    assert accepted({"vx": 0.2, "duration": 10}).until_ns == NOW_NS + 10**10
    for bad in (0.09, 10.1, 0, -1, math.nan, math.inf, "long", None, True, [1.0]):
        code = "duration" if bad is not None else ""
        if code:
            assert refused({"vx": 0.2, "duration": bad}).code == code
    assert refused({"head_yaw": 0.2, "duration": 1.0}).code == "duration"


@pytest.mark.parametrize(
    ("action", "mode", "said"),
    [
        ({"vx": 0.5}, 0, "vx=0.5 m/s is over 0.3 for walk"),
        ({"vx": -0.31}, 0, "vx=-0.31 m/s is over 0.3 for walk"),
        ({"vy": 0.31}, 0, "vy=0.31 m/s is over 0.3 for walk"),
        ({"vyaw": -1.6}, 0, "vyaw=-1.6 rad/s is over 1.5 for walk"),
        ({"vx": 0.25, "vy": 0.25}, 0, "vx and vy are 0.354 m/s, over 0.3 for walk"),
        ({"vx": 0.61}, 1, "vx=0.61 m/s is over 0.6 for roller"),
        ({"vx": -0.51}, 1, "vx=-0.51 m/s is over 0.5 for roller"),
        ({"vy": 0.01}, 1, "vy=0.01 m/s is over 0 for roller"),
        ({"vyaw": 0.31}, 1, "vyaw=0.31 rad/s is over 0.3 for roller"),
        ({"vx": 0.1}, -1, "the drive mode is unknown"),
        ({"vx": 0.1}, 7, "the drive mode is unknown"),
    ],
)
def test_a_twist_past_its_mode_is_refused(action: dict[str, Any], mode: int, said: str) -> None:
    refusal = refused(action, sensors={"mode": (float(mode),)})
    assert said in refusal.reason


def test_a_twist_at_its_limit_and_a_zero_in_any_mode_are_accepted() -> None:
    accepted({"vx": 0.3})
    accepted({"vx": 0.18, "vy": 0.24, "vyaw": 1.5})
    accepted({"vx": 0.6, "vyaw": 0.3}, sensors={"mode": (1.0,)})
    accepted({"vx": -0.5}, sensors={"mode": (1.0,)})
    accepted({"vx": 0.0}, sensors={"mode": (-1.0,)})
    accepted({"vx": 0.0}, sensors={"sitting": (1.0,)})


@pytest.mark.parametrize(
    ("action", "key"),
    [
        ({"z": 0.011}, "z"),
        ({"z": -0.026}, "z"),
        ({"roll": 0.27}, "roll"),
        ({"pitch": -0.27}, "pitch"),
        ({"open": 1.01}, "open"),
        ({"open": -0.01}, "open"),
        ({"neck_pitch": 1.05}, "neck_pitch"),
        ({"head_yaw": -3.0}, "head_yaw"),
        ({"head_roll": 0.44}, "head_roll"),
    ],
)
def test_a_value_out_of_range_is_refused_by_name(action: dict[str, Any], key: str) -> None:
    refusal = refused(action)
    assert refusal.code == "past_travel" and f"{key} " in refusal.reason


def test_joints_and_skills_are_refused_with_their_replacement() -> None:
    for key in ("left_knee", "left_knee.pos", "wheel", ""):
        refusal = refused({key: 0.1})
        assert refusal.code == "unknown_joint" and "robotd accepts no joint targets" in refusal.reason
        assert "head (" in refusal.remedy and "do(skill" in refusal.remedy
    assert "call do(skill='kick_left')" in refused({"skill": "kick_left"}).remedy
    assert refused({"vx": 0.1, "skill": "kick_left"}).code == "skill"
    assert refused({}).code == "empty"
    assert refused({"duration": 1.0}).code in ("empty", "duration")


def test_an_intent_is_sent_whole_and_others_are_not_sent() -> None:
    target = {"head_yaw": 0.4, "z": -0.01, "active": 1.0, "open": 0.5}
    head = accepted({"head_pitch": 0.1}, target=target)
    assert head.values[3:7] == (0.0, 0.1, 0.4, 0.0)
    assert [head.values[at] for at in (MOVES, HEADS, POSES, MOUTHS)] == [0.0, 1.0, 0.0, 0.0]
    assert head.until_ns == 0, "the head keeps its position without a time limit"
    pose = accepted({"roll": 0.1}, target=target)
    assert pose.values[7:11] == (-0.01, 0.1, 0.0, 1.0) and pose.values[POSES] == 1.0
    assert accepted({"active": False}, target=target).values[10] == 0.0
    assert accepted({"active": 1}, target=target).values[10] == 1.0
    assert refused({"active": False, "z": 0.0}).code == "both"
    for bad in (0.5, "yes", None, math.nan, 2):
        assert refused({"active": bad}).code == "not_finite"


def test_a_head_keeps_the_twist_that_lives_as_long_as_it_was_promised() -> None:
    live = accepted({"head_yaw": 0.1}, target={"vx": 0.2}, live=Live(NOW_NS + 5 * 10**8))
    assert live.values[0] == 0.2 and live.until_ns == NOW_NS + 5 * 10**8
    assert live.values[MOVES] == 0.0, "the twist is not sent again"
    over = accepted({"head_yaw": 0.1}, target={"vx": 0.2}, live=Live(NOW_NS - 1))
    assert over.values[0] == 0.0 and over.until_ns == 0


def test_saf_012_a_duck_that_is_not_ready_is_refused() -> None:
    assert refused({"vx": 0.1}, age_ns=6 * 10**8).code == "stale"
    assert refused({"vx": 0.1}, sensors={"driven": (0.0,)}).code == "not_driven"
    assert refused({"vx": 0.1}, sensors={"fallen": (1.0,)}).code == "fallen"
    assert refused({"vx": 0.1}, sensors={"limp": (1.0,)}).code == "limp"
    assert refused({"vx": 0.1}, sensors={"picked_up": (1.0,)}).code == "picked_up"
    assert refused({"vx": 0.1}, sensors={"sitting": (1.0,)}).code == "seated"
    accepted({"head_yaw": 0.1}, sensors={"sitting": (1.0,)})


@pytest.mark.parametrize(
    ("service", "arguments", "said"),
    [
        ("relax", {}, "confirm=True"),
        ("relax", {"confirm": 1}, "confirm=True"),
        ("init", {"confirm": "true"}, "confirm=True"),
        ("reboot_motors", {"ids": "20"}, "confirm=True"),
        ("reboot_motors", {"ids": "20, 99", "confirm": True}, "some of 20"),
        ("reboot_motors", {"ids": "all", "confirm": True}, "some of 20"),
        ("reboot_motors", {"ids": 20.5, "confirm": True}, "some of 20"),
        ("do", {}, "the name of a skill"),
        ("do", {"skill": "../x"}, "the name of a skill"),
        ("do", {"skill": 3.0}, "the name of a skill"),
        ("look_at", {"x": math.nan}, "-10..10"),
        ("look_at", {"x": 11.0}, "-10..10"),
        ("look_at", {"neck_pitch": 1.1}, "-1.571..1.047"),
        ("play_sound", {"tag": "wheee"}, "wheee has to be held"),
        ("theremin", {"active": "yes"}, "true or false"),
        ("set_mode", {"mode": "fly"}, "walk, roller"),
        ("load_policy", {"slot": "tail"}, "sitstand"),
        ("load_policy", {"slot": "walk", "path": "here.onnx"}, "absolute path"),
        ("do", {"speed": 1}, "it takes skill"),
        ("fly", {}, "it has enable"),
    ],
)
def test_saf_014_services_refuse_invalid_arguments(service: str, arguments: dict[str, Any], said: str) -> None:
    refusal = duck().check_service(service, arguments)
    assert refusal is not None and said in refusal.remedy


@pytest.mark.parametrize(
    ("service", "arguments"),
    [
        ("relax", {"confirm": True}),
        ("reboot_motors", {"confirm": True}),
        ("reboot_motors", {"ids": "[20, 21]", "confirm": True}),
        ("reboot_motors", {"ids": 34, "confirm": True}),
        ("do", {"skill": "polite-bow"}),
        ("look_at", {"x": 1.0}),
        ("load_policy", {"slot": "walk"}),
        ("stand", {}),
    ],
)
def test_services_accept_their_declared_arguments(service: str, arguments: dict[str, Any]) -> None:
    assert duck().check_service(service, arguments) is None


@pytest.mark.parametrize(
    ("port", "endpoint"),
    [
        ("/run/robotd.sock", Endpoint("/run/robotd.sock")),
        ("unix:///tmp/duck.sock", Endpoint("/tmp/duck.sock")),
        ("ssh://duck.local", Endpoint("/run/robotd.sock", "radxa@duck.local")),
        ("ssh://me@192.0.2.7:2222", Endpoint("/run/robotd.sock", "me@192.0.2.7", 2222)),
        ("ssh://[2001:db8::7]", Endpoint("/run/robotd.sock", "radxa@2001:db8::7")),
    ],
)
def test_a_port_is_a_path_or_a_host(port: str, endpoint: Endpoint) -> None:
    assert parse_port(port) == endpoint


@pytest.mark.parametrize(
    "port",
    ["robotd.sock", "ssh://", "ssh://-oProxyCommand=x", "ssh://a b", "ssh://a@-x", "ssh://a:99999", "tcp://x", ""],
)
def test_a_port_of_another_form_is_refused(port: str) -> None:
    with pytest.raises(ValueError, match="ssh://"):
        parse_port(port)


def test_the_environment_gives_the_address_of_a_duck(monkeypatch: pytest.MonkeyPatch) -> None:
    assert endpoint_of_environment({}) == "/run/robotd.sock"
    assert endpoint_of_environment({"MICRODUCK_HOST": "duck.local"}) == "ssh://duck.local"
    assert endpoint_of_environment({"MICRODUCK_HOST": "a@duck", "MICRODUCK_SOCKET": "/tmp/s"}) == "/tmp/s"
    monkeypatch.setenv("MICRODUCK_HOST", "duck.local")
    monkeypatch.setenv("DUCK_BOARD_USER", "me")
    driver = Microduck("microduck", "", {})
    assert driver.config.endpoint() == Endpoint("/run/robotd.sock", "me@duck.local")
    assert driver.timing.open_s > duck().timing.open_s, "ssh has to connect in this process and in the root"
    assert Microduck("microduck", "/tmp/s", {}).config.endpoint() == Endpoint("/tmp/s")
    monkeypatch.setenv("MICRODUCK_HOST", "-oProxyCommand=x")
    with pytest.raises(ValueError, match="MICRODUCK_HOST"):
        Microduck.resolve("microduck", {})


def test_options_are_checked_and_lengthen_the_timeouts() -> None:
    slow = duck(timeout=30.0, subscribe_hz=25, api_version=16)
    assert slow.timing.open_s > 30.0 and slow.SERVICES["health"].within_s > 30.0
    assert (slow.config.subscribe_hz, slow.config.api_version) == (25, 16)
    for bad in ({"timeout": 0}, {"subscribe_hz": 5}, {"subscribe_hz": 10.5}, {"api_version": 0}):
        with pytest.raises(ValueError, match=next(iter(bad))):
            duck(**bad)
    with pytest.raises(TypeError, match="api_version"):
        duck(api_versoin=16)
