"""Test which commands the drone refuses, and with which messages. No I/O."""

from __future__ import annotations

from typing import Any

import pytest

from strands_actors.contract.driver import Candidate, GateState, Reason
from strands_actors.contract.wire import Observation
from strands_actors.drivers.crazyflie.config import LANDING_M_S
from strands_actors.drivers.crazyflie.driver import SERVICE_RANGES, Crazyflie
from strands_actors.drivers.crazyflie.gates import takeoff_refusal
from strands_actors.drivers.crazyflie.protocol import Battery, Bit
from strands_actors.drivers.crazyflie.stopping import STOP_S
from strands_actors.drivers.crazyflie.wire import ARM_S, CHECKS_S, LANDED_S, RISE_S, SPIN_UP_S
from strands_actors.kernel.clock import NS
from strands_actors.kernel.messages import Refused

NOW_NS = 10**12
FLYING = Bit.CAN_BE_ARMED | Bit.ARMED | Bit.CAN_FLY | Bit.FLYING
STANDING = Bit.CAN_BE_ARMED


def drone(**options: Any) -> Crazyflie:
    return Crazyflie("crazyflie", "192.0.2.1", Crazyflie.resolve("crazyflie", options))


def sensors(bits: Bit = FLYING, volts: float = 4.0, **more: float) -> dict[str, tuple[float, ...]]:
    found = {"supervisor": float(bits), "battery_v": volts, "battery_state": 0.0, "hover_s": 0.0, **more}
    return {**{name: (value,) for name, value in found.items()}, "rpy_rad": (0.0, 0.0, 0.0)}


def seen(
    bits: Bit = FLYING, volts: float = 4.0, height_m: float = 0.5, age_s: float = 0.0, **more: float
) -> Observation:
    t_ns = NOW_NS - round(age_s * NS)
    return Observation(t_ns, (0.0, 0.0, 0.0, 0.0, height_m), (t_ns,) * 5, sensors=sensors(bits, volts, **more))


def answer(action: dict[str, Any], observation: Observation | None = None) -> Candidate | Refused:
    """Judge an action as the gate does."""
    driver, observation = drone(), observation or seen()
    state = GateState(NOW_NS, observation, observation.position, NOW_NS, False)
    for condition in driver.conditions:
        if (refusal := condition.check(observation, NOW_NS)) is not None:
            return refusal
    candidate = driver.parse(action, state)
    if isinstance(candidate, Refused):
        return candidate
    return next((no for gate in driver.gates if (no := gate(candidate, state)) is not None), candidate)


def refused(action: dict[str, Any], observation: Observation | None = None) -> Refused:
    no = answer(action, observation)
    assert isinstance(no, Refused), no
    return no


def test_with_z_it_hovers_without_it_flies_by_speed() -> None:
    assert answer({"vx": 0.2, "z": 0.8}) == Candidate((0.2, 0.0, 0.0, 0.0, 0.8, 1.0), (0, 4))
    assert answer({"vx": 0.2}) == Candidate((0.2, 0.0, 0.0, 0.0, 0.5, 0.0), (0,)), (
        "without z, z is the present height"
    )
    assert answer({"wz": -2.5}) == Candidate((0.0, 0.0, 0.0, -2.5, 0.5, 0.0), (3,))
    commanded = drone().commanded({"vx": 0.2, "z": 0.8}, (0.2, 0.0, 0.0, 0.0, 0.8, 1.0))
    assert commanded["commanded"] == "hover" and commanded["args"] == {"vx": 0.2, "vy": 0.0, "wz": 0.0, "z": 0.8}
    assert drone().commanded({"vx": 0.2}, (0.2, 0.0, 0.0, 0.0, 0.5, 0.0))["commanded"] == "velocity_world"


