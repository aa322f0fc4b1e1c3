"""Test ``transport="ros2"`` with a stand-in for rclpy in the wire process, and a DDS participant in place of
the base for the root's channel. Neither was run on a robot."""

from __future__ import annotations

import contextlib
import math
import random
import struct
import time
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from types import SimpleNamespace
from typing import Any

import pytest
import trio

from strands_actors.contract.wire import WireDown
from strands_actors.drivers.common.codecs.malformed import MalformedFrame
from strands_actors.drivers.common.kit.reporting_base import stop_until_it_stands
from strands_actors.drivers.common.kit.sdk import load_sdk
from strands_actors.drivers.common.rtps import Participant
from strands_actors.drivers.yahboom import dds
from strands_actors.drivers.yahboom import messages as m
from strands_actors.drivers.yahboom.config import DOMAIN, domain_of_environment
from strands_actors.drivers.yahboom.driver import YahboomM3Pro
from strands_actors.drivers.yahboom.ros2 import Ros2Link
from strands_actors.drivers.yahboom.stop import YahboomStopChannel
from strands_actors.drivers.yahboom.wire import YahboomWire, link_of
from strands_actors.kernel.clock import MonotonicClock, VirtualClock
from tests.drivers.common.memory_port import Permission, virtual
from tests.drivers.yahboom.rig import ChannelTo, state


