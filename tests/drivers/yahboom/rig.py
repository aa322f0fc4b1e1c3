"""The twin's rosbridge behind WebSockets in memory, for the wire in virtual time. It also checks the results of
third-party clients."""

from __future__ import annotations

import json
import math
from collections import deque
from collections.abc import AsyncIterator, Callable, Mapping, Sequence
from contextlib import asynccontextmanager
from typing import Any, NamedTuple

import pytest
import trio

from strands_actors.contract.driver import Candidate, GateState, Live
from strands_actors.contract.wire import MotorReport, Observation, StopChannel, Wire, WireDown
from strands_actors.drivers.yahboom.config import YahboomConfig
from strands_actors.drivers.yahboom.driver import YahboomM3Pro
from strands_actors.drivers.yahboom.rosbridge import RosbridgeLink
from strands_actors.drivers.yahboom.stop import StopLink, YahboomStopChannel
from strands_actors.drivers.yahboom.twin import BridgeSession, M3ProTwin
from strands_actors.drivers.yahboom.wire import YahboomWire
from strands_actors.kernel.clock import Clock, VirtualClock
from strands_actors.kernel.messages import Refused
from strands_actors.testing import Twin
from tests.drivers.common.memory_port import Permission

NOW_NS = 10**12
KNOWN = (0.0,) * 9


class Taken(NamedTuple):
    """One operation that the bridge took."""

    t_s: float
    kind: str
    text: str
    connection: int


class World:
    """One robot behind its rosbridge. ``options`` are those of its twin, ``driver`` those of the driver."""

    def __init__(self, driver: dict[str, Any] | None = None, **options: Any) -> None:
        self.twin = M3ProTwin("yahboom_m3pro", trio.current_time, **options)
        self.taken: list[Taken] = []
        self.sockets: list[MemorySocket] = []
        self.frozen = False  # True: the bridge reads and sends nothing
        self.gone = False
        self.mute: set[str] = set()  # topics that are silent
        self.answer_s = 0.0  # delay of all messages from the bridge
        self.loses = False  # True: every second answer to a call is lost
        self.denies = False  # True: rosapi is gone, so its services are refused
        self.driver = YahboomM3Pro("yahboom_m3pro", "192.0.2.1", driver or {})

    def link(self) -> RosbridgeLink:
        return RosbridgeLink(self.driver.config, VirtualClock(), self.open_socket)

    def wire(self) -> YahboomWire:
        return YahboomWire(self.driver.config, VirtualClock(), self.link(), self.link())

    def stop_channel(self) -> YahboomStopChannel:
        return ChannelTo(self.link, self.driver.config, VirtualClock())

    async def open_socket(
        self, host: str, port: int, /, *, within_s: float, stop: Sequence[str] = ()
    ) -> MemorySocket:
        assert (host, port) == ("192.0.2.1", 9090)
        await trio.sleep(0.001)
        if self.gone:
            raise WireDown("192.0.2.1:9090: cannot connect")
        self.sockets.append(MemorySocket(self, len(self.sockets)))
        self.sockets[-1].send_stop(*stop)
        return self.sockets[-1]

    def thaw(self) -> None:
        """Let the bridge read the waiting messages, those of each connection in order."""
        self.frozen = False
        for socket in self.sockets:
            socket.take_waiting()

    def kinds(self, *kinds: str) -> list[str]:
        return [one.kind for one in self.taken if one.kind in (kinds or ("setpoint", "safe"))]


class ChannelTo(YahboomStopChannel):
    """A stop channel on the test's links."""

    def __init__(self, new_link: Callable[[], StopLink], config: YahboomConfig, clock: Clock) -> None:
        super().__init__(config, (), clock)
        self._new_link = new_link

    def new_link(self) -> StopLink:
        return self._new_link()


