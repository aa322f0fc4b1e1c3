"""Test which commands are refused in each state of the robot: code, offered value, limit."""

from __future__ import annotations

from typing import Any

import msgspec
import pytest

from strands_actors.contract.driver import Candidate, GateState, Live
from strands_actors.contract.wire import Observation
from strands_actors.drivers import canonical_name, list_driver_coverage, list_native_drivers, port_kind
from strands_actors.drivers.stretch.driver import Stretch
from strands_actors.drivers.stretch.gates import named_in
from strands_actors.kernel.messages import Refused
from strands_actors.supervisors.gate.admission import Admission, GateSnapshot
from strands_actors.supervisors.gate.failsafe import Mode, State
from strands_actors.supervisors.gate.lease import Leases
from strands_actors.supervisors.gate.messages import Perform

NOW_NS = 10**12
DRIVER = Stretch("stretch3", "", {})
HERE = (0.5, 0.1, *(0.0,) * 7)
AXES = len(DRIVER.axes)


def seen(age_ns: int = 0, **sensors: tuple[float, ...]) -> Observation:
    limits = [axis.limits for axis in DRIVER.table]
    return Observation(
        NOW_NS,
        HERE,
        (NOW_NS - age_ns,) * AXES,
        sensors={
            "runstop": (0.0,),
            "wheel_watchdog": (1.0,),
            "homed": (1.0,) * AXES,
            "limit_low": tuple(low for low, _ in limits),
            "limit_high": tuple(high for _, high in limits),
            **sensors,
        },
    )


def answer(
    action: dict[str, Any],
    observation: Observation | None = None,
    target: tuple[float, ...] = HERE,
    live: Live | None = None,
) -> Candidate | Refused:
    """Judge an action as the gate does: conditions, parse, gates."""
    state = GateState(NOW_NS, observation or seen(), target, NOW_NS, False, 0.0, live)
    for condition in DRIVER.conditions:
        if (refusal := condition.check(state.observation, NOW_NS)) is not None:
            return refusal
    candidate = DRIVER.parse(action, state)
    if isinstance(candidate, Candidate):
        for gate in DRIVER.gates:
            if (refusal := gate(candidate, state)) is not None:
                return refusal
    return candidate


def refused(action: dict[str, Any], observation: Observation | None = None) -> tuple[str, str, str]:
    found = answer(action, observation)
    assert isinstance(found, Refused), found
    return found.code, found.offered, found.limit


def accepted(action: dict[str, Any], observation: Observation | None = None, **more: Any) -> Candidate:
    found = answer(action, observation, **more)
    assert isinstance(found, Candidate), found
    return found


def test_a_live_goal_is_sent_with_the_next_one_and_not_after_a_hold() -> None:
    """Two commands may wait for the wire at once. The wire gets only the newer one, so that one has to contain
    both goals."""
    lift = accepted({"lift": 0.6}).values
    assert len(lift) == AXES + 1 and named_in(lift, DRIVER.axes) == {"lift"}
    assert named_in(accepted({"vy": 0.0}).values, DRIVER.axes) == {"vx", "wz"}
    both = accepted({"arm": 0.2}, target=lift, live=Live()).values
    assert named_in(both, DRIVER.axes) == {"lift", "arm"} and both[0] == 0.6
    turning = accepted({"wz": 0.1}, target=both, live=Live()).values
    assert named_in(turning, DRIVER.axes) == {"lift", "arm", "vx", "wz"}
    still = accepted({"vx": 0.0}, target=turning, live=Live()).values
    assert named_in(still, DRIVER.axes) == {"lift", "arm", "vx"}, (
        "the hold has lift, arm and the twist, which ends by itself"
    )
    for target, live in ((HERE, Live()), (both, None)):  # the hold position, and the time before it is known
        held = accepted({"arm": 0.1}, target=target, live=live).values
        assert named_in(held, DRIVER.axes) == {"arm"}


def row(name: str, axis: str, value: float) -> dict[str, tuple[float, ...]]:
    """Return a sensor in which one axis differs."""
    at, whole = DRIVER.axes.index(axis), seen().sensors[name]
    return {name: (*whole[:at], value, *whole[at + 1 :])}


