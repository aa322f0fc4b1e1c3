"""Test the twin with the unmodified roslibpy, and the robot behind it."""

from __future__ import annotations

import json
import math
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from strands_actors.drivers.common.physics.body import Commander
from strands_actors.drivers.common.twin import Fault
from strands_actors.drivers.yahboom import messages as m
from strands_actors.drivers.yahboom import protocol as p
from strands_actors.drivers.yahboom.twin import BridgeSession, M3ProTwin
from strands_actors.testing import Twin

from .rig import judge_client


def test_roslibpy_drives_reads_and_gets_errors(tmp_path: Path) -> None:
    with Twin("yahboom_m3pro", tmp_path) as twin:
        host, _, port = twin.port.rpartition(":")
        done = subprocess.run(
            [sys.executable, "-m", "tests.drivers.yahboom.roslibpy_client", host, port],
            capture_output=True,
            text=True,
            timeout=60.0,
            check=False,
        )
        assert done.returncode == 0, done.stderr
        seen: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
        judge_client(seen, twin)


# -- the robot itself


class Clock:
    """A clock that the test advances."""

    def __init__(self) -> None:
        self.now_s = 0.0

    def __call__(self) -> float:
        return self.now_s


def robot(**options: Any) -> tuple[M3ProTwin, Clock]:
    clock = Clock()
    return M3ProTwin("yahboom_m3pro", clock, **options), clock


def run(twin: M3ProTwin, clock: Clock, seconds: float) -> m.Odometry:
    for _ in range(round(seconds / 0.01)):
        clock.now_s += 0.01
        twin.mechanism.pass_time()
    return twin.mechanism.odometry()


def test_its_firmware_zeroes_the_base_after_300_ms() -> None:
    twin, clock = robot()
    twin.mechanism.drive(m.Twist(0.5, 0.0, 0.0), Commander.WIRE)
    assert run(twin, clock, 0.28).speed.x == 0.5
    assert run(twin, clock, 0.3).speed == m.REST
    never, clock = robot(watchdog_s=0)
    never.mechanism.drive(m.Twist(0.5, 0.0, 0.0), Commander.WIRE)
    assert run(never, clock, 10.0).speed.x == 0.5


def test_a_pause_is_dropped_and_not_driven() -> None:
    twin, clock = robot(watchdog_s=0)
    twin.mechanism.drive(m.Twist(1.0, 0.0, 0.0), Commander.WIRE)
    run(twin, clock, 0.5)
    before = twin.mechanism.odometry().x_m
    clock.now_s += 8.0
    twin.mechanism.pass_time()
    assert twin.mechanism.odometry().x_m - before < 0.3


def test_it_drives_sideways_and_turns_and_no_faster_than_it_can() -> None:
    twin, clock = robot(watchdog_s=0)
    twin.mechanism.drive(m.Twist(0.0, 0.5, 0.0), Commander.WIRE)
    assert run(twin, clock, 1.0).y_m == pytest.approx(0.47, abs=0.02)
    twin.mechanism.drive(m.Twist(1e300, -1e300, 1e300), Commander.WIRE)
    reported = run(twin, clock, 1.0)
    assert reported.speed == m.Twist(1.0, -1.0, 5.0)
    assert math.isfinite(reported.x_m)


def test_servos_take_the_time_they_are_given_and_stay_within_their_range() -> None:
    twin, clock = robot()
    twin.mechanism.move_arm(m.ArmGoal((180, 120, 0, 0, 90, 0), 1000), Commander.WIRE)
    run(twin, clock, 0.5)
    assert twin.mechanism.degrees[0] == pytest.approx(135.0, abs=2.0)
    run(twin, clock, 0.6)
    assert twin.mechanism.degrees == pytest.approx([180.0, 120.0, 0.0, 0.0, 90.0, 30.0])


def said(twin: M3ProTwin, *texts: str) -> list[p.BridgeOperation]:
    messages: list[str] = []
    session = BridgeSession(twin.graph, messages.append)
    for text in texts:
        session.take(text)
    return [p.decode_incoming(text) for text in messages]


