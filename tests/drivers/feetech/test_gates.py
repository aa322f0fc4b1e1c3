"""Test every refusal of the Feetech driver, and that nothing else passes. No I/O."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from strands_actors.contract.axis_gates import READING_NOISE, STEP_TOLERANCE
from strands_actors.contract.driver import HOLDING_REASONS, Candidate, GateState, Reason
from strands_actors.contract.wire import Observation
from strands_actors.drivers.feetech.driver import Feetech
from strands_actors.kernel.clock import NS
from strands_actors.kernel.messages import Refused

JOINTS = ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll", "gripper")
NOW_NS = 1000 * NS
CALIBRATION = {
    key: {"id": at, "drive_mode": 0, "homing_offset": 0, "range_min": 703, "range_max": 3392}
    for at, key in enumerate(JOINTS, 1)
}


def so101(calibration: Mapping[str, Any] | None = CALIBRATION) -> Feetech:
    """Return an arm with an option that lets one command move a joint by any angle."""
    return Feetech("so101", "/dev/none", Feetech.resolve("so101", {"calibration": calibration, "max_jump": 360}))


ARM = so101()
FREE = so101(None)


def state(**changes: Any) -> GateState:
    rows = {
        "voltage_v": (7.4,) * 6,
        "voltage_min_v": (4.0,) * 6,
        "voltage_max_v": (8.0,) * 6,
        "temperature_c": (30.0,) * 6,
        "temperature_max_c": (70.0,) * 6,
    }
    observation = Observation(
        t_ns=NOW_NS,
        position=(0.0,) * 6,
        stamp_ns=changes.pop("stamp_ns", (NOW_NS,) * 6),
        sensors=rows | changes.pop("sensors", {}),
        faults=changes.pop("faults", {}),
    )
    fields: dict[str, Any] = {
        "now_ns": NOW_NS,
        "observation": observation,
        "target": (0.0,) * 6,
        "target_ns": NOW_NS,
        "stream": False,
    }
    return GateState(**fields | changes)


def decide(driver: Feetech, action: Mapping[Any, Any], at: GateState | None = None) -> Candidate | Refused:
    at = at or state()
    candidate = driver.parse(action, at)
    if isinstance(candidate, Refused):
        return candidate
    return next((no for gate in driver.gates if (no := gate(candidate, at))), candidate)


def refusal(action: Mapping[Any, Any], at: GateState | None = None, driver: Feetech = ARM) -> Refused:
    answer = decide(driver, action, at)
    assert isinstance(answer, Refused), answer
    assert answer.code and answer.reason and answer.remedy
    assert answer.offered and answer.limit
    return answer


# -- names and numbers


def test_an_accepted_action_keeps_the_joints_that_it_does_not_name() -> None:
    answer = decide(ARM, {"elbow_flex": 10, "gripper.pos": 55.5}, state(target=(1.0, 2.0, 3.0, 4.0, 5.0, 6.0)))
    assert answer == Candidate((1.0, 2.0, 10.0, 4.0, 5.0, 55.5), (2, 5))


def test_unknown_joint() -> None:
    no = refusal({"elbow": 1.0})
    assert no.code == "unknown_joint"
    assert no.reason == "elbow is not a joint of so101"
    assert no.remedy == "use " + ", ".join(JOINTS)
    assert no.offered == "elbow"


@pytest.mark.parametrize("key", ["", ".pos", "shoulder_pan.pos.pos", "gripper ", "x" * 10_000, 7, None])
def test_strange_keys_are_unknown(key: object) -> None:
    no = refusal({key: 1.0})
    assert no.code == "unknown_joint"
    assert len(no.text) < 300


def test_both_spellings() -> None:
    no = refusal({"gripper": 1.0, "gripper.pos": 1.0})
    assert no.code == "both_spellings"
    assert no.reason == "gripper and gripper.pos are both given"


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, True, False, None, "1", [1.0], 1j, b"1", 10**400])
def test_only_finite_numbers(value: object) -> None:
    no = refusal({"wrist_flex": value})
    assert no.code == "not_finite"
    assert no.reason.startswith("wrist_flex is ")
    assert len(no.text) < 200


def test_nan_is_named() -> None:
    assert refusal({"wrist_flex": math.nan}).text == "wrist_flex is nan. Send a finite number"


def test_empty() -> None:
    assert refusal({}).code == "empty"


# -- travel


def test_past_travel_is_the_page_sentence() -> None:
    no = refusal({"shoulder_pan": 140.0})
    assert no.code == "past_travel"
    assert no.reason == "shoulder_pan 140.0 deg is past 118.1"
    assert no.remedy == "stay within -118.1..118.1"
    assert (no.offered, no.limit) == ("140.0", "-118.1..118.1")


@pytest.mark.parametrize("value", [-140.0, -118.3, 118.3, 1e9, -1e300])
def test_past_either_end(value: float) -> None:
    assert refusal({"shoulder_pan": value}).code == "past_travel"


@pytest.mark.parametrize("value", [-0.1, 100.001, 101.0, -5.0])
@pytest.mark.parametrize("driver", [ARM, FREE])
def test_gripper_past_0_to_100(value: float, driver: Feetech) -> None:
    no = refusal({"gripper": value}, driver=driver)
    assert no.code == "past_travel"
    assert no.remedy == "stay within 0.0..100.0"


@pytest.mark.parametrize("driver", [ARM, FREE])
def test_the_ends_themselves_are_accepted(driver: Feetech) -> None:
    for axis in driver.joints:
        for count, value in zip((axis.low, axis.high), map(axis.value, (axis.low, axis.high)), strict=True):
            assert isinstance(decide(driver, {axis.key: value}), Candidate)
            assert axis.count(value) == count
    for percent in (0, 100):
        assert isinstance(decide(driver, {"gripper": percent}), Candidate)


def test_without_calibration_a_joint_has_the_range_of_its_model() -> None:
    assert FREE.config.calibration_source.startswith("none")
    assert FREE.joints[0].limits == pytest.approx((-110.0, 110.1), abs=0.05)
    assert (FREE.joints[0].low, FREE.joints[0].high) == (796, 3300)
    assert "so101 is not calibrated" in FREE.caveats[0] and ARM.caveats == ()
    gripper = FREE.joints[5]
    assert (gripper.low, gripper.high) == (1934, 3186), "the range of its model, around 2048"


def test_joints_that_are_not_named_are_not_checked() -> None:
    """A joint that sags past its range must not keep the others from moving."""
    outside = state(target=(0.0, 0.0, 0.0, 0.0, 0.0, -1.5))
    assert isinstance(decide(ARM, {"shoulder_pan": 1.0}, outside), Candidate)


# -- the state of the robot


def test_stale_position_of_a_named_joint() -> None:
    stamps = (NOW_NS - 312_000_000, *(NOW_NS,) * 5)
    no = refusal({"shoulder_pan": 1.0}, state(stamp_ns=stamps))
    assert no.code == "stale"
    assert no.reason == "no position from shoulder_pan (id 1) for 312 ms"
    assert isinstance(decide(ARM, {"gripper": 1.0}, state(stamp_ns=stamps)), Candidate)
    fresh = (NOW_NS - 299_000_000, *(NOW_NS,) * 5)
    assert isinstance(decide(ARM, {"shoulder_pan": 1.0}, state(stamp_ns=fresh)), Candidate)


def test_a_joint_never_read() -> None:
    no = refusal({"elbow_flex": 1.0}, state(stamp_ns=(NOW_NS, NOW_NS, 0, NOW_NS, NOW_NS, NOW_NS)))
    assert no.reason == "no position from elbow_flex (id 3) yet"
    unknown_target = state(target=(0.0, math.nan, 0.0, 0.0, 0.0, 0.0))
    no = refusal({"elbow_flex": 1.0}, unknown_target)
    assert no.reason == "no position from shoulder_lift (id 2) yet"


@pytest.mark.parametrize(
    ("fault", "code", "said"),
    [
        ("overload", "limp", "is limp (overload)"),
        ("overload, limp", "limp", "is limp (overload)"),
        ("limp", "limp", "is limp"),
        ("limp, silent", "limp", "is limp"),
        ("overheat", "temperature", "reports overheat"),
        ("voltage", "voltage", "reports voltage"),
        ("sensor", "fault", "reports sensor"),
        ("overcurrent, unknown 0x40", "fault", "reports overcurrent, unknown 0x40"),
    ],
)
def test_motor_faults(fault: str, code: str, said: str) -> None:
    at = state(faults={"gripper": fault})
    no = refusal({"gripper": 10.0}, at)
    assert no.code == code
    assert no.reason == f"gripper {said}"
    assert isinstance(decide(ARM, {"elbow_flex": 1.0}, at), Candidate), "the fault of another joint does not matter"


def test_silence_alone_is_left_to_the_age_of_the_position() -> None:
    assert isinstance(decide(ARM, {"gripper": 10.0}, state(faults={"gripper": "silent"})), Candidate)


@pytest.mark.parametrize(("volt", "shown"), [(3.9, "3.9"), (8.1, "8.1")])
def test_voltage_out_of_the_servos_limits(volt: float, shown: str) -> None:
    at = state(sensors={"voltage_v": (7.4, 7.4, volt, 7.4, 7.4, 7.4)})
    no = refusal({"elbow_flex": 1.0}, at)
    assert no.code == "voltage"
    assert no.reason == f"elbow_flex (id 3) has a supply of {shown} V"
    assert (no.offered, no.limit) == (shown, "4.0..8.0")
    assert isinstance(decide(ARM, {"gripper": 1.0}, at), Candidate)


def test_temperature_at_the_servos_limit() -> None:
    hot = state(sensors={"temperature_c": (30.0, 70.0, 30.0, 30.0, 30.0, 30.0)})
    no = refusal({"shoulder_lift": 1.0}, hot)
    assert no.code == "temperature"
    assert no.reason == "shoulder_lift (id 2) is at 70 deg C"
    warm = state(sensors={"temperature_c": (30.0, 69.0, 30.0, 30.0, 30.0, 30.0)})
    assert isinstance(decide(ARM, {"shoulder_lift": 1.0}, warm), Candidate)


# -- steps


def stream(period_s: float, since_s: float) -> GateState:
    return state(stream=True, period_s=period_s, target_ns=NOW_NS - round(since_s * NS))


def test_too_fast_names_the_allowed_step() -> None:
    no = refusal({"shoulder_pan": 60.0}, stream(0.033, 0.033))
    assert no.code == "too_fast"
    assert no.reason == "shoulder_pan steps 60.0 deg in 33 ms"
    assert no.limit == "13.1", "332 deg/s for 33 ms, plus a fifth"
    assert no.remedy == "step at most 13.1 deg"
    assert isinstance(decide(ARM, {"shoulder_pan": float(no.limit)}, stream(0.033, 0.033)), Candidate)


def test_the_step_grows_with_the_time_since_the_last_target() -> None:
    assert isinstance(decide(ARM, {"shoulder_pan": 60.0}, stream(0.033, 0.2)), Candidate)
    assert isinstance(decide(ARM, {"shoulder_pan": 60.0}, stream(0.2, 0.0)), Candidate)
    assert refusal({"shoulder_pan": 60.0}, stream(0.033, -1.0)).code == "too_fast"


def test_a_single_command_may_go_anywhere_within_travel_with_the_option() -> None:
    assert isinstance(decide(ARM, {"shoulder_pan": 118.0}, state(stream=False)), Candidate)


@given(st.floats(-118.0, 118.0), st.floats(0.001, 1.0))
def test_steps_within_the_servos_speed_pass(value: float, period_s: float) -> None:
    axis = ARM.joints[0]
    answer = decide(ARM, {axis.key: value}, stream(period_s, 0.0))
    assert isinstance(answer, Candidate) == (abs(value) <= axis.speed * period_s * STEP_TOLERANCE)


# -- nothing else passes

numbers = st.one_of(
    st.floats(),
    st.integers(),
    st.booleans(),
    st.none(),
    st.text(max_size=3),
    st.sampled_from([math.nan, math.inf, -math.inf, 0.0, 50.0, 118.19, -118.19, 100.0, 1e308]),
)
keys = st.one_of(st.sampled_from([*JOINTS, *(f"{key}.pos" for key in JOINTS), "elbow", ""]), st.text(max_size=4))


@given(st.dictionaries(keys, numbers, max_size=8), st.booleans())
def test_accepted_values_are_known_finite_and_in_range(action: dict[str, Any], streamed: bool) -> None:
    answer = decide(ARM, action, state(stream=streamed, period_s=0.033))
    if isinstance(answer, Refused):
        return
    assert action
    assert len(answer.named) == len(set(answer.named)) == len(action)
    for key, value in action.items():
        axis = ARM.joints[JOINTS.index(key.removesuffix(".pos"))]
        assert type(value) in (int, float) and math.isfinite(value)
        assert axis.low <= axis.count(value) <= axis.high
    assert all(map(math.isfinite, answer.values))


# -- units

ranges = st.tuples(st.integers(0, 4094), st.integers(1, 4095)).filter(lambda pair: pair[0] < pair[1])


def calibrated(low: int, high: int, drive_mode: int) -> Feetech:
    fields = {"range_min": low, "range_max": high, "drive_mode": drive_mode}
    return so101({key: motor | fields for key, motor in CALIBRATION.items()})


@given(ranges, st.integers(0, 1), st.integers(0, 4095))
def test_counts_survive_the_units(span: tuple[int, int], drive_mode: int, count: int) -> None:
    for axis in calibrated(*span, drive_mode).joints:
        assert axis.count(axis.value(count)) == count


@given(ranges, st.integers(0, 1))
def test_the_whole_range_is_accepted_and_nothing_beyond(span: tuple[int, int], drive_mode: int) -> None:
    driver = calibrated(*span, drive_mode)
    for axis in driver.joints:
        for count in span:
            assert isinstance(decide(driver, {axis.key: axis.value(count)}), Candidate)
        # a joint at its end may be commanded to stay there
        beyond = 1 + math.ceil(2 * READING_NOISE * (span[1] - span[0]))
        for count in (span[0] - beyond, span[1] + beyond):
            assert refusal({axis.key: axis.value(count)}, driver=driver).code == "past_travel"


def test_degrees_and_percent_are_lerobots() -> None:
    driver = calibrated(1024, 3072, 0)
    pan, gripper = driver.joints[0], driver.joints[5]
    assert pan.value(2048) == 0.0
    assert pan.value(2048 + 113) == pytest.approx(9.934, abs=1e-3)
    assert [gripper.value(count) for count in (1024, 2048, 3072)] == [0.0, 50.0, 100.0]


def test_drive_mode_inverts() -> None:
    driver = calibrated(1024, 3072, 1)
    pan, gripper = driver.joints[0], driver.joints[5]
    assert pan.value(2048 + 113) == pytest.approx(-9.934, abs=1e-3)
    assert [gripper.value(count) for count in (1024, 2048, 3072)] == [100.0, 50.0, 0.0]
    assert all(axis.speed > 0 for axis in driver.joints)


# -- the declaration


@pytest.mark.parametrize("robot", Feetech.SUPPORTED_ROBOTS)
def test_every_robot_is_declared_whole(robot: str) -> None:
    driver = Feetech(robot, "/dev/none", Feetech.resolve(robot, {}))
    assert len(driver.axes) == len(set(driver.axes)) == len(driver.ids) == len(set(driver.ids))
    assert set(driver.fallbacks) == set(Reason)
    assert {reason for reason, safe_state in driver.fallbacks.items() if safe_state == "hold"} == HOLDING_REASONS
    assert driver.energised("hold") and not driver.energised("limp")
    assert "no watchdog" in driver.firmware_watchdog and "for ever" in driver.firmware_watchdog
    for axis in driver.joints:
        low, high = axis.limits
        assert low < high and axis.speed > 0


def test_the_robots_are_those_of_the_page() -> None:
    assert set(Feetech.SUPPORTED_ROBOTS) == {"so100", "so101", "hope_jr", "open_duck_mini"}
    assert ARM.axes == JOINTS
    assert ARM.ids == (1, 2, 3, 4, 5, 6)


def test_an_alias_is_the_robot() -> None:
    for alias, name in Feetech.ALIASES.items():
        assert Feetech(alias, "p", Feetech.resolve(alias, {})).robot == name


def test_resolved_options_travel_as_plain_data() -> None:
    resolved = Feetech.resolve("so101", {"calibration": CALIBRATION, "baud": 500_000})
    travelled = msgspec.msgpack.decode(msgspec.msgpack.encode(resolved))
    driver = Feetech("so101", "p", travelled)
    assert driver.joints == ARM.joints
    assert driver.config.baud == 500_000
    assert Feetech.resolve("so101", travelled) == resolved, "resolving a second time changes nothing"


@pytest.mark.parametrize("baud", [9600, "fast", 1.5, True])
def test_an_odd_baud_rate_is_refused(baud: object) -> None:
    with pytest.raises(ValueError, match=r"baud is .*Use one of 1000000, 500000"):
        Feetech.resolve("so101", {"baud": baud})


def test_an_unknown_option_is_refused() -> None:
    with pytest.raises(TypeError, match=r"unknown option prot. Use calibration, baud"):
        Feetech.resolve("so101", {"prot": "/dev/ttyACM0"})


def test_another_wires_robot_is_refused() -> None:
    with pytest.raises(ValueError, match=r"koch is not a Feetech robot\. Use one of so100, so101"):
        Feetech.resolve("koch", {})


# -- a single jump


def test_one_command_turns_a_joint_by_a_quarter_of_a_turn_at_most() -> None:
    usual = Feetech("so101", "", Feetech.resolve("so101", {}))
    assert isinstance(decide(usual, {"shoulder_pan": 89.0}), Candidate)
    no = refusal({"shoulder_pan": 97.0}, driver=usual)
    assert (no.code, no.limit) == ("jump", "90") and "at full speed" in no.reason
    assert 'move_to({"shoulder_pan": 97}' in no.remedy and "max_jump" in no.remedy
    assert isinstance(decide(usual, {"gripper": 100.0}), Candidate), "a gripper opens in one command"


def test_a_user_may_lift_the_limit_or_lower_it() -> None:
    free = Feetech("so101", "", Feetech.resolve("so101", {"max_jump": 360}))
    assert isinstance(decide(free, {"shoulder_pan": 109.0}), Candidate)
    careful = Feetech("so101", "", Feetech.resolve("so101", {"max_jump": 5}))
    assert isinstance(decide(careful, {"shoulder_pan": 6.0}), Refused)
    for wrong in (0, -1, 361, "90", True, math.nan):
        with pytest.raises(ValueError, match="max_jump"):
            Feetech.resolve("so101", {"max_jump": wrong})
