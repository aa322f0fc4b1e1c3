"""Test what the driver accepts and refuses: options, address, twist and lamp, and the lifetime of each."""

from __future__ import annotations

import math
from typing import Any

import pytest

from strands_actors.contract.driver import Candidate, GateState, Live
from strands_actors.contract.wire import Observation
from strands_actors.drivers.common.kit.velocity_base import LIFETIME_S
from strands_actors.drivers.earthrover.driver import EarthRover
from strands_actors.kernel.messages import Refused

NOW_NS = 10**12
REST = (0.0, 0.0, 0.0)


def driver(**options: Any) -> EarthRover:
    return EarthRover("earthrover", "192.0.2.1", EarthRover.resolve("earthrover", options))


def state(target: tuple[float, ...] = REST, live: Live | None = None, age_ns: int = 0) -> GateState:
    seen = Observation(NOW_NS - age_ns, REST, (NOW_NS - age_ns,) * 3)
    return GateState(NOW_NS, seen, target, NOW_NS, False, 0.0, live)


def answer(action: dict[str, Any], at: GateState | None = None) -> Candidate | Refused:
    rover, at = driver(), at or state()
    candidate = rover.parse(action, at)
    if isinstance(candidate, Candidate):
        for gate in rover.gates:
            if (refusal := gate(candidate, at)) is not None:
                return refusal
    return candidate


def refused(action: dict[str, Any], at: GateState | None = None) -> Refused:
    found = answer(action, at)
    assert isinstance(found, Refused), found
    return found


@pytest.mark.parametrize("key", ["linear", "angular", "lamp"])
@pytest.mark.parametrize("value", [1.01, -1.01, 1e9])
def test_saf_014_beyond_full_speed_is_refused(key: str, value: float) -> None:
    assert refused({key: value}).limit == "-1.0000..1.0000"
    assert isinstance(answer({key: math.copysign(1.0, value)}), Candidate)


@pytest.mark.parametrize("value", [math.nan, math.inf, "fast", True, None])
def test_saf_014_a_value_that_is_not_a_finite_number_is_refused(value: object) -> None:
    assert refused({"linear": value}).code == "not_finite"


def test_saf_014_an_unknown_channel_is_refused_with_the_known_ones() -> None:
    assert "Use linear, angular, lamp" in refused({"vx": 0.1}).text


def test_saf_012_nothing_is_commanded_without_data() -> None:
    refusal = refused({"linear": 0.1}, state(age_ns=2_100_000_000))
    assert (refusal.code, refusal.limit) == ("stale", "2000 ms")
    assert isinstance(answer({"linear": 0.1}, state(age_ns=1_100_000_000)), Candidate), (
        "a report of this age is still accepted"
    )


def test_axes_that_are_not_named_rest_and_the_lamp_stays() -> None:
    moving = state((0.5, 0.2, 1.0), Live(NOW_NS + 1))
    assert answer({"angular": -0.3}, moving) == Candidate((0.0, -0.3, 1.0), (1,))


def test_saf_001_a_lamp_command_keeps_the_twist_and_its_end() -> None:
    until_ns = NOW_NS + 10_000_000
    assert answer({"lamp": 1.0}, state((0.5, 0.2, 0.0), Live(until_ns))) == Candidate(
        (0.5, 0.2, 1.0), (2,), until_ns
    )


@pytest.mark.parametrize("until_ns", [NOW_NS, NOW_NS - 1])
def test_saf_001_the_lamp_does_not_bring_back_a_twist_that_has_ended(until_ns: int) -> None:
    assert answer({"lamp": 1.0}, state((0.5, 0.2, 0.0), Live(until_ns))) == Candidate((0.0, 0.0, 1.0), (2,))


def test_a_lamp_command_at_rest_has_its_own_lifetime() -> None:
    assert answer({"lamp": 1.0}, state(REST, Live(NOW_NS + 5))) == Candidate((0.0, 0.0, 1.0), (2,))


def test_commands_live_as_long_as_a_bases_may() -> None:
    assert (driver().timing.stream_ttl_s, driver().timing.oneshot_ttl_s) == (LIFETIME_S, LIFETIME_S)


def test_the_turn_sign_is_the_wires() -> None:
    signs = [[axis.sign for axis in driver(turn_sign=sign).table] for sign in (1.0, -1.0)]
    assert signs == [[1.0, 1.0, 1.0], [1.0, -1.0, 1.0]]


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"turn_sign": 0.5}, "turn_sign is 0.5. Give 1.0, or -1.0"),
        ({"turn_sign": 2.0}, "turn_sign is 2.0"),
        ({"timeout_s": 0}, "timeout_s is 0"),
        ({"timeout_s": math.nan}, "timeout_s is nan"),
        ({"timeout": 3.0}, "'timeout' -> 'timeout_s'?"),
    ],
)
def test_invalid_options_are_refused_with_valid_ones(options: dict[str, Any], says: str) -> None:
    with pytest.raises((TypeError, ValueError)) as refusal:
        driver(**options)
    assert says in str(refusal.value)


def test_a_timeout_bounds_how_long_opening_takes() -> None:
    assert driver(timeout_s=20.0).timing.open_s > 20.0


@pytest.mark.parametrize(
    ("port", "address"),
    [
        ("192.0.2.1", ("192.0.2.1", 8000)),
        ("http://localhost:8000", ("localhost", 8000)),
        ("http://192.0.2.1:81/", ("192.0.2.1", 81)),
    ],
)
def test_an_address(port: str, address: tuple[str, int]) -> None:
    assert EarthRover("earthrover", port, {}).config.address() == address


@pytest.mark.parametrize(
    "port", ["https://192.0.2.1", "http://u:p@192.0.2.1", "http://192.0.2.1/sdk", "unix:///x", "/dev/ttyACM0", ""]
)
def test_saf_014_an_invalid_address_of_the_service_is_refused(port: str) -> None:
    with pytest.raises(ValueError, match="https is not supported"):
        EarthRover("earthrover", port, {}).config.address()


@pytest.mark.parametrize("text", ["", "x" * 201, 3, None])
def test_saf_014_a_text_that_cannot_be_spoken_is_refused(text: object) -> None:
    refusal = driver().check_service("speak", {"text": text})
    assert refusal is not None and refusal.code == "bad_argument"
    assert driver().check_service("speak", {"text": "hello"}) is None