def test_axes_are_lift_and_arm_in_metres_wrist_and_head_in_radians_and_a_twist_without_a_gripper() -> None:
    assert DRIVER.axes == (
        "lift", "arm", "wrist_yaw", "wrist_pitch", "wrist_roll", "head_pan", "head_tilt", "vx", "wz",
    )  # fmt: skip
    assert [axis.unit for axis in DRIVER.table] == ["m", "m", *["rad"] * 5, "m/s", "rad/s"]


@pytest.mark.parametrize(
    ("action", "code", "offered", "limit"),
    [
        ({"lift": 1.2}, "soft_limit", "1.2000", "0.0000..1.1000"),
        ({"arm": -0.01}, "soft_limit", "-0.0100", "0.0000..0.5200"),
        ({"wrist_pitch": 0.6}, "soft_limit", "0.6000", "-1.5707..0.4509"),
        ({"vx": 0.31}, "wheel_speed", "0.310", "0.3"),
        ({"vx": 0.2, "wz": 1.0}, "wheel_speed", "0.358", "0.3"),
        ({"wz": -2.0}, "wheel_speed", "0.315", "0.3"),
        ({"vy": 0.1}, "strafe", "0.1", "0"),
        ({"vy": "left"}, "not_finite", "", ""),
        ({"gripper": 0.1}, "unknown_joint", "gripper", ", ".join(DRIVER.axes)),
    ],
)
def test_saf_014_impossible_commands_are_refused_and_never_clipped(
    action: dict[str, Any], code: str, offered: str, limit: str
) -> None:
    assert refused(action) == (code, offered, limit)


def test_saf_014_the_soft_limits_are_those_of_now() -> None:
    accepted({"lift": 0.9})
    lowered = seen(**row("limit_high", "lift", 0.8))
    assert refused({"lift": 0.9}, lowered) == ("soft_limit", "0.9000", "0.0000..0.8000")
    accepted({"lift": 0.8}, lowered)
    accepted({"arm": 0.3}, lowered)


@pytest.mark.parametrize("joint", ["lift", "arm", "wrist_yaw"])
def test_saf_014_a_joint_that_is_not_homed_is_not_moved_and_the_base_is(joint: str) -> None:
    lost = seen(**row("homed", joint, 0.0))
    assert refused({joint: 0.1}, lost)[0] == "not_homed"
    accepted({"vx": 0.1}, lost)
    accepted({"head_pan": 0.1}, lost)
    unknown = msgspec.structs.replace(lost, sensors={k: v for k, v in lost.sensors.items() if k != "homed"})
    assert refused({joint: 0.1}, unknown)[0] == "not_homed", "a joint with unknown homing counts as not homed"


def test_saf_014_a_runstop_ends_the_live_command_and_refuses_all_others() -> None:
    pressed = seen(runstop=(1.0,))
    for action in ({"lift": 0.5}, {"vx": 0.1}, {"vx": 0.0}):
        assert refused(action, pressed)[0] == "runstop"
    assert all(each.always and each.check(seen(), NOW_NS) is None for each in DRIVER.conditions)


@pytest.mark.parametrize(
    ("sensor", "why", "remedy"),
    [
        ("", "the runstop is pressed", "release the runstop on the robot, then resume()"),
        ("low_battery", "the battery is low", "charge it, then release the runstop on the robot, then resume()"),
        ("tilted", "the robot is tilted", "set it upright, then release"),
        ("at_cliff", "the base has met a cliff", "move it away, switch the robot off and on, then release"),
        ("high_current", "drawn too much current", "remove what blocks the robot, then release"),
    ],
)
def test_saf_014_the_refusal_has_the_reason_of_the_runstop_and_the_remedy(
    sensor: str, why: str, remedy: str
) -> None:
    found = answer({"lift": 0.5}, seen(**{"runstop": (1.0,), "low_battery": (0.0,), sensor: (1.0,)}))
    assert isinstance(found, Refused) and found.code == "runstop"
    assert why in found.reason and found.remedy.startswith(remedy)
    assert sensor or "robot sets" not in found.reason


@pytest.mark.parametrize(("word", "code"), [("contact", "contact"), ("safety mode", "safety_mode")])
def test_saf_014_a_lift_or_arm_stopped_by_its_board_ends_the_live_command(word: str, code: str) -> None:
    for joint in ("lift", "arm"):
        stopped = msgspec.structs.replace(seen(), faults={joint: f"{word}, silent"})
        for action in ({"lift": 0.5}, {"arm": 0.2}, {"vx": 0.1}):
            assert refused(action, stopped) == (code, word, "none")
    accepted({"lift": 0.5}, msgspec.structs.replace(seen(), faults={"lift": "silent"}))


