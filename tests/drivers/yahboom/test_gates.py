"""Test what the driver accepts and refuses: options, addresses, twist and arm, the lifetime of each, and which
commands an operator has to approve."""

from __future__ import annotations

import math
from typing import Any

import pytest

from strands_actors.caller.resolve.planning import plan
from strands_actors.contract.driver import Candidate, Live
from strands_actors.drivers.common.kit.velocity_base import LIFETIME_S
from strands_actors.drivers.yahboom.driver import YahboomM3Pro
from strands_actors.drivers.yahboom.gates import AXES
from strands_actors.drivers.yahboom.robots import table_of
from strands_actors.kernel.messages import Refused
from strands_actors.kernel.processes.guard import ALLOW, ALLOW_TOPICS, not_approved, unapproved
from strands_actors.surfaces.agents.calls import Call, read
from tests.drivers.yahboom.rig import KNOWN, NOW_NS, accepted, driver, refused, state

NOWHERE = (0.0, 0.0, 0.0) + (math.nan,) * 6
NOW_S = NOW_NS / 1e9


# -- the base


@pytest.mark.parametrize(("key", "most"), [("linear.x", 1.0), ("linear.y", 1.0), ("angular.z", 5.0)])
def test_saf_014_a_twist_beyond_its_limit_is_refused_and_not_clamped(key: str, most: float) -> None:
    for sign in (1, -1):
        assert refused({key: sign * (most + 0.01)}).code == "past_travel"
        assert accepted({key: sign * most}).values[:AXES].count(sign * most) == 1


@pytest.mark.parametrize("value", [math.nan, math.inf, "fast", True, None])
@pytest.mark.parametrize("key", ["linear.x", "arm1", "gripper.pos"])
def test_saf_014_a_value_that_is_not_a_finite_number_is_refused(key: str, value: object) -> None:
    assert refused({key: value}).code == "not_finite"


def test_saf_014_an_unknown_key_is_refused_with_the_known_ones() -> None:
    assert "Use linear.x, linear.y, angular.z, arm1" in refused({"vx": 0.1}).text


def test_saf_012_nothing_is_commanded_without_odometry() -> None:
    assert refused({"linear.x": 0.1}, state(age_ns=600_000_000)).code == "stale"
    assert refused({"arm1": 0.1}, state(age_ns=600_000_000)).code == "stale"


def test_saf_001_a_command_of_the_base_lives_300_ms() -> None:
    timing = driver().timing
    assert (timing.oneshot_ttl_s, timing.stream_ttl_s, timing.keepalive_s) == (LIFETIME_S, LIFETIME_S, 0.1)


def test_axes_that_are_not_named_rest_and_the_arm_stays() -> None:
    moving = state((0.5, 0.2, 1.0, *KNOWN[3:]), Live(NOW_NS + 1))
    assert accepted({"linear.y": -0.3}, moving) == Candidate((0.0, -0.3, 0.0, *KNOWN[3:], 0.0, 0.0, 1.0), (1,))


def test_saf_001_an_arm_command_keeps_the_twist_and_its_end() -> None:
    until_ns = NOW_NS + 10_000_000
    both = accepted({"arm1.pos": 0.2}, state((0.5, 0.0, 1.0, *KNOWN[3:]), Live(until_ns)))
    assert both.until_ns == until_ns
    assert both.values == (0.5, 0.0, 1.0, 0.2, *KNOWN[4:], 1500.0, NOW_S, 1.0)


@pytest.mark.parametrize("until_ns", [NOW_NS, NOW_NS - 1])
def test_saf_001_the_arm_does_not_bring_back_a_twist_that_has_ended(until_ns: int) -> None:
    alone = accepted({"arm1": 0.2}, state((0.5, 0.0, 1.0, *KNOWN[3:]), Live(until_ns)))
    assert alone.values[:3] == (0.0, 0.0, 0.0)
    assert alone.values[-1] == 0.0, "the arm's command does not command the base"