@pytest.fixture(autouse=True)
def no_domain(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("ROS_DOMAIN_ID", raising=False)


def driver() -> YahboomM3Pro:
    return YahboomM3Pro("yahboom_m3pro", "ignored", {"transport": "ros2", "timeout_s": 2.0})


# -- a stand-in for rclpy


class Blank:
    """A message of any type. Attributes exist as soon as they are read."""

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        value = Blank()
        setattr(self, name, value)
        return value


class Publisher:
    def __init__(self, ros: StandIn, topic: str) -> None:
        self._ros, self._topic = ros, topic

    def publish(self, message: Any) -> None:
        if self._ros.broken:
            raise RuntimeError("publisher's context is invalid")
        self._ros.published.append((self._topic, message))

    def wait_for_all_acked(self, duration: Any) -> bool:
        time.sleep(self._ros.hangs_s)
        return self._ros.acknowledges


class Node:
    def __init__(self, ros: StandIn) -> None:
        self._ros = ros

    def create_publisher(self, kind: type, topic: str, depth: int) -> Publisher:
        return Publisher(self._ros, topic)

    def create_subscription(self, kind: type, topic: str, heard: Callable[[Any], None], quality: str) -> None:
        assert quality == "sensor data"
        self._ros.heard[topic] = heard

    def get_topic_names_and_types(self) -> list[tuple[str, list[str]]]:
        return [("/cmd_vel", ["geometry_msgs/msg/Twist"]), ("/odom_raw", ["nav_msgs/msg/Odometry"])]

    def count_subscribers(self, topic: str) -> int:
        return 0 if topic in self._ros.unheard else 1

    def destroy_node(self) -> None:
        self._ros.nodes -= 1


class StandIn:
    """The rclpy calls that the wire uses, and a base that follows its commands."""

    def __init__(self) -> None:
        self.published: list[tuple[str, Any]] = []
        self.heard: dict[str, Callable[[Any], None]] = {}
        self.unheard: set[str] = set()
        self.acknowledges = True
        self.broken = False
        self.hangs_s = 0.0
        self.silent = False
        self.repeats = False  # True: it repeats one stamp
        self.nodes = 0
        self.domain = -1
        self._told_ns = 0

    def load(self, module: str, install: str) -> Any:
        if module.endswith(".msg"):
            return SimpleNamespace(
                Twist=Blank, ArmJoints=Blank, Odometry=Blank, Imu=Blank, JointState=Blank, LaserScan=Blank
            )
        return {
            "rclpy": SimpleNamespace(
                Context=object, init=self._init, create_node=self._node, shutdown=lambda context: None
            ),
            "rclpy.signals": SimpleNamespace(SignalHandlerOptions=SimpleNamespace(NO="none")),
            "rclpy.qos": SimpleNamespace(qos_profile_sensor_data="sensor data"),
            "rclpy.duration": SimpleNamespace(Duration=lambda seconds: seconds),
            "rclpy.executors": SimpleNamespace(SingleThreadedExecutor=lambda context: self),
        }[module]

    def _init(self, context: object, domain_id: int, signal_handler_options: str) -> None:
        assert signal_handler_options == "none"
        self.domain = domain_id

    def _node(self, name: str, context: object) -> Node:
        self.nodes += 1
        return Node(self)

    # an executor's method

    def add_node(self, node: Node) -> None: ...
    def shutdown(self, timeout_sec: float) -> None: ...

    def spin_once(self, timeout_sec: float) -> None:
        assert timeout_sec == 0, "spin_once must not wait"
        now_ns = round(trio.current_time() * 1e9)
        if self.silent or now_ns - self._told_ns < 20_000_000:
            return
        self._told_ns = now_ns
        told = Blank()
        stamp_ns = 0 if self.repeats else now_ns
        told.header.stamp.sec, told.header.stamp.nanosec = divmod(stamp_ns, 10**9)
        told.pose.pose.position.x = told.pose.pose.position.y = 0.0
        turned = told.pose.pose.orientation
        turned.x, turned.y, turned.z, turned.w = 0.0, 0.0, 0.0, 1.0
        speeds = told.twist.twist
        twists = [message for topic, message in self.published if topic == m.CMD_VEL]
        speeds.linear.x = twists[-1].linear.x if twists else 0.0
        speeds.linear.y = speeds.angular.z = 0.0
        self.heard[m.ODOMETRY](told)


def test_a_wire_on_rclpy_opens_drives_and_stops() -> None:
    async def test() -> None:
        ros, robot = StandIn(), driver()
        clock = VirtualClock()
        wire = YahboomWire(robot.config, clock, Ros2Link(robot.config, clock, ros.load))
        facts = await wire.open()
        assert (facts["ros2"], ros.domain, ros.nodes) == ("domain 30", DOMAIN, 1)
        assert ros.published == []
        async with trio.open_nursery() as nursery:
            await nursery.start(wire.serve)
            seen = await wire.arm(Permission())
            assert math.isnan(seen.position[3]), "over rclpy the robot reports no arm"
            candidate = robot.parse({"linear.x": 0.4, "arm1": 0.0, "time_ms": 700}, state())
            await wire.write(candidate.values, Permission())  # type: ignore[union-attr]
            (_, zero), (topic, twist), (arm_topic, arm) = ros.published
            assert (zero.linear.x, zero.linear.y, zero.angular.z) == (0.0, 0.0, 0.0)
            assert (topic, twist.linear.x) == (m.CMD_VEL, 0.4)
            assert (arm_topic, arm.joint1, arm.joint6, arm.time) == (m.ARM, 90, 180, 700)
            await trio.sleep(0.05)
            assert (await wire.read()).position[0] == 0.4
            reports = await wire.make_safe("zero")
            assert all(report.safe for report in reports)
            assert len(ros.published) >= 3 + 3
            nursery.cancel_scope.cancel()
        wire.close()
        assert ros.nodes == 0

    trio.run(test)


def test_saf_005_without_acknowledgement_or_odometry_a_stop_is_not_confirmed() -> None:
    async def test() -> None:
        ros, robot = StandIn(), driver()
        link = Ros2Link(robot.config, VirtualClock(), ros.load)
        await link.open()
        ros.acknowledges = False
        outcome = await stop_until_it_stands(link, 0.3)
        assert (outcome.written, outcome.acknowledged) == (True, False)
        assert "no acknowledgement" in outcome.detail or "has not answered" in outcome.detail
        ros.acknowledges, ros.silent = True, True
        outcome = await stop_until_it_stands(link, 0.5)
        assert outcome.acknowledged and "reported nothing since" in outcome.detail
        ros.broken = True
        outcome = await stop_until_it_stands(link, 0.3)
        assert not outcome.written and "context is invalid" in outcome.detail

    trio.run(test)


def test_saf_010_a_call_of_rclpy_that_hangs_does_not_keep_a_stop() -> None:
    async def test() -> None:
        ros, robot = StandIn(), driver()
        link = Ros2Link(robot.config, VirtualClock(), ros.load)
        await link.open()
        ros.hangs_s = 1.0
        began_s = trio.current_time()
        outcome = await stop_until_it_stands(link, 1.2)
        assert "wait_for_all_acked did not return" in outcome.detail
        assert outcome.written and not outcome.acknowledged
        assert trio.current_time() - began_s < 1.2 + 1.0, "zero was repeated meanwhile"
        assert len(ros.published) > 10

    trio.run(test)


def test_a_base_that_was_not_started_is_named() -> None:
    async def test() -> None:
        ros, robot = StandIn(), driver()
        ros.unheard.add(m.ARM)
        with pytest.raises(WireDown, match="no node subscribes to /arm6_joints within 2 s"):
            await Ros2Link(robot.config, VirtualClock(), ros.load).open()
        assert ros.nodes == 0
        ros.unheard.clear()
        ros.silent = True
        with pytest.raises(WireDown, match="no odometry within 2 s"):
            await Ros2Link(robot.config, VirtualClock(), ros.load).open()

    virtual(test)


def test_saf_012_a_base_that_repeats_its_report_is_no_connection() -> None:
    async def test() -> None:
        ros, robot = StandIn(), driver()
        ros.repeats = True
        with pytest.raises(WireDown, match="odometry never changes its stamp within 2 s"):
            await Ros2Link(robot.config, VirtualClock(), ros.load).open()
        assert ros.published == []

    virtual(test)


def test_without_rclpy_the_error_has_its_install_line() -> None:
    async def test() -> None:
        wire = YahboomWire(driver().config, MonotonicClock())
        with pytest.raises(WireDown, match=r"rclpy cannot be used .*source /opt/ros"):
            await wire.open()

    assert link_of(driver().config, MonotonicClock()).__class__ is Ros2Link
    with pytest.raises(WireDown):
        load_sdk("rclpy", "x")  # neither installed nor provided by this test
    trio.run(test)


@pytest.mark.parametrize(("text", "domain"), [("", DOMAIN), ("0", 0), ("42", 42)])
def test_the_domain_is_the_environments(monkeypatch: pytest.MonkeyPatch, text: str, domain: int) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", text)
    assert domain_of_environment() == domain


@pytest.mark.parametrize("text", ["-1", "233", "mine"])
def test_an_invalid_domain_is_refused(monkeypatch: pytest.MonkeyPatch, text: str) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", text)
    with pytest.raises(WireDown, match=r"Give 0\.\.232, or unset it for 30"):
        domain_of_environment()


# -- the root's channel over DDS


def odometry_cdr(stamp_ns: int, speed: float, frame: str = "odom", child: str = "base_footprint") -> bytes:
    """Return a ``nav_msgs/msg/Odometry`` as ROS 2 encodes it."""
    body = struct.pack("<iI", *divmod(stamp_ns, 10**9))
    for text in (frame, child):
        body += bytes(-len(body) % 4) + struct.pack("<I", len(text) + 1) + text.encode() + b"\0"
    body += bytes(-len(body) % 8)
    body += struct.pack("<7d", 1.0, 2.0, 0.0, 0.0, 0.0, math.sin(0.25), math.cos(0.25)) + bytes(36 * 8)
    return dds.CDR + body + struct.pack("<6d", speed, -0.1, 0.0, 0.0, 0.0, 0.2) + bytes(36 * 8)


@pytest.mark.parametrize("frame", ["odom", "", "odom_frame_of_the_robot"])
def test_odometry_is_read_with_any_frame_names(frame: str) -> None:
    told = dds.decode_odometry(odometry_cdr(12_345_678_901, 0.5, frame)[4:])
    assert told.stamp_ns == 12_345_678_901
    assert (told.x_m, told.y_m, told.yaw_rad) == (1.0, 2.0, pytest.approx(0.5))
    assert told.speed == m.Twist(0.5, -0.1, 0.2)


def test_disturbed_odometry_raises_only_the_codecs_error() -> None:
    random_, whole = random.Random(22), odometry_cdr(1, 0.5)[4:]
    for _ in range(5000):
        body = bytearray(whole[: random_.randrange(1, len(whole) + 1)])
        for _ in range(random_.randint(1, 6)):
            body[random_.randrange(len(body))] = random_.randrange(256)
        with contextlib.suppress(MalformedFrame):
            assert isinstance(dds.decode_odometry(bytes(body)), m.Odometry)


def test_odometry_that_ends_early_is_malformed() -> None:
    whole = odometry_cdr(1, 0.5)[4:]
    for size in range(len(whole) - 36 * 8):
        with pytest.raises(MalformedFrame):
            dds.decode_odometry(whole[:size])
    with pytest.raises(MalformedFrame):
        dds.decode_odometry(whole[:8] + b"\xff\xff\xff\xff" + whole[12:])


class Base:
    """The node of the base, as a participant: it reads ``/cmd_vel``, and publishes its speed."""

    def __init__(self, host: str) -> None:
        self.participant = Participant(DOMAIN, host, multicast=False)
        self.twists: list[tuple[float, ...]] = []
        self.participant.reader(dds.TWIST_TOPIC, dds.TWIST_TYPE, self._heard, reliable=True)
        self._odometry = self.participant.writer(dds.ODOMETRY_TOPIC, dds.ODOMETRY_TYPE)
        self.speed = 0.5
        self.stops = True

    def _heard(self, payload: memoryview, writer: bytes, t_ns: int) -> None:
        self.twists.append(struct.unpack("<6d", payload[4:]))
        if self.stops:
            self.speed = self.twists[-1][0]

    async def report(self) -> None:
        while True:
            now_ns = round(trio.current_time() * 1e9)
            body = odometry_cdr(now_ns, self.speed)
            still = struct.pack("<6d", self.speed, 0.0, 0.0, 0.0, 0.0, 0.0)
            self._odometry.write(body[: -(36 * 8 + 48)] + still + bytes(36 * 8))
            await trio.sleep(0.02)


@asynccontextmanager
async def base_and_channel(host: str) -> AsyncIterator[tuple[Base, YahboomStopChannel, dds.DdsLink]]:
    base = Base(host)
    clock, config = MonotonicClock(), driver().config
    link = dds.DdsLink(config, clock, host, (base.participant.address,))
    channel = ChannelTo(lambda: link, config, clock)
    try:
        async with trio.open_nursery() as nursery:
            await nursery.start(base.participant.run)
            nursery.start_soon(base.report)
            with trio.fail_after(10.0):
                await nursery.start(channel.serve)
            yield base, channel, link
            nursery.cancel_scope.cancel()
    finally:
        channel.close()
        base.participant.close()


def test_saf_003_the_root_stops_the_base_without_rclpy() -> None:
    async def test() -> None:
        async with base_and_channel("127.0.0.91") as (base, channel, _):
            assert base.twists == [], "nothing is written before a stop"
            reports = await channel.make_safe("zero")
            assert all(report.safe for report in reports), reports[0].detail
            assert len(base.twists) >= 3 and set(base.twists) == {(0.0,) * 6}
            base.stops, base.speed = False, 0.5
            reports = await channel.make_safe("zero")
            assert "it reports speed 0.5, 0, 0" in reports[0].detail

    trio.run(test)


def test_without_a_base_the_way_by_dds_does_not_stand() -> None:
    async def test() -> None:
        link = dds.DdsLink(driver().config, MonotonicClock(), "127.0.0.93", ("127.0.0.94:7999",))
        with pytest.raises(WireDown, match="no node subscribes to /cmd_vel in domain 30"):
            await link.connect()
        with pytest.raises(WireDown, match="no node subscribes"):
            link.zero()
        link.close()

    trio.run(test)
