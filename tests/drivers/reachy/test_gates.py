"""Test what the driver accepts and refuses: options, addresses, the envelope, durations, services."""

from __future__ import annotations

import math
from typing import Any

import pytest

from strands_actors.contract.driver import Candidate, GateState
from strands_actors.contract.wire import Observation
from strands_actors.drivers.reachy import protocol as p
from strands_actors.drivers.reachy.driver import Reachy
from strands_actors.drivers.reachy.gates import direction
from strands_actors.kernel.messages import Refused

NOW_NS = 10**12
REST = (0.0,) * 9
ASLEEP = (31.0, 0.0, 0.0, -15.0, 1.0, -50.0, 0.0, 175.0, -175.0)


def driver(port: str = "192.0.2.1", **options: Any) -> Reachy:
    return Reachy("reachy_mini", port, Reachy.resolve("reachy_mini", options))


def seen(
    here: tuple[float, ...] = REST, age_ns: int = 0, mode: str = "enabled", ignored: bool = False
) -> Observation:
    sensors: dict[str, tuple[float, ...]] = {
        "motor_mode": (float(p.MODES.index(mode)),),
        "ignored": (float(ignored),),
    }
    return Observation(NOW_NS - age_ns, here, (NOW_NS - age_ns,) * 9, sensors=sensors)


def state(here: tuple[float, ...] = REST, target: tuple[float, ...] | None = None, age_ns: int = 0) -> GateState:
    return GateState(NOW_NS, seen(here, age_ns), target or here, NOW_NS, False)


def answer(action: dict[str, Any], at: GateState | None = None) -> Candidate | Refused:
    reachy, at = driver(), at or state()
    candidate = reachy.parse(action, at)
    if isinstance(candidate, Candidate):
        for gate in reachy.gates:
            if (refusal := gate(candidate, at)) is not None:
                return refusal
    return candidate


def refused(action: dict[str, Any], at: GateState | None = None) -> Refused:
    found = answer(action, at)
    assert isinstance(found, Refused), found
    return found


def accepted(action: dict[str, Any], at: GateState | None = None) -> Candidate:
    found = answer(action, at)
    assert isinstance(found, Candidate), found
    return found


@pytest.mark.parametrize(
    ("key", "limit"),
    [
        *((f"head_{angle}", 40.0) for angle in ("pitch", "roll")),
        ("head_yaw", 65.0),
        *((f"head_{axis}", 25.0) for axis in "xyz"),
        ("body_yaw", 65.0),
        ("antenna_left", 150.0),
        ("antenna_right", 150.0),
    ],
)
def test_saf_014_the_envelope(key: str, limit: float) -> None:
    for sign in (1.0, -1.0):
        accepted({key: sign * limit})
        assert refused({key: sign * (limit + 0.2)}).code in ("past_travel", "twisted")


def test_saf_014_head_and_body_turn_together_up_to_their_own_limits() -> None:
    accepted({"head_yaw": 180.0, "body_yaw": 120.0})
    accepted({"head_yaw": 100.0, "body_yaw": 160.0})
    assert refused({"head_yaw": 180.5, "body_yaw": 120.0}).code == "past_travel"
    assert refused({"head_yaw": 100.0, "body_yaw": 160.5}).code == "past_travel"
    assert refused({"head_yaw": math.degrees(9.0)}).limit == "-180.0..180.0", "the daemon itself would answer ok"


def test_saf_014_a_head_turned_too_far_from_the_body_names_both_and_the_limit() -> None:
    refusal = refused({"body_yaw": -30.0}, state((0.0, 0.0, 36.0, *REST[3:])))
    assert (refusal.code, refusal.limit) == ("twisted", "-65..65")
    assert "head_yaw 36.0 and body_yaw -30.0 are 66.0 deg apart" in refusal.reason
    accepted({"antenna_left": 5.0}, state((0.0, 0.0, 80.0, *REST[3:])))  # it turns neither


def test_saf_014_a_sleeping_head_needs_wake_up_or_a_whole_target() -> None:
    refusal = refused({"head_yaw": 5.0}, state(ASLEEP))
    assert refusal.code == "asleep" and "head_z would stay at -50.0" in refusal.reason
    accepted({"antenna_left": 100.0, "antenna_right": -100.0}, state(ASLEEP))
    accepted(dict.fromkeys(driver().axes, 0.0), state(ASLEEP))


@pytest.mark.parametrize("value", [math.nan, math.inf, "far", True, None])
def test_saf_014_a_value_that_is_not_a_finite_number_is_refused(value: object) -> None:
    assert refused({"head_yaw": value}).code == "not_finite"
    assert refused({"look_x": value, "look_y": 0.0, "look_z": 0.0}).code == "not_finite"
    if value is not None:
        assert refused({"head_yaw": 1.0, "duration": value}).code == "not_finite"