def test_the_target_of_an_earlier_action_is_used_unmodified() -> None:
    first = accepted({"arm1": 0.2, "time_ms": 700})
    then = accepted({"arm2": 0.1}, state(first.values))
    assert then.values[3:AXES] == (0.2, 0.1, *KNOWN[5:])
    assert then.values[AXES] == 1500.0


# -- the arm


@pytest.mark.parametrize(
    ("key", "low", "high"),
    [("arm1", -math.pi / 2, math.pi / 2), ("arm5", -math.pi / 2, math.pi), ("gripper", -1.54, 0.0)],
)
def test_saf_014_a_servo_past_its_range_is_refused(key: str, low: float, high: float) -> None:
    for value in (low - 0.01, high + 0.01):
        assert refused({key: value}).code == "past_travel"
    for value in (low, high):
        accepted({key: value})


def test_saf_014_degrees_for_radians_are_refused_with_a_hint() -> None:
    refusal = refused({"arm2": 110})
    assert "is 6393 deg of its servo, past 0..180; radians are expected" in refusal.text
    assert "radians are expected" not in refused({"arm2": 1.6}).text


def test_saf_011_a_command_for_part_of_an_arm_with_unknown_pose_is_refused() -> None:
    refusal = refused({"arm1": 0.1}, state(NOWHERE))
    assert refusal.code == "unknown_pose"
    assert "arm2, arm3, arm4, arm5, gripper" in refusal.offered
    whole = dict.fromkeys(driver().axes[3:], 0.0)
    accepted(whole, state(NOWHERE))
    assert accepted({"linear.x": 0.1}, state(NOWHERE)).values[-1] == 1.0, (
        "a base command is accepted without the arm's pose"
    )


def test_saf_014_a_servo_past_its_range_is_not_commanded_past_it() -> None:
    outside = (*KNOWN[:4], 2.0, *KNOWN[5:])
    assert "arm2" in refused({"arm1": 0.1}, state(outside)).text
    accepted({"arm1": 0.1, "arm2": 0.0}, state(outside))


@pytest.mark.parametrize("value", [0, -1, 30_001, 1.5, math.nan, "slow", True, None, math.inf])
def test_saf_014_a_time_out_of_range_is_refused(value: object) -> None:
    assert refused({"arm1": 0.1, "time_ms": value}).code == "bad_time"


@pytest.mark.parametrize("action", [{"time_ms": 500}, {"time_ms": 500, "linear.x": 0.1}])
def test_saf_014_a_time_without_a_joint_is_refused(action: dict[str, Any]) -> None:
    assert refused(action).code == "no_joint"


def test_conversion_is_in_whole_degrees_and_only_the_arm_has_signs() -> None:
    turned = driver(joint_signs=(-1.0, 1.0, 1.0, 1.0, -1.0))
    action = {"arm1": 0.5, "arm5": 0.5, "gripper": -1.54, "time_ms": 900}
    found = turned.parse(action, state())
    assert isinstance(found, Candidate)
    assert turned.commanded(action, found.values) == {"arm_deg": [61, 90, 90, 90, 61, 30], "time_ms": 900}
    assert [turned.table[at].limits for at in (3, 7)] == [
        pytest.approx((-math.pi / 2, math.pi / 2)),
        pytest.approx((-math.pi, math.pi / 2)),
    ]


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_servo_reports_its_commanded_angle(sign: float) -> None:
    for at, servo in enumerate(table_of("yahboom_m3pro").servos_by((sign,) * 5)):
        for degrees in range(servo.low_deg, servo.high_deg + 1):
            assert servo.whole_degrees(servo.radians(degrees)) == degrees
            # reported by a robot, which has no signs
            reported = table_of("yahboom_m3pro").servos[at].radians(degrees)
            assert servo.turned(reported) == pytest.approx(servo.radians(degrees))