def test_saf_013_no_twist_without_the_wheels_watchdog() -> None:
    off = seen(wheel_watchdog=(0.0,))
    assert refused({"vx": 0.1}, off) == ("no_watchdog", "off", "on")
    unknown = msgspec.structs.replace(off, sensors={"homed": (1.0,) * AXES})
    assert refused({"wz": 0.1}, unknown)[0] == "no_watchdog"
    accepted({"vx": 0.0, "wz": 0.0}, off)
    accepted({"lift": 0.6}, off)


def test_saf_012_with_old_readings_commands_are_refused() -> None:
    assert refused({"lift": 0.5}, seen(age_ns=300_000_000))[0] == "stale"
    assert refused({"vx": 0.1}, seen(age_ns=300_000_000))[0] == "stale"


def test_saf_001_a_twist_ends_after_300_ms_and_a_joints_goal_with_the_lease() -> None:
    assert accepted({"lift": 0.6}).until_ns == 0
    assert accepted({"vx": 0.1}).until_ns == NOW_NS + 300_000_000
    assert accepted({"vx": 0.1, "lift": 0.6}).until_ns == NOW_NS + 300_000_000
    assert accepted({"vx": 0.0, "wz": 0.0}).until_ns == 0, "a base at rest needs no end time"


def test_saf_001_a_joints_command_keeps_the_live_twist_and_does_not_prolong_it() -> None:
    driving = (*HERE[:7], 0.1, 0.2, 384.0)  # as ``parse`` left it
    until_ns = NOW_NS + 120_000_000
    found = accepted({"lift": 0.6}, target=driving, live=Live(until_ns))
    assert found.values[:9] == (0.6, *HERE[1:7], 0.1, 0.2) and found.until_ns == until_ns
    assert named_in(found.values, DRIVER.axes) == {"lift", "vx", "wz"}, "the command contains the live twist, too"
    ended = accepted({"lift": 0.6}, target=driving, live=Live(NOW_NS - 1))
    assert ended.values[7:9] == (0.0, 0.0) and named_in(ended.values, DRIVER.axes) == {"lift"}


@pytest.mark.parametrize(
    ("arguments", "why"),
    [
        ({"joint": "vx", "low": 0.0, "high": 0.1}, "joint is vx"),
        ({"low": 0.0, "high": 0.1}, "joint is missing"),
        ({"joint": "lift", "low": 0.5, "high": 0.4}, "lift 0.5..0.4"),
        ({"joint": "lift", "low": 0.0, "high": 1.2}, "lift 0.0..1.2"),
        ({"joint": "lift", "low": float("nan"), "high": 1.0}, "lift nan..1.0"),
        ({"joint": "lift"}, "lift None..None"),
    ],
)
def test_invalid_soft_limits_are_refused(arguments: dict[str, Any], why: str) -> None:
    found = DRIVER.check_service("set_soft_limits", arguments)
    assert found is not None and found.code == "bad_argument" and why in found.reason
    assert DRIVER.check_service("set_soft_limits", {"joint": "lift", "low": 0.2, "high": 0.9}) is None


def test_a_command_that_comes_as_a_service_is_refused_at_the_gate() -> None:
    """As a service it would have no lifetime. The handle sends it as an action."""
    known = GateSnapshot(State(Mode.ARMED, 1), Leases(0), "", None, "", seen(), HERE, NOW_NS, 0, False)
    refusal = Admission(DRIVER).service(Perform(1, 1, "set_twist", {"vx": 0.1}), known, NOW_NS)
    assert refusal is not None and refusal.code == "a_command"


def test_the_robots_are_known_by_their_names() -> None:
    native = list_native_drivers()
    assert native["stretch"] == native["stretch3"] == "StretchDriver"
    assert canonical_name("stretch2") == "stretch" and canonical_name("Stretch 3") == "stretch3"
    assert list_driver_coverage()["stretch3"] == ("strands",), "LeRobot has no class for a Stretch 3"
    assert port_kind("stretch3") == "serial"