def test_a_wrong_type_is_objected_to() -> None:
    twin, _ = robot()
    for operation in (p.Advertise("/cmd_vel", "std_msgs/String"), p.Subscribe("/odom_raw", "std_msgs/String")):
        (reported,) = said(twin, p.encode(operation))
        assert isinstance(reported, p.Status) and "already established with type" in reported.msg
    for kind in ("geometry_msgs/Twist", "geometry_msgs/msg/Twist"):
        assert said(twin, p.encode(p.Advertise("/cmd_vel", kind))) == []


@pytest.mark.parametrize(
    "text",
    ['{"op":"publish","topic":"/cmd_vel","msg":{"linear":{"x":"fast"}}}',
     '{"op":"publish","topic":"/arm6_joints","msg":{"joint1":90}}',
     '{"op":"publish","topic":"/nowhere","msg":{}}'],
)  # fmt: skip
def test_an_invalid_message_is_answered_with_an_error_and_moves_nothing(text: str) -> None:
    twin, _ = robot()
    before = (twin.mechanism.commanded, list(twin.mechanism.degrees))
    (reported,) = said(twin, text)
    assert isinstance(reported, p.Status) and reported.level == "error"
    assert before == (twin.mechanism.commanded, twin.mechanism.degrees)


def test_missing_fields_of_a_twist_are_zero_as_in_ros() -> None:
    twin, _ = robot()
    assert said(twin, '{"op":"publish","topic":"/cmd_vel","msg":{"linear":{"x":0.5}}}') == []
    assert twin.mechanism.commanded == m.Twist(0.5, 0.0, 0.0)


def test_subscriptions_are_throttled_and_ended() -> None:
    twin, _ = robot()
    messages: list[str] = []
    session = BridgeSession(twin.graph, messages.append)
    session.take(p.encode(p.Subscribe("/odom_raw", throttle_rate=500)))
    for at in range(100):
        session.publish(1.0 + at * 0.02)
    assert 4 <= len(messages) <= 6
    session.take(p.encode(p.Unsubscribe("/odom_raw")))
    session.publish(100.0)
    assert len(messages) <= 6


@pytest.mark.parametrize("service", ["/rosapi/topics", "rosapi/topics"])
def test_a_service_is_found_with_or_without_its_slash(service: str) -> None:
    (reported,) = said(robot()[0], p.encode(p.CallService(service, id="1")))
    assert isinstance(reported, p.ServiceResponse) and reported.result and "/cmd_vel" in reported.values["topics"]


@pytest.mark.parametrize("joints", [None, False, True])
def test_only_a_robot_with_the_option_has_joint_states(joints: bool | None) -> None:
    """The real robot has none. The option is for a robot whose owner publishes them."""
    twin, _ = robot() if joints is None else robot(joints=joints)
    (reported,) = said(twin, p.encode(p.CallService(p.TOPICS_SERVICE, id="1")))
    assert isinstance(reported, p.ServiceResponse)
    assert ("/joint_states" in reported.values["topics"]) == bool(joints)


def test_a_stuck_robot_repeats_its_report_and_stands_and_a_wrong_one_reports_a_higher_speed() -> None:
    twin, clock = robot()
    twin.mechanism.drive(m.Twist(0.5, 0.0, 0.0), Commander.WIRE)
    run(twin, clock, 0.2)
    twin.set_fault(Fault.STUCK)
    run(twin, clock, 0.2)
    assert twin.graph.message(m.ODOMETRY)["twist"]["twist"]["linear"]["x"] == 0.5
    assert twin.mechanism.runs == m.REST
    twin.set_fault(Fault.WRONG)
    assert twin.graph.message(m.ODOMETRY)["twist"]["twist"]["linear"]["x"] == 0.5
    twin.set_fault(Fault.OFF)
    assert twin.mechanism.degrees == [90.0, 120.0, 0.0, 0.0, 90.0, 180.0]