@pytest.mark.parametrize("duration", [0.0, 0.09, 10.1, -1.0])
def test_saf_014_a_duration_past_its_limits(duration: float) -> None:
    refusal = refused({"head_yaw": 1.0, "duration": duration})
    assert (refusal.code, refusal.limit) == ("duration", "0.1..10 s")


def test_saf_014_unknown_keys_are_refused_with_all_known_ones() -> None:
    assert "duration or look_x, look_y, look_z beside them" in refused({"interpolation": 1.0}).remedy
    assert refused({"duration": 1.0}).code == "empty"
    assert refused({}).code == "empty"


def test_saf_014_a_move_that_is_too_quick_is_refused_with_the_shortest_there_is() -> None:
    refusal = refused({"antenna_left": 120.0, "duration": 0.4})
    assert (refusal.code, refusal.limit) == ("too_fast", "0.5 s")
    accepted({"antenna_left": 120.0, "duration": 0.5})
    far = refused({"head_x": 1.0, "duration": 0.1}, state((0.0, 0.0, 60.0, *REST[3:]), REST))
    assert far.code == "too_fast" and "head_yaw" in far.reason, (
        "the move counts from the present position, not from the last target"
    )


def test_small_steps_are_sent_at_once_and_large_ones_take_time() -> None:
    assert accepted({"head_yaw": 7.0}).values[9] == 0.0
    assert accepted({"head_yaw": 7.5}).values[9] == 0.1
    assert accepted({"head_yaw": 60.0}).values[9] == pytest.approx(0.5)
    on_its_way = state((0.0, 0.0, 10.0, *REST[3:]), (0.0, 0.0, 60.0, *REST[3:], 5.0))
    assert accepted({"head_yaw": 61.0}, on_its_way).values[9] > 0.4, "the rest of the last move counts as well"


def test_joints_that_are_not_named_keep_their_targets() -> None:
    candidate = accepted({"head_roll": 3.0}, state((1.0,) * 9, (2.0,) * 9))
    assert candidate.values[:9] == (2.0, 3.0, *(2.0,) * 7) and candidate.named == (1,)


@pytest.mark.parametrize(
    ("point", "pitch", "yaw"),
    [((1.0, 0.0, 0.0), 0.0, 0.0), ((1.0, 1.0, 0.0), 0.0, 45.0), ((1.0, 0.0, 0.5), -26.565, 0.0)],
)
def test_a_point_to_look_at(point: tuple[float, float, float], pitch: float, yaw: float) -> None:
    values = accepted(dict(zip(("look_x", "look_y", "look_z"), point, strict=True))).values
    assert values[p.PITCH] == pytest.approx(pitch, abs=1e-3) and values[p.YAW] == pytest.approx(yaw)
    assert direction(*point) == (values[p.PITCH], values[p.YAW])


def test_saf_014_points_that_cannot_be_looked_at() -> None:
    assert refused({"look_x": -1.0, "look_y": 0.1, "look_z": 0.0}).code == "twisted"
    assert refused({"look_x": 0.1, "look_y": 0.0, "look_z": 1.0}).code == "past_travel"
    assert refused({"look_x": 0.01, "look_y": 0.0, "look_z": 0.0}).code == "too_near"
    assert refused({"look_x": 1.0, "look_y": 0.0}).code == "not_finite"
    both = refused({"look_x": 1.0, "look_y": 0.0, "look_z": 0.0, "head_yaw.pos": 1.0})
    assert both.code == "both_spellings"


def test_saf_012_nothing_is_commanded_without_a_frame() -> None:
    refusal = refused({"head_yaw": 1.0}, state(age_ns=700_000_000))
    assert (refusal.code, refusal.offered, refusal.limit) == ("stale", "for 700 ms", "500 ms")


@pytest.mark.parametrize("mode", ["disabled", "gravity_compensation"])
def test_saf_014_motors_without_torque_are_refused(mode: str) -> None:
    motors_on, heeded = (condition.check for condition in driver().conditions)
    refusal = motors_on(seen(mode=mode), NOW_NS)
    assert refusal is not None and refusal.code == "motors_off" and 'motors(mode="enabled")' in refusal.remedy
    assert motors_on(Observation(NOW_NS, REST, (NOW_NS,) * 9), NOW_NS) is not None, "the motors' mode is unknown"
    assert motors_on(seen(), NOW_NS) is None and heeded(seen(), NOW_NS) is None
    ignored = heeded(seen(ignored=True), NOW_NS)
    assert ignored is not None and "another client" in ignored.reason


def test_saf_014_while_another_clients_move_runs_none_of_ours_begins() -> None:
    at = state()
    at.observation.sensors["others_move"] = (1.0,)
    assert refused({"head_yaw": 40.0}, at).code == "ignored"
    assert all(condition.check(at.observation, NOW_NS) is None for condition in driver().conditions), (
        "a refused command does not end the other move"
    )