def test_an_answer_has_only_the_commanded_axes() -> None:
    robot = driver()
    base, arm = accepted({"linear.x": 0.2}), accepted({"gripper": 0.0})
    assert robot.commanded({"linear.x": 0.2}, base.values) == {
        "twist": {"linear.x": 0.2, "linear.y": 0.0, "angular.z": 0.0}
    }
    assert robot.commanded({"gripper": 0.0}, arm.values) == {
        "arm_deg": [90, 90, 90, 90, 90, 180],
        "time_ms": 1500,
    }


def test_unknown_values_are_not_in_the_observation() -> None:
    assert driver().as_json(NOWHERE) == {"linear.x": 0.0, "linear.y": 0.0, "angular.z": 0.0}


# -- options and addresses


@pytest.mark.parametrize(
    "options",
    [
        {"timeout_s": 0},
        {"timeout_s": math.inf},
        {"joint_signs": (1.0,) * 4},
        {"joint_signs": (1.0, 1.0, 1.0, 1.0, 0.5)},
        {"joint_signs": "+++++"},
        {"move_time_ms": 0},
        {"move_time_ms": 30_001},
        {"move_time_ms": 1.5},
        {"transport": "carrier"},
    ],
)
def test_an_option_that_cannot_be_meant_is_refused(options: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match=next(iter(options))):
        driver(**options)


def test_an_unknown_option_is_refused_with_the_nearest() -> None:
    with pytest.raises(TypeError, match=r"'joint_sign' -> 'joint_signs'"):
        driver(joint_sign=(1.0,) * 5)


@pytest.mark.parametrize(
    ("port", "address"),
    [
        ("", ("127.0.0.1", 9090)),
        ("192.0.2.1", ("192.0.2.1", 9090)),
        ("192.0.2.1:9191", ("192.0.2.1", 9191)),
        ("ws://m3.example:9090/", ("m3.example", 9090)),
        ("[2001:db8::1]:9090", ("2001:db8::1", 9090)),
    ],
)
def test_the_port_is_an_address_and_the_robots_own_by_default(port: str, address: tuple[str, int]) -> None:
    assert YahboomM3Pro("yahboom_m3pro", port, {}).config.address() == address


def test_transports_are_the_drivers_own_and_the_twin() -> None:
    by_bridge = plan("yahboom_m3pro", "real", transport="rosbridge", port="192.0.2.1")
    assert (by_bridge.options["transport"], by_bridge.port, by_bridge.twin_process) == (
        "rosbridge",
        "192.0.2.1",
        None,
    )
    on_robot = plan("yahboom_m3pro", "real", transport="ros2", port="tcp/192.0.2.10:7447")
    assert (on_robot.options["transport"], on_robot.twin_process) == ("ros2", None)
    assert plan("yahboom_m3pro", "real", transport="twin").options["transport"] == "rosbridge"
    assert plan("yahboom_m3pro", "real").port == "", "without a port the robot's rosbridge is used"
    with pytest.raises(ValueError, match=r"It offers rosbridge, ros2, twin"):
        plan("yahboom_m3pro", "real", transport="serial")
    with pytest.raises(ValueError, match=r"are both given"):
        plan("yahboom_m3pro", "real", transport="twin", port="192.0.2.1")


# -- requests of an agent, and approvals of a person


def call(**inputs: object) -> Call:
    found = read(driver(), inputs)
    assert isinstance(found, Call), found
    return found


def test_verbs_come_to_actions_that_the_gates_accept() -> None:
    home = call(action="home").action
    target = accepted(home, state(NOWHERE))
    assert driver().commanded(home, target.values)["arm_deg"] == [90, 120, 0, 0, 90, 180]
    turned = driver(joint_signs=(-1.0,) * 5)
    mirrored = read(turned, {"action": "home"})
    assert isinstance(mirrored, Call)
    candidate = turned.parse(mirrored.action, state(NOWHERE))
    assert isinstance(candidate, Candidate)
    assert turned.commanded(mirrored.action, candidate.values)["arm_deg"] == [90, 120, 0, 0, 90, 180]
    assert call(action="move", **{"linear.x": 0.2}).action == {"linear.x": 0.2, "linear.y": 0.0, "angular.z": 0.0}
    assert call(action="gripper", gripper=-1.0, time_ms=500).action == {"gripper": -1.0, "time_ms": 500}
    assert call(action="arm", arm2=0.1).action == {"arm2": 0.1}
    assert isinstance(read(driver(), {"action": "gripper"}), Refused)


