"""Test rosbridge's JSON and its messages: exact texts, and only the codec's own error for any input."""

from __future__ import annotations

import json
import math
import random
from typing import Any

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from strands_actors.drivers.common.codecs.malformed import MalformedFrame
from strands_actors.drivers.yahboom import messages as m
from strands_actors.drivers.yahboom import protocol as p
from strands_actors.drivers.yahboom.rosbridge import RosbridgeLink
from strands_actors.drivers.yahboom.twin import BridgeSession, M3ProTwin
from strands_actors.kernel.clock import MonotonicClock
from tests.drivers.disturbed import DISTURBED
from tests.drivers.yahboom.rig import driver

ZERO = '{"linear":{"x":%s,"y":%s,"z":%s},"angular":{"x":%s,"y":%s,"z":%s}}'


def twist(text: str) -> tuple[m.Twist, bool]:
    requested = p.decode_client_operation(text)
    assert isinstance(requested, p.Publish) and requested.topic == m.CMD_VEL
    return m.read_twist(p.decode_message(requested.msg))


def test_operations_are_written_as_rosbridge_reads_them() -> None:
    assert p.encode(p.Advertise(m.CMD_VEL, "geometry_msgs/Twist")) == (
        '{"op":"advertise","topic":"/cmd_vel","type":"geometry_msgs/Twist"}'
    )
    assert p.encode(p.Subscribe("/scan0", "sensor_msgs/LaserScan", 200.0)) == (
        '{"op":"subscribe","topic":"/scan0","type":"sensor_msgs/LaserScan","throttle_rate":200.0}'
    )
    assert p.encode(p.CallService(p.TIME_SERVICE, id="1")) == (
        '{"op":"call_service","service":"/rosapi/get_time","id":"1"}'
    )


def test_a_setpoint_is_written_in_fractions_and_a_stop_in_whole_numbers() -> None:
    setpoint = p.publish(m.CMD_VEL, m.twist_message(m.REST))
    assert setpoint.endswith('"msg":' + ZERO % (("0.0",) * 6) + "}")
    stop = p.publish(m.CMD_VEL, m.twist_message(m.Twist(1.0, 1.0, 1.0), stop=True))
    assert stop.endswith('"msg":' + ZERO % (("0",) * 6) + "}"), "a stop is zero for every twist"


@given(st.floats(-1, 1), st.floats(-1, 1), st.floats(-5, 5))
def test_no_setpoint_passes_for_a_stop(x: float, y: float, yaw: float) -> None:
    wanted = m.Twist(x, y, yaw)
    assert twist(p.publish(m.CMD_VEL, m.twist_message(wanted))) == (wanted, False)
    assert twist(p.publish(m.CMD_VEL, m.twist_message(wanted, stop=True))) == (m.REST, True)


def test_an_arm_goal_is_six_servos_and_a_time() -> None:
    goal = m.ArmGoal((90, 120, 0, 0, 90, 180), 1500)
    assert m.arm_message(goal) == {
        "joint1": 90, "joint2": 120, "joint3": 0, "joint4": 0, "joint5": 90, "joint6": 180, "time": 1500,
    }  # fmt: skip
    assert m.read_arm(m.arm_message(goal)) == goal


@pytest.mark.parametrize("goal", [((90,) * 5, 1500), ((90,) * 6, 40_000), ((-1, *(90,) * 5), 1500)])
def test_saf_014_an_arm_goal_that_no_int16_holds_is_not_written(goal: tuple[tuple[int, ...], int]) -> None:
    with pytest.raises(ValueError, match="arm goal"):
        m.arm_message(m.ArmGoal(*goal))


@pytest.mark.parametrize(
    "message",
    [{}, {"joint1": 90}, {**{f"joint{at}": 90.0 for at in range(1, 7)}, "time": 1}, {"time": True}],
)
def test_an_arm_goal_that_lacks_something_is_refused(message: dict[str, Any]) -> None:
    with pytest.raises(MalformedFrame, match="ArmJoints"):
        m.read_arm(message)


def report(topic: str, **options: Any) -> dict[str, Any]:
    return M3ProTwin("yahboom_m3pro", lambda: 0.0, **options).graph.message(topic)


def told(topic: str, message: object) -> m.Message:
    return m.read_report(topic, json.dumps(message).encode())


def test_reports_are_read() -> None:
    odometry = told(m.ODOMETRY, report(m.ODOMETRY))
    assert odometry == m.Odometry(0, 0.0, 0.0, 0.0, m.REST)
    imu = told(m.IMU, report(m.IMU))
    assert isinstance(imu, m.Imu) and imu.acceleration_m_s2 == (0.0, 0.0, 9.81)
    joints = told(m.JOINT_STATES, report(m.JOINT_STATES))
    assert isinstance(joints, dict) and joints["arm2"] == pytest.approx(math.radians(30))
    assert told("/scan0", report("/scan0")) == 2.0


