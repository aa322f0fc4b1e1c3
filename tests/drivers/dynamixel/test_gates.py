"""Test the Dynamixel driver's declarations, and the refusals of this wire. No I/O."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import pytest

from strands_actors.contract.driver import HOLDING_REASONS, Candidate, GateState, Reason
from strands_actors.contract.wire import Observation
from strands_actors.drivers import get_native_driver_class, list_native_drivers
from strands_actors.drivers.common.dynamixel.gates import UNNAMED
from strands_actors.drivers.common.dynamixel.watchdog import COUNTS, SECONDS, TRIPPED
from strands_actors.drivers.dynamixel.driver import Dynamixel
from strands_actors.kernel.clock import NS
from strands_actors.kernel.messages import Refused

JOINTS = ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll", "gripper")
NOW_NS = 1000 * NS


def calibration(**changes: int) -> dict[str, dict[str, int]]:
    motor = {"drive_mode": 0, "homing_offset": -2000, "range_min": 1000, "range_max": 3000, **changes}
    return {key: {"id": at, **motor} for at, key in enumerate(JOINTS, 1)}


def koch(**options: Any) -> Dynamixel:
    return Dynamixel("koch", "/dev/none", Dynamixel.resolve("koch", options))


def state(faults: Mapping[str, str] | None = None) -> GateState:
    rows = {
        "voltage_v": (12.0, 12.0, 5.0, 5.0, 5.0, 5.0),
        "voltage_min_v": (6.0, 6.0, 3.5, 3.5, 3.5, 3.5),
        "voltage_max_v": (14.0, 14.0, 7.0, 7.0, 7.0, 7.0),
        "temperature_c": (30.0,) * 6,
        "temperature_max_c": (70.0,) * 6,
        "load_pct": (1.0, 1.0, math.nan, math.nan, math.nan, math.nan),
    }
    observation = Observation(NOW_NS, (0.0,) * 6, (NOW_NS,) * 6, sensors=rows, faults=dict(faults or {}))
    return GateState(NOW_NS, observation, (0.0,) * 6, NOW_NS, False)


def decide(driver: Dynamixel, action: Mapping[str, Any], at: GateState | None = None) -> Candidate | Refused:
    at = at or state()
    candidate = driver.parse(action, at)
    if isinstance(candidate, Refused):
        return candidate
    return next((no for gate in driver.gates if (no := gate(candidate, at))), candidate)


def refusal(driver: Dynamixel, action: Mapping[str, Any], at: GateState | None = None) -> Refused:
    answer = decide(driver, action, at)
    assert isinstance(answer, Refused), answer
    return answer


def test_koch_is_in_the_registry() -> None:
    assert list_native_drivers()["koch"] == "DynamixelDriver"
    assert get_native_driver_class("koch_follower") is Dynamixel


def test_axes_fallbacks_and_the_firmwares_watchdog() -> None:
    driver = koch()
    assert driver.axes == JOINTS
    assert driver.ids == (1, 2, 3, 4, 5, 6)
    for reason in Reason:
        assert driver.fallbacks[reason] == ("hold" if reason in HOLDING_REASONS else "limp")
    assert "bus watchdog (register 98) armed at 0.3 s" in driver.firmware_watchdog
    assert 0 < COUNTS <= 127
    assert pytest.approx(0.3) == SECONDS


def test_units_without_a_calibration() -> None:
    driver = koch()
    pan, gripper = driver.joints[0], driver.joints[5]
    assert driver.config.calibration_source == "none: the travel of its model"
    assert pan.limits == pytest.approx((-126.0, 126.1), abs=0.05)
    assert pan.count(90.0) == round(2047.5 + 90 * 4095 / 360)
    assert gripper.limits == pytest.approx((0.0, 100.0))
    assert gripper.count(0.0) == gripper.low < gripper.count(100.0) == gripper.high


def test_units_of_a_calibration() -> None:
    pan = koch(calibration=calibration()).joints[0]
    assert (pan.count(0.0), pan.low, pan.high) == (2000, 1000, 3000)
    assert pan.limits == pytest.approx((-87.9, 87.9), abs=0.1)


def test_drive_mode_is_the_servos_business() -> None:
    """As in lerobot: a Dynamixel inverts its own positions."""
    inverted = koch(calibration=calibration(drive_mode=1)).joints[0]
    assert inverted == koch(calibration=calibration()).joints[0]


def test_an_offset_of_many_turns_is_taken_and_more_is_not() -> None:
    assert koch(calibration=calibration(homing_offset=-1_044_479)).config.calibration
    with pytest.raises(ValueError, match="homing_offset is 1044480"):
        koch(calibration=calibration(homing_offset=1_044_480))


def test_options_are_checked() -> None:
    assert koch(baud=57_600).config.baud == 57_600
    with pytest.raises(ValueError, match="baud is 500000"):
        koch(baud=500_000)


def test_past_the_calibrated_range_is_refused_in_a_mode_of_many_turns_too() -> None:
    no = refusal(koch(calibration=calibration()), {"wrist_roll": 100.0})
    assert no.text == "wrist_roll 100.0 deg is past 87.9. Stay within -87.9..87.9"


def test_each_servo_has_its_own_supply() -> None:
    at = state()
    at.observation.sensors["voltage_v"] = (12.0, 5.0, 5.0, 5.0, 5.0, 12.0)
    assert refusal(koch(), {"shoulder_lift": 1.0}, at).reason == "shoulder_lift (id 2) has a supply of 5.0 V"
    assert refusal(koch(), {"gripper": 1.0}, at).remedy == "supply 3.5..7.0 V"
    assert isinstance(decide(koch(), {"shoulder_pan": 1.0, "elbow_flex": 1.0}, at), Candidate)


@pytest.mark.parametrize(
    ("fault", "code", "text"),
    [
        (
            "overload, limp",
            "alert",
            "elbow_flex is limp (overload). Clear the cause, reboot the servo with the arm supported, "
            "then stop and resume",
        ),
        (UNNAMED, "alert", f"elbow_flex reports {UNNAMED}. Clear the cause, reboot"),
        (TRIPPED, "watchdog", "elbow_flex reports bus watchdog. Stop and resume to clear it"),
        ("limp", "limp", "elbow_flex is limp. Take the load off"),
        ("access error", "fault", "elbow_flex reports access error. Clear the cause, then try again"),
    ],
)
def test_a_fault_of_a_servo_refuses_only_its_joint(fault: str, code: str, text: str) -> None:
    at = state({"elbow_flex": fault})
    no = refusal(koch(), {"elbow_flex": 1.0}, at)
    assert no.code == code
    assert no.text.startswith(text)
    assert isinstance(decide(koch(), {"wrist_flex": 1.0}, at), Candidate)