def asked(action: dict[str, Any]) -> tuple[str, ...]:
    robot = driver()
    return unapproved(robot.GUARDED, robot.to_approve(action), robot.TOPICS)


@pytest.fixture
def nothing_allowed(monkeypatch: pytest.MonkeyPatch) -> None:
    for variable in (ALLOW, ALLOW_TOPICS):
        monkeypatch.delenv(variable, raising=False)


@pytest.mark.usefixtures("nothing_allowed")
def test_every_twist_needs_approval_and_a_zero_never_does() -> None:
    assert asked({"linear.x": 0.1, "linear.y": 0.0, "angular.z": -0.1}) == ("angular.z", "linear.x")
    assert asked({"linear.x.pos": 0.1}) == ("linear.x",)
    for zero in (0, 0.0, -0.0):
        assert asked({"linear.x": zero, "linear.y": zero, "angular.z": zero}) == ()
    assert asked({"arm1": 0.5, "time_ms": 300}) == ()


@pytest.mark.usefixtures("nothing_allowed")
@pytest.mark.parametrize("value", [False, "0", None, math.nan, 1e-9])
def test_a_twist_that_only_looks_like_zero_needs_approval(value: object) -> None:
    assert asked({"linear.x": value}) == ("linear.x",)


@pytest.mark.usefixtures("nothing_allowed")
def test_the_topic_allows_all_of_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(ALLOW_TOPICS, "/scan0, /cmd_vel")
    assert asked({"linear.x": 0.1, "angular.z": 1.0}) == ()
    monkeypatch.setenv(ALLOW_TOPICS, "/cmd_vel_other")
    assert asked({"linear.x": 0.1}) == ("linear.x",)
    assert "needs an operator's approval" in not_approved("move", asked({"linear.x": 0.1}), "nobody").text
    monkeypatch.setenv(ALLOW, "linear.x")
    assert asked({"linear.x": 0.1, "linear.y": 0.1}) == ("linear.y",)


# -- verbs in the servos' own degrees, as in scripts of strands-robots


def test_the_gripper_opens_and_closes_by_a_truth_value() -> None:
    made = driver()
    opened = read(made, {"action": "set_gripper", "open": True, "time_ms": 800})
    closed = read(made, {"action": "set_gripper", "open": False})
    assert isinstance(opened, Call) and opened.action == {"gripper": pytest.approx(0.0), "time_ms": 800}
    assert isinstance(closed, Call) and closed.action == {"gripper": pytest.approx(-1.54)}
    assert isinstance(read(made, {"action": "set_gripper", "open": 1}), Refused)


def test_six_servo_angles_go_out_as_the_same_whole_degrees() -> None:
    made = YahboomM3Pro("yahboom_m3pro", "", {"joint_signs": (1.0, -1.0, 1.0, 1.0, 1.0)})
    pose = [91, 120, 10, 20, 200, 30]
    call = read(made, {"action": "set_arm_degrees", "joints": pose})
    assert isinstance(call, Call)
    servos = table_of("yahboom_m3pro").servos_by((1.0, -1.0, 1.0, 1.0, 1.0))
    assert [servo.whole_degrees(call.action[servo.key]) for servo in servos] == pose


@pytest.mark.parametrize(
    "joints", [[], [90] * 5, [90] * 7, [90] * 5 + [10], [90, 181] + [90] * 4, ["x"] + [90] * 5]
)
def test_saf_014_an_invalid_pose_in_degrees_is_refused(joints: list[Any]) -> None:
    refusal = read(driver(), {"action": "set_arm_degrees", "joints": joints})
    assert isinstance(refusal, Refused) and "give 6 servo angles in degrees: arm1 0..180" in refusal.remedy
