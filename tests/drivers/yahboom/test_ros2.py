"""The transport ``ros2``: the M3 Pro as a node of a graph. A second node, in this process, is the robot's base."""

from __future__ import annotations

import math
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Any

import pytest
import trio

from strands_actors.contract.wire import WireDown
from strands_actors.drivers.common.kit.reporting_base import stop_until_it_stands
from strands_actors.drivers.yahboom import messages as m
from strands_actors.drivers.yahboom.config import DOMAIN, domain_of_environment
from strands_actors.drivers.yahboom.driver import YahboomM3Pro
from strands_actors.drivers.yahboom.ros2 import Ros2Link
from strands_actors.drivers.yahboom.stop import YahboomStopChannel
from strands_actors.drivers.yahboom.wire import YahboomWire
from strands_actors.kernel.channels.ros2.graph import Arrival, connect_once
from strands_actors.kernel.channels.ros2.names import Dialect
from strands_actors.kernel.clock import MonotonicClock
from tests.drivers.common.memory_port import Permission
from tests.drivers.yahboom.rig import state
from tests.ports import free_port
from tests.ros2.peer import router


@pytest.fixture(autouse=True)
def no_domain(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("ROS_DOMAIN_ID", raising=False)


class Base:
    """The node of the robot: it follows twists, and publishes its speed."""

    def __init__(self) -> None:
        self.twists: list[float] = []
        self.goals: list[dict[str, Any]] = []
        self.speed = 0.0
        self.stops = self.publishes = self.counts = True
        self.takes_arm = True
        self.reported = trio.Event()

    @asynccontextmanager
    async def on_graph(self, driver: YahboomM3Pro) -> AsyncIterator[None]:
        endpoint, humble = driver.config.port, driver.config.humble
        with router(endpoint):
            graph = await connect_once(endpoint, Dialect(DOMAIN, not humble), lambda topic, reason: None)
            try:
                node = graph.node("", "base")
                node.subscribe(m.CMD_VEL, "geometry_msgs/msg/Twist", self._on_twist)
                if self.takes_arm:
                    node.subscribe(m.ARM, "arm_msgs/msg/ArmJoints", lambda each: self.goals.append(each.message))
                odometry = node.publisher(m.ODOMETRY, "nav_msgs/msg/Odometry")
                imu = node.publisher(m.IMU, "sensor_msgs/msg/Imu")
                async with trio.open_nursery() as nursery:
                    nursery.start_soon(graph.run)
                    nursery.start_soon(self._report, odometry, imu)
                    yield
                    nursery.cancel_scope.cancel()
            finally:
                graph.close()

    def _on_twist(self, arrival: Arrival) -> None:
        self.twists.append(arrival.message["linear"]["x"])
        if self.stops:
            self.speed = self.twists[-1]

    async def _report(self, odometry: Any, imu: Any) -> None:
        number = 0
        while True:
            number += self.counts
            if self.publishes:
                header = {"stamp": {"sec": number, "nanosec": 0}}
                twist = {"twist": {"linear": {"x": self.speed}}}
                pose = {"pose": {"orientation": {"z": math.sin(0.25), "w": math.cos(0.25)}}}
                odometry.publish({"header": header, "pose": pose, "twist": twist})
                imu.publish({"header": header, "orientation": {"w": 1.0}})
            self.reported.set()
            self.reported = trio.Event()
            await trio.sleep(0.02)


def driver(**options: Any) -> YahboomM3Pro:
    port = f"tcp/127.0.0.1:{free_port()}"
    return YahboomM3Pro("yahboom_m3pro", port, {"transport": "ros2", "timeout_s": 2.0, **options})


@pytest.mark.parametrize("humble", [False, pytest.param(True, marks=pytest.mark.long)])
def test_a_wire_on_the_graph_opens_drives_and_stops(humble: bool) -> None:
    async def test() -> None:
        base, robot = Base(), driver(humble=humble)
        async with base.on_graph(robot):
            wire = YahboomWire(robot.config, MonotonicClock())
            facts = await wire.open()
            assert facts["ros2"] == "domain 30" and m.IMU in facts["topics"] and m.SCANS[0] not in facts["topics"]
            assert base.twists == [], "nothing is written before the robot is armed"
            async with trio.open_nursery() as nursery:
                await nursery.start(wire.serve)
                seen = await wire.arm(Permission())
                assert math.isnan(seen.position[3]), "the robot reports no arm"
                assert seen.sensors["odometry_yaw_rad"] == (pytest.approx(0.5),)
                candidate = robot.parse({"linear.x": 0.4, "arm1": 0.0, "time_ms": 700}, state())
                await wire.write(candidate.values, Permission())  # type: ignore[union-attr]
                with trio.fail_after(10.0):
                    while 0.4 not in base.twists or not base.goals or (await wire.read()).position[0] != 0.4:
                        await base.reported.wait()
                assert base.goals == [
                    dict(
                        zip(
                            (*(f"joint{n}" for n in range(1, 7)), "time"),
                            (90, 90, 90, 90, 90, 180, 700),
                            strict=True,
                        )
                    )
                ]
                reports = await wire.make_safe("zero")
                assert all(report.safe for report in reports), reports
                await base.reported.wait()  # the last zero may still be on its way
                assert base.twists[-3:] == [0.0] * 3
                nursery.cancel_scope.cancel()
            wire.close()

    trio.run(test)


def test_saf_005_without_odometry_a_stop_is_not_confirmed() -> None:
    async def test() -> None:
        base, robot = Base(), driver()
        async with base.on_graph(robot):
            link = Ros2Link(robot.config, MonotonicClock())
            await link.open()
            base.publishes = False
            outcome = await stop_until_it_stands(link, 0.4)
            assert (outcome.written, outcome.acknowledged) == (True, False) and "not confirmed" in outcome.detail
            base.publishes, base.stops, base.speed = True, False, 0.5
            outcome = await stop_until_it_stands(link, 0.4)
            assert "it reports speed 0.5, 0, 0" in outcome.detail
            link.close()
            with pytest.raises(WireDown, match=r"not connected|does not answer"):
                link.zero()

    trio.run(test)


def test_saf_003_the_root_stops_the_base_by_its_own_node() -> None:
    async def test() -> None:
        base, robot = Base(), driver()
        base.speed = 0.5
        async with base.on_graph(robot), trio.open_nursery() as nursery:
            channel = YahboomStopChannel(robot.config, (), MonotonicClock())
            with trio.fail_after(10.0):
                await nursery.start(channel.serve)
            assert base.twists == [], "nothing is written before a stop"
            reports = await channel.make_safe("zero")
            assert all(report.safe for report in reports), reports[0].detail
            await base.reported.wait()  # the last zero may still be on its way
            assert len(base.twists) >= 3 and set(base.twists) == {0.0}
            channel.close()
            nursery.cancel_scope.cancel()

    trio.run(test)


@pytest.mark.quick_cases(1)
@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"takes_arm": False}, "no node subscribes to /arm6_joints within 0.5 s"),
        ({"publishes": False}, "no odometry within 0.5 s"),
        ({"counts": False}, "odometry never changes its stamp within 0.5 s"),
    ],
)
def test_saf_012_a_base_that_is_not_whole_is_refused(change: dict[str, bool], reason: str) -> None:
    async def test() -> None:
        base, robot = Base(), driver(timeout_s=0.5)
        vars(base).update(change)
        async with base.on_graph(robot):
            with pytest.raises(WireDown, match=reason):
                await Ros2Link(robot.config, MonotonicClock()).open()
        assert base.twists == []

    trio.run(test)


def test_without_a_router_the_error_has_the_remedy() -> None:
    async def test() -> None:
        with pytest.raises(WireDown, match=r"no zenoh router at .*Start rmw_zenohd"):
            await YahboomWire(driver(timeout_s=0.3).config, MonotonicClock()).open()

    trio.run(test)


def test_an_address_of_rosbridge_is_no_router() -> None:
    with pytest.raises(ValueError, match="Give the router"):
        YahboomM3Pro("yahboom_m3pro", "192.0.2.10", {"transport": "ros2"}).check_port()


@pytest.mark.parametrize(("text", "domain"), [("", DOMAIN), ("0", 0), ("42", 42)])
def test_the_domain_is_the_environments(monkeypatch: pytest.MonkeyPatch, text: str, domain: int) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", text)
    assert domain_of_environment() == domain


@pytest.mark.parametrize("text", ["-1", "233", "mine"])
def test_an_invalid_domain_is_refused(monkeypatch: pytest.MonkeyPatch, text: str) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", text)
    with pytest.raises(WireDown, match=r"Give 0\.\.232, or unset it for 30"):
        domain_of_environment()