class MemorySocket:
    def __init__(self, world: World, number: int) -> None:
        self.name = "192.0.2.1:9090"
        self._world = world
        self._number = number
        self._session = BridgeSession(world.twin.graph, self._say)
        self._waiting: list[str] = []
        self._told: deque[tuple[float, str]] = deque()
        self.errors: list[str] = []  # status messages from the bridge
        self._lost = False
        self.is_pending = True
        self._is_closed = False

    @property
    def is_open(self) -> bool:
        return not self.is_pending and not self._is_closed

    async def accepted(self, within_s: float) -> bool:
        with trio.move_on_after(within_s):
            while self.is_pending:
                self._check()
                await trio.sleep(0.001)
                self.is_pending = self.is_pending and self._world.frozen
        return not self.is_pending

    def send_stop(self, *messages: str) -> None:
        for message in messages:
            self.send(message)

    def send(self, message: str) -> None:
        self._check()
        self._waiting.append(message)
        if not self._world.frozen:
            self.take_waiting()

    def take_waiting(self) -> None:
        waiting, self._waiting = self._waiting, []
        for text in waiting:
            kind, _ = self._session.take(text)
            self._world.taken.append(Taken(trio.current_time(), kind, text, self._number))

    async def receive(self) -> str | bytes:
        while True:
            await trio.sleep(0.001)
            self._check()
            if not self._world.frozen:
                self._session.publish(trio.current_time())
                if self._told and self._told[0][0] <= trio.current_time():
                    return self._told.popleft()[1]

    def close(self) -> None:
        self.is_pending, self._is_closed = False, True

    def _say(self, text: str) -> None:
        if '"op":"status"' in text:
            self.errors.append(text)
        if not any(f'"publish","topic":"{topic}"' in text for topic in self._world.mute):
            if self._world.loses and '"service_response"' in text:
                self._lost = not self._lost
                if self._lost:
                    return
            if self._world.denies:
                text = text.replace('"result":true', '"result":false')
            self._told.append((trio.current_time() + self._world.answer_s, text))

    def _check(self) -> None:
        if self._world.gone:
            self.close()
        if self._is_closed:
            raise WireDown("192.0.2.1:9090: the WebSocket is closed")


def driver(**options: Any) -> YahboomM3Pro:
    return YahboomM3Pro("yahboom_m3pro", "192.0.2.1", YahboomM3Pro.resolve("yahboom_m3pro", options))


def state(
    target: tuple[float, ...] = KNOWN, live: Live | None = None, age_ns: int = 0, now_ns: int = NOW_NS
) -> GateState:
    seen = Observation(now_ns - age_ns, KNOWN, (now_ns - age_ns,) * 9)
    return GateState(now_ns, seen, target, now_ns, False, 0.0, live)


def answer(action: dict[str, Any], at: GateState | None = None, **options: Any) -> Candidate | Refused:
    """Judge an action as the gate does."""
    robot, at = driver(**options), at or state()
    candidate = robot.parse(action, at)
    if isinstance(candidate, Candidate):
        for gate in robot.gates:
            if (refusal := gate(candidate, at)) is not None:
                return refusal
    return candidate


def accepted(action: dict[str, Any], at: GateState | None = None, **options: Any) -> Candidate:
    found = answer(action, at, **options)
    assert isinstance(found, Candidate), found
    return found


def refused(action: dict[str, Any], at: GateState | None = None, **options: Any) -> Refused:
    found = answer(action, at, **options)
    assert isinstance(found, Refused), found
    return found


def judge_client(seen: Mapping[str, Any], twin: Twin) -> None:
    """Check the results of a third-party client that drove ten times and sent a zero, then drove twice without
    a zero."""
    kinds = [one.kind for one in twin.log.entries() if one.sender == "host" and one.kind in ("setpoint", "safe")]
    assert {"/cmd_vel", "/arm6_joints", "/odom_raw", "/scan1"} <= set(seen["topics"])
    assert seen["type"] == "geometry_msgs/msg/Twist"
    assert seen["time"]["time"]["sec"] > 0
    assert "does not exist" in str(seen["refused"])
    assert seen["odometry"] > 30 and 1 <= seen["scans"] <= 8
    assert seen["moved"] == pytest.approx(0.4)
    assert 0.2 < seen["at"] < 0.8
    assert (seen["stood"], seen["zeroed"]) == (0.0, 0.0)
    assert kinds == ["setpoint"] * 11 + ["safe"] + ["setpoint"] * 2


NAN = math.nan


@asynccontextmanager
async def served(wire: Wire | StopChannel) -> AsyncIterator[None]:
    async with trio.open_nursery() as nursery:
        await nursery.start(wire.serve)
        yield
        nursery.cancel_scope.cancel()


@asynccontextmanager
async def running(world: World) -> AsyncIterator[YahboomWire]:
    """Yield an open, served and armed wire."""
    wire = world.wire()
    await wire.open()
    async with served(wire):
        await wire.arm(Permission())
        world.taken.clear()
        yield wire
    wire.close()


def target(world: World, now_ns: int = NOW_NS, **action: float) -> tuple[float, ...]:
    """Return the target of an action, for an arm at zero."""
    named = {
        key.replace("_x", ".x").replace("_y", ".y").replace("_z", ".z"): value for key, value in action.items()
    }
    candidate = world.driver.parse(named, state(now_ns=now_ns))
    return candidate.values  # type: ignore[union-attr]


def msgs(world: World, topic: str) -> list[dict[str, Any]]:
    sent = [json.loads(one.text) for one in world.taken]
    return [one["msg"] for one in sent if one["op"] == "publish" and one["topic"] == topic]


def all_safe(reports: tuple[MotorReport, ...]) -> bool:
    assert [report.axis for report in reports] == [
        "linear.x", "linear.y", "angular.z", "arm1", "arm2", "arm3", "arm4", "arm5", "gripper",
    ]  # fmt: skip
    return all(report.safe for report in reports)