@pytest.mark.parametrize(
    ("action", "limit"),
    [
        ({"vx": 1.01}, "-1.0000..1.0000"),
        ({"vy": -1.01}, "-1.0000..1.0000"),
        ({"vz": 0.51}, "-0.5000..0.5000"),
        ({"wz": 2.6}, "-2.5000..2.5000"),
        ({"z": 0.04}, "0.0500..2.0000"),
        ({"z": 2.1}, "0.0500..2.0000"),
    ],
)
def test_saf_014_outside_the_envelope_is_refused_with_the_bound(action: dict[str, float], limit: str) -> None:
    no = refused(action)
    assert (no.code, no.limit) == ("past_travel", limit)


def test_saf_014_vz_and_z_are_not_both_taken() -> None:
    assert refused({"vz": 0.1, "z": 0.5}).code == "both"


def test_saf_014_a_speed_does_not_climb_past_the_ceiling_nor_sink_to_the_floor() -> None:
    assert "past 2" in refused({"vz": 0.1}, seen(height_m=2.01)).text
    assert isinstance(answer({"vz": -0.1}, seen(height_m=2.01)), Candidate)
    assert "land()" in refused({"vz": -0.1}, seen(height_m=0.04)).text
    assert isinstance(answer({"vz": 0.1}, seen(height_m=0.04)), Candidate)


@pytest.mark.parametrize(
    ("observation", "code", "safe_state"),
    [
        (seen(FLYING | Bit.LOCKED), "locked", "limp"),
        (seen(FLYING | Bit.TUMBLED), "tumbled", "limp"),
        (seen(FLYING | Bit.CRASHED), "crashed", "limp"),
        (seen(volts=3.19), "battery", "land"),
        (seen(battery_state=float(Battery.LOW_POWER)), "battery", "land"),
        (seen(battery_state=float(Battery.SHUTDOWN)), "battery", "land"),
        (seen(position_age_s=2.1), "battery", "land"),
        (seen(hover_s=30.1), "hovering", "land"),
        (seen(STANDING), "not_flying", "land"),
        (seen(Bit.FLYING), "not_flying", "land"),
    ],
)
def test_saf_014_each_condition_refuses_and_has_its_safe_state(
    observation: Observation, code: str, safe_state: str
) -> None:
    assert refused({"vx": 0.1}, observation).code == code
    condition = next(one for one in drone().conditions if one.check(observation, NOW_NS) is not None)
    assert (condition.reason, condition.safe_state) == (Reason.FAULT, safe_state)
    assert condition.always is (code != "not_flying"), "on the floor this condition does not start a safe state"


def test_saf_012_an_old_reading_refuses() -> None:
    assert refused({"vx": 0.1}, seen(age_s=0.6)).code == "stale"
    bare = Observation(NOW_NS, (0.0,) * 5, (NOW_NS,) * 5)
    assert refused({"vx": 0.1}, bare).code == "no_observation"


def test_a_low_battery_on_the_floor_is_takeoffs_business() -> None:
    assert refused({"vx": 0.1}, seen(STANDING, volts=3.0)).code == "not_flying"
    no = takeoff_refusal(STANDING, sensors(STANDING, volts=3.0), 3.2)
    assert no is not None and no.code == "battery" and "3.00 V" in no.text


def test_a_battery_that_only_the_firmware_reports_as_low_is_refused() -> None:
    no = takeoff_refusal(STANDING, seen(volts=3.6, battery_state=float(Battery.LOW_POWER)).sensors, 3.2)
    assert no is not None and "the firmware reports a low battery, at 3.60 V. Charge it" in no.text
    assert "3.2" not in no.text


def test_saf_012_an_old_battery_report_does_not_count() -> None:
    no = takeoff_refusal(STANDING, sensors(STANDING, position_age_s=2.1), 3.2)
    assert no is not None and (no.code, no.limit) == ("battery", "2 s") and "its battery for 2.1 s" in no.text
    assert takeoff_refusal(STANDING, sensors(STANDING, position_age_s=1.9), 3.2) is None