@pytest.mark.parametrize(
    ("service", "arguments", "limit"),
    [
        ("express", {"move": "../../x"}, "1..128 letters"),
        ("express", {"move": "a b"}, "1..128 letters"),
        ("express", {}, "1..128 letters"),
        ("express", {"move": "x" * 129}, "1..128 letters"),
        ("express", {"move": "yes1", "dataset": "a/b/c"}, "owner/name"),
        ("list_moves", {"dataset": "../etc"}, "1..128 letters"),
        ("motors", {"mode": "on"}, "disabled, enabled, gravity_compensation"),
        ("play_sound", {"file": "/etc/passwd"}, "1..128 letters"),
        ("set_volume", {"volume": 101}, "1..100"),
        ("track_face", {"enabled": "yes"}, "true or false"),
        ("track_face", {"weight": math.nan}, "0..1"),
        ("say", {"text": "hi"}, "tts_url="),
    ],
)
def test_saf_014_arguments_that_a_service_does_not_take(
    service: str, arguments: dict[str, Any], limit: str
) -> None:
    refusal = driver().check_service(service, arguments)
    assert refusal is not None and refusal.limit.startswith(limit)


@pytest.mark.parametrize("text", ["", "x" * 501, 3])
def test_a_text_that_cannot_be_spoken(text: object) -> None:
    speaks = driver(tts_url="http://192.0.2.2:5000/tts")
    refusal = speaks.check_service("say", {"text": text})
    assert refusal is not None and refusal.code == "bad_argument"
    assert speaks.check_service("say", {"text": "hello"}) is None


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"api_port": 0}, "api_port is 0"),
        ({"media_port": 70000}, "media_port is 70000"),
        ({"tts_url": "https://tts"}, "Give an address that begins with http://"),
        ({"tts": "x"}, "'tts' -> 'tts_url'?"),
    ],
)
def test_invalid_options_are_refused_with_valid_ones(options: dict[str, Any], says: str) -> None:
    with pytest.raises((TypeError, ValueError)) as refusal:
        driver(**options)
    assert says in str(refusal.value)


@pytest.mark.parametrize(
    ("port", "options", "addresses"),
    [
        ("192.0.2.1", {}, (("192.0.2.1", 8000),)),
        ("http://reachy-mini.local:81/", {}, (("reachy-mini.local", 81),)),
        ("192.0.2.1", {"api_port": 9000}, (("192.0.2.1", 9000),)),
        ("", {}, (("localhost", 8000), ("reachy-mini.local", 8000))),
        ("", {"api_port": 9000}, (("localhost", 9000), ("reachy-mini.local", 9000))),
    ],
)
def test_where_the_daemon_may_be(
    port: str, options: dict[str, Any], addresses: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("REACHY_HOST", raising=False)
    monkeypatch.delenv("REACHY_PORT", raising=False)
    assert driver(port, **options).config.addresses() == addresses


def test_the_environment_gives_the_address(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("REACHY_HOST", "192.0.2.9")
    monkeypatch.setenv("REACHY_PORT", "8123")
    assert driver("").config.addresses() == (("192.0.2.9", 8123),)
    assert driver("192.0.2.1").config.addresses() == (("192.0.2.1", 8000),), (
        "port= has priority over the environment"
    )
    resolved = Reachy.resolve("reachy_mini", {})
    monkeypatch.setenv("REACHY_HOST", "192.0.2.10")
    assert Reachy("reachy_mini", "", resolved).config.addresses() == (("192.0.2.9", 8123),), (
        "the environment is read once"
    )
    monkeypatch.setenv("REACHY_PORT", "many")
    with pytest.raises(ValueError, match="REACHY_PORT is 'many'"):
        driver("")


@pytest.mark.parametrize("port", ["https://192.0.2.1", "http://u:p@192.0.2.1", "http://192.0.2.1/api", "/dev/tty1"])
def test_saf_014_an_invalid_address_of_the_service_is_refused(port: str) -> None:
    with pytest.raises(ValueError, match="https is not supported"):
        driver(port).config.addresses()


VERBS = {
    *(
        "sensors",
        "get_state",
        "status",
        "stop",
        "look",
        "look_at",
        "antennas",
        "body_turn",
        "home",
        "wake",
        "sleep",
    ),
    *("express", "list_moves", "motors", "say", "play_sound", "volume", "set_volume", "track_face"),
    *("tracking_status", "camera", "record_audio", "turn_to_sound", "turn_to_sound_status"),
}


def test_every_verb_of_the_vendors_client_exists_or_is_refused() -> None:
    verbs = {verb.name: verb for verb in Reachy.TOOL_VERBS}
    assert set(verbs) == {*VERBS, "move_to", "goto", "wake_up", "goto_sleep", "play_move"} and len(VERBS) == 24
    assert {name for name, verb in verbs.items() if verb.does == "service"} == set(Reachy.SERVICES)
    refusal = driver().check_service("record_audio", {"duration": 3.0})
    assert refusal is not None and refusal.code == "no_recording" and "camera()" in refusal.remedy