def test_a_scan_in_which_nothing_is_near_has_no_nearest() -> None:
    scan = {"range_min": 0.1, "range_max": 12.0, "ranges": [None, 0.0, 0.05, 13.0]}
    nearest = told("/scan1", scan)
    assert isinstance(nearest, float) and math.isnan(nearest)


@pytest.mark.parametrize("drop", ["header", "pose", "twist"])
def test_odometry_that_cannot_confirm_a_stop_is_refused(drop: str) -> None:
    message = report(m.ODOMETRY)
    del message[drop]
    with pytest.raises(MalformedFrame, match="odom_raw"):
        told(m.ODOMETRY, message)


@pytest.mark.parametrize("speed", [m.Twist(0.02, 0, 0), m.Twist(0, -0.02, 0), m.Twist(0, 0, 0.03)])
def test_a_base_that_moves_in_any_way_does_not_stand(speed: m.Twist) -> None:
    assert not m.stands(speed)
    assert not m.stands(speed._replace(x=math.nan))
    assert m.stands(m.Twist(0.001, -0.001, 0.001))


@pytest.mark.parametrize(
    "text",
    ["", "null", "[]", "{}", '{"op":1}', '{"op":"png","data":""}', '{"op":"publish"}', "NaN", '{"op":"publish",'],
)
def test_an_invalid_operation_is_malformed(text: str) -> None:
    with pytest.raises(MalformedFrame, match="no operation"):
        p.decode_incoming(text)
    with pytest.raises(MalformedFrame, match="no operation"):
        p.decode_client_operation(text)


def test_a_binary_message_is_malformed() -> None:
    with pytest.raises(MalformedFrame, match="binary"):
        p.decode_incoming(p.encode(p.Status("info")).encode())


def samples() -> list[str]:
    answer = p.response(p.CallService(p.TOPICS_SERVICE, id="1"), {"topics": ["/cmd_vel"], "types": ["x/Y"]})
    return [
        p.publish(m.CMD_VEL, m.twist_message(m.Twist(0.5, 0.0, -0.1))),
        p.publish(m.ARM, m.arm_message(m.ArmGoal((90,) * 6, 1500))),
        *(p.publish(topic, report(topic)) for topic in (m.ODOMETRY, m.IMU, m.JOINT_STATES, "/scan0")),
        p.encode(p.Subscribe(m.ODOMETRY, "nav_msgs/Odometry", 20.0)),
        p.encode(p.CallService(p.TYPE_SERVICE, {"topic": "/cmd_vel"}, "2")),
        p.encode(p.Status("error", "no")),
        answer,
    ]


def disturbed(random_: random.Random, texts: list[str]) -> str:
    """Return a text with pieces that are lost, doubled, changed, or from another text."""
    text = list(random_.choice(texts))
    for _ in range(random_.randint(1, 4)):
        at = random_.randrange(len(text) + 1)
        match random_.randrange(5):
            case 0:
                del text[at : at + random_.randint(1, 30)]
            case 1:
                text[at:at] = random_.choice(['"', "{", "}", "[", "9" * 5000, "null", "-", "1e999", "\\u0000", "é"])
            case 2:
                text[at:at] = text[at : at + 40]
            case 3:
                other = random_.choice(texts)
                text[at:] = other[random_.randrange(len(other)) :]
            case _:
                text[at : at + 1] = chr(random_.randrange(0x20, 0x17F))
    return "".join(text)


def test_saf_014_disturbed_texts_raise_only_the_codecs_error_and_command_declared_values() -> None:
    """This covers both ends. Each command that the twin accepts can be displayed as one."""
    random_, texts = random.Random(22), samples()
    said: list[str] = []
    twin = M3ProTwin("yahboom_m3pro", lambda: 0.0)
    session = BridgeSession(twin.graph, said.append)
    link = RosbridgeLink(driver().config, MonotonicClock())
    for _ in range(DISTURBED):
        text = disturbed(random_, texts)
        kind, safe_state = session.take(text)
        assert (kind == "safe") == (safe_state == "zero")
        assert all(math.isfinite(value) for value in (*twin.mechanism.commanded, *twin.mechanism.degrees))
        del said[:]
        link._take(text)
    session.publish(1e9)
    assert 0 < link.news.malformed < DISTURBED
    assert len(said) <= len(twin.graph.hz), "the memory is bounded: one subscription for each topic"


def test_numbers_that_json_can_write_and_a_double_cannot_hold_are_malformed() -> None:
    with pytest.raises(MalformedFrame):
        p.decode_message(msgspec.Raw(b'{"linear":{"x":1e999}}'))