@pytest.mark.parametrize(
    ("bits", "code"),
    [
        (None, "no_observation"),
        (STANDING | Bit.LOCKED, "locked"),
        (STANDING | Bit.TUMBLED, "tumbled"),
        (STANDING | Bit.CRASHED, "tumbled"),
        (Bit(0), "cannot_arm"),
    ],
)
def test_takeoff_is_refused(bits: Bit | None, code: str) -> None:
    no = takeoff_refusal(bits, sensors(bits or Bit(0)), 3.2)
    assert no is not None and no.code == code
    tilted = {**sensors(STANDING), "rpy_rad": (0.3, 0.0, 0.0)}
    no = takeoff_refusal(STANDING, tilted, 3.2)
    assert no is not None and no.code == "tilted"
    assert takeoff_refusal(STANDING, sensors(STANDING), 3.2) is None


@pytest.mark.parametrize(
    ("service", "arguments", "code"),
    [
        ("takeoff", {"height": 2.5}, "bad_argument"),
        ("takeoff", {"height": "high"}, "bad_argument"),
        ("takeoff", {"duration": 0.1}, "bad_argument"),
        ("land", {"duration": float("nan")}, "bad_argument"),
        ("land", {"height": 0.0}, "unknown_argument"),
        ("fly", {}, "unknown_service"),
    ],
)
def test_saf_014_arguments_of_services(service: str, arguments: dict[str, Any], code: str) -> None:
    no = drone().check_service(service, arguments)
    assert no is not None and no.code == code
    assert drone().check_service("takeoff", {"height": 1.0}) is None
    assert drone().check_service("land", {}) is None


def test_four_verbs_four_meanings() -> None:
    driver = drone()
    assert set(driver.SERVICES) == {"takeoff", "set_twist", "land", "emergency_stop"}
    assert driver.SERVICES["emergency_stop"].stops is Reason.ESTOP
    fallbacks = driver.fallbacks
    assert (fallbacks[Reason.STOP], fallbacks[Reason.ESTOP]) == ("land", "off")
    assert {fallbacks[reason] for reason in (Reason.EXPIRED, Reason.LEASE, Reason.POLICY)} == {"hold"}
    for reason in (Reason.CALLER, Reason.WIRE, Reason.ROOT, Reason.LINK, Reason.FAULT, Reason.CLEANUP):
        assert fallbacks[reason] == "land"
    assert {verb.name for verb in driver.TOOL_VERBS} == {"sensors", "status", "land", "move", "stop"}, (
        "an agent has no takeoff verb"
    )
    assert driver.GUARDED == ("move",)
    assert driver.ROLLOUTS


def test_saf_005_a_stop_has_the_time_that_a_landing_from_the_ceiling_takes() -> None:
    driver = drone()
    landing_s = driver.config.z_m[1] / LANDING_M_S
    counts_as_flying_s = 2.0
    assert landing_s + counts_as_flying_s < STOP_S < driver.timing.safe_s <= driver.timing.handover_s
    longest_s = SERVICE_RANGES["duration"][1]
    assert longest_s + LANDED_S < driver.SERVICES["land"].within_s
    arming_s = CHECKS_S + ARM_S + SPIN_UP_S
    assert arming_s + ARM_S + longest_s + RISE_S + STOP_S < driver.SERVICES["takeoff"].within_s


def test_the_one_option() -> None:
    assert drone(setpoint_hz=50).timing.keepalive_s == 0.02
    assert drone().setpoint_hz == 20.0
    with pytest.raises(ValueError, match="10 to 100"):
        drone(setpoint_hz=5)
    with pytest.raises(TypeError, match="setpoint_hz"):
        drone(setpoint_hertz=20)


def test_a_link_that_was_never_tested_on_a_drone_has_a_caveat() -> None:
    assert drone().caveats == ()
    (caveat,) = Crazyflie("crazyflie", "usb://0", Crazyflie.resolve("crazyflie", {})).caveats
    assert caveat.startswith("a port radio:// or usb:// is experimental: this was never run on a real drone")
