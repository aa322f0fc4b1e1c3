"""One row a wire: its robot in memory, what a peer of its kind can say, and how a target of it looks.

``RIGS`` is the table that the hostile-peer suite runs. A new wire adds a row.
"""

from __future__ import annotations

import contextlib
import struct
from collections.abc import AsyncIterator, Callable, Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import trio

from strands_actors.contract.driver import Driver
from strands_actors.contract.wire import Permit, StopChannel, Wire
from strands_actors.drivers.common.dynamixel.wire import DynamixelStopChannel
from strands_actors.drivers.common.twin import ClientGone
from strands_actors.drivers.crazyflie import stop_channel as crazyflie_stop
from strands_actors.drivers.crazyflie import wire as crazyflie_wire
from strands_actors.drivers.crazyflie.config import Endpoint
from strands_actors.drivers.crazyflie.driver import Crazyflie
from strands_actors.drivers.crazyflie.links import Link
from strands_actors.drivers.crazyflie.robots import TABLES as CRAZYFLIES
from strands_actors.drivers.crazyflie.twin.firmware import Firmware
from strands_actors.drivers.feetech.wire import FeetechStopChannel
from strands_actors.drivers.kinova.protocol import MAGIC, Call, Frame, Kind
from strands_actors.drivers.kinova.stop_channel import KinovaStopChannel
from strands_actors.drivers.kinova.wire import KinovaWire
from strands_actors.drivers.robotiq.sessions import TcpSession
from strands_actors.drivers.robotiq.stop_channel import RobotiqStopChannel
from strands_actors.drivers.robotiq.wire import RobotiqWire
from strands_actors.drivers.stretch.driver import Stretch
from strands_actors.drivers.xarm.protocol import Register, frame
from strands_actors.kernel.clock import Clock
from tests.drivers.common.memory_port import MemoryPort, servos
from tests.drivers.crazyflie.virtual import Air
from tests.drivers.kinova import rig as kinova
from tests.drivers.rby1 import rig as rby1
from tests.drivers.robotiq import rig as robotiq
from tests.drivers.servo import rig as servo
from tests.drivers.spot import rig as spot
from tests.drivers.stretch import rig as stretch
from tests.drivers.xarm import rig as xarm

from .peer import HostilePeer, HostileStream

Log = list[tuple[float, str]]
"""What the robot took: when (s), and what it was in the words of the wire log."""


class Bench(NamedTuple):
    """One robot in memory."""

    driver: Driver
    log: Callable[[], Log]
    living: Callable[[], contextlib.AbstractAsyncContextManager[object]] = contextlib.nullcontext


class Rig(NamedTuple):
    """What the suite must know of a wire."""

    make: Callable[[HostilePeer], Bench]
    action: Callable[[Sequence[float]], dict[str, Any]]
    """A target near to a position, as an action."""
    floods: Mapping[str, bytes] = {}
    """Words that a peer of this wire may say without an end, by a name."""
    bombs: Mapping[str, bytes] = {}
    """Words that declare more than the protocol has; zeros follow without an end."""
    wrong_ids: Callable[[bytes], bytes] | None = None
    """Put another number, or another sender, into an answer. None: answers have none."""
    quick: tuple[str, ...] = ("garbled",)
    """Kinds of peers that the ordinary run meets, too."""
    first: tuple[str, ...] = ()
    """Services that get the robot to where it takes a target."""
    login: str = ""
    """Why nothing can be written on a connection that is reset before it has answered."""
    bound_s: float = 0.05
    """From a stop to the safe frame, behind a peer that is hostile. More than the published bound
    only for what the fault itself takes: a login, a bus that must be quiet."""
    why_longer: str = ""


def _on_bench(driver: Driver, wire: Callable[[Clock], Wire], channel: Callable[[Clock], StopChannel]) -> Driver:
    driver.open_wire = wire  # type: ignore[method-assign]
    driver.stop_channel = lambda descriptors, clock: channel(clock)  # type: ignore[method-assign]
    return driver


# -- xArm


def _xarm(peer: HostilePeer) -> Bench:
    world = xarm.World()

    async def open_stream(host: str, port: int) -> HostileStream:
        return HostileStream(peer, await xarm.World.open_stream(world, host, port))

    world.open_stream = open_stream  # type: ignore[assignment, method-assign]
    driver = _on_bench(world.driver, lambda clock: world.wire(), lambda clock: world.stop_channel())
    return Bench(driver, lambda: [(entry.t_s, entry.kind) for entry in world.written])


def _renumbered(at: int, size: int) -> Callable[[bytes], bytes]:
    """Return a change that adds one to the number of a frame."""

    def change(data: bytes) -> bytes:
        number = int.from_bytes(data[at : at + size], "big") + 1
        return data[:at] + (number % (1 << 8 * size)).to_bytes(size, "big") + data[at + size :]

    return change


# -- RB-Y1


def _h2(kind: int, payload: bytes = b"", flags: int = 0, stream: int = 0) -> bytes:
    return len(payload).to_bytes(3, "big") + bytes((kind, flags)) + stream.to_bytes(4, "big") + payload


_H2_FLOODS = {
    "pings": _h2(6, b"12345678"),
    "settings": _h2(4),
    "empty data": _h2(0, stream=1),
    "window updates": _h2(8, struct.pack(">I", 1)),
    "unknown frames": _h2(0x55),
}
_H2_BOMBS = {
    "a frame of 16 MB": b"\xff\xff\xff\x00\x00\x00\x00\x00\x01",
    "a message of 4 GB": _h2(0, b"\0\xff\xff\xff\xff", stream=1),
}


def _rby1(peer: HostilePeer) -> Bench:
    world = rby1.World()

    async def open_stream(host: str, port: int) -> HostileStream:
        return HostileStream(peer, await rby1.World.open_stream(world, host, port))

    world.open_stream = open_stream  # type: ignore[assignment, method-assign]
    driver = _on_bench(world.driver, lambda clock: world.wire(), lambda clock: world.stop_channel())
    return Bench(driver, lambda: [(entry.t_s, entry.kind) for entry in world.written], world.living)


# -- Spot


def _spot(peer: HostilePeer) -> Bench:
    world = spot.World()

    async def open_stream(authority: str, /) -> HostileStream:
        return HostileStream(peer, await spot.World.open_stream(world, authority))

    @contextlib.asynccontextmanager
    async def living() -> AsyncIterator[None]:
        async def live() -> None:
            while True:
                world.twin.pass_time()
                await trio.sleep(0.1)

        async with trio.open_nursery() as nursery:
            nursery.start_soon(live)
            yield
            nursery.cancel_scope.cancel()

    world.open_stream = open_stream  # type: ignore[assignment, method-assign]
    driver = _on_bench(world.driver, lambda clock: world.wire(), lambda clock: world.stop_channel())
    return Bench(driver, lambda: [(entry.t_s, entry.kind) for entry in world.taken], living)


# -- Kinova

_KORTEX = {Call.STOP: "safe", Call.SEND_JOINT_SPEEDS: "setpoint"}


def _kinova(peer: HostilePeer) -> Bench:
    made = kinova.Rig()

    async def connect(host: str, port: int) -> HostileStream:
        return HostileStream(peer, await made.connect(host, port))

    config = made.driver.config
    driver = _on_bench(
        made.driver,
        lambda clock: KinovaWire(config, clock, connect),
        lambda clock: KinovaStopChannel(config, (), clock, connect),
    )
    return Bench(driver, lambda: [(t_s, _KORTEX.get(Call(one.call), "other")) for t_s, one in made.told])


# -- Robotiq


def _robotiq(peer: HostilePeer) -> Bench:
    made = robotiq.Rig()
    log: Log = []

    async def connect(host: str, port: int) -> HostileStream:
        await trio.lowlevel.checkpoint()
        session = TcpSession(made.twin)
        return HostileStream(peer, MemoryPort(lambda data: _answers(session, data, log)))

    config = made.driver.config
    driver = _on_bench(
        made.driver,
        lambda clock: RobotiqWire(config, clock, connect),
        lambda clock: RobotiqStopChannel(config, (), clock, connect),
    )
    return Bench(driver, lambda: log)


def _answers(session: Any, data: bytes, log: Log) -> Iterable[tuple[float, bytes]]:
    """As a ``Peer``: what a session of the twin's makes of bytes. Notes what they were."""
    with contextlib.suppress(ClientGone):
        for exchange in session.receive(data, None):
            log.append((trio.current_time(), exchange.kind))
            for reply in exchange.replies:
                yield 0.001 + reply.late_s, reply.data


# -- servos


class _Logged:
    """A bus of servos that notes what it is told."""

    def __init__(self, bus: Any, log: Log) -> None:
        self._bus = bus
        self._log = log

    def receive(self, data: bytes, bits_per_s: int | None) -> Any:
        for exchange in self._bus.receive(data, bits_per_s):
            self._log.append((trio.current_time(), exchange.kind))
            yield exchange


def _servos(rig_class: Callable[[], servo.Rig], channel_class: Any) -> Callable[[HostilePeer], Bench]:
    def make(peer: HostilePeer) -> Bench:
        made = rig_class()
        log: Log = []
        bus: Any = _Logged(made.bus, log)
        config, wire_class = made.driver.config, type(made.wire)

        def open_port(path: str, baud: int) -> HostileStream:
            return HostileStream(peer, MemoryPort(servos(bus)))

        driver = _on_bench(
            made.driver,
            lambda clock: wire_class(config, clock, open_port),
            lambda clock: channel_class(config, (), clock, open_port),
        )
        return Bench(driver, lambda: log)

    return make


# -- Stretch


class _StretchRig(stretch.Rig):
    """Notes when each frame came."""

    def __init__(self, peer: HostilePeer) -> None:
        super().__init__()
        self.peer = peer
        self.log: Log = []

    def open_port(self, path: str, baud: int) -> HostileStream:  # type: ignore[override]
        port = super().open_port(path, baud)
        answers = port.peer

        def logged(data: bytes) -> Iterable[tuple[float, bytes]]:
            before = len(self.kinds)
            replies = list(answers(data))
            self.log += [(trio.current_time(), kind) for _, kind, _ in self.kinds[before:]]
            return replies

        port.peer = logged
        return HostileStream(self.peer, port)


def _stretch(peer: HostilePeer) -> Bench:
    made = _StretchRig(peer)
    driver = Stretch("stretch3", "", {})
    driver.config = made.config
    _on_bench(driver, lambda clock: made.wire(), lambda clock: made.stop_channel())
    return Bench(driver, lambda: made.log)


# -- Crazyflie


class _HostileLink(Link):
    """Packets instead of bytes, and the same changes."""

    def __init__(self, peer: HostilePeer, air: Air, log: Log, speaks: Callable[[Air], None]) -> None:
        self.name = air.name
        self._speaks = speaks
        self._stream = HostileStream(peer, air)
        self._air = air
        self._log = log

    async def write(self, packet: bytes, permit: Permit | None = None) -> None:
        if permit is not None:
            permit.check()
        peer = self._stream.peer
        peer.writes += 1
        self._stream._check()
        replies = self._air.firmware.hear(peer.garble(packet) if peer.deaf else packet)
        self._log.append((trio.current_time(), replies.kind))
        self._speaks(self._air)
        self._air.say(*replies.replies)

    async def read(self) -> bytes:
        return await self._stream.read()

    def read_waiting(self) -> bytes | None:
        return self._stream.read_waiting()

    def close(self) -> None:
        self._stream.wake()


def _crazyflie(peer: HostilePeer) -> Bench:
    firmware = Firmware(CRAZYFLIES.table("crazyflie"), trio.current_time)
    log: Log = []
    speaker: list[Air] = []  # the last: the firmware answers whoever spoke last

    async def open_link(endpoint: Endpoint) -> Link:
        return _HostileLink(peer, Air(firmware), log, lambda air: speaker.__setitem__(slice(None), [air]))

    @contextlib.asynccontextmanager
    async def living() -> AsyncIterator[None]:
        async def live() -> None:
            while True:
                await trio.sleep(0.01)
                firmware.pass_time()
                for air in speaker:
                    air.say(*firmware.rows())

        crazyflie_wire.open_link, wire_opens = open_link, crazyflie_wire.open_link
        crazyflie_stop.open_link, stop_opens = open_link, crazyflie_stop.open_link
        try:
            async with trio.open_nursery() as nursery:
                nursery.start_soon(live)
                yield
                nursery.cancel_scope.cancel()
        finally:
            crazyflie_wire.open_link, crazyflie_stop.open_link = wire_opens, stop_opens

    return Bench(Crazyflie("crazyflie", "192.0.2.1", {}), lambda: log, living)


# -- the table

_ZEROS = bytes(64)


def _first(step: float, joint: str) -> Callable[[Sequence[float]], dict[str, Any]]:
    return lambda position: {joint: position[0] + step}


RIGS: Mapping[str, Rig] = {
    "xarm7": Rig(
        _xarm,
        _first(0.002, "joint1"),
        quick=("garbled", "flood", "bomb"),
        floods={"unasked answers": frame(60_000, bytes((Register.SERVO_JOINT, 0)))},
        bombs={"a report of 4 GB": b"\xff\xff\xff\xff", "a frame of 64 kB": b"\x00\x01\x00\x02\xff\xff"},
        wrong_ids=_renumbered(0, 2),
    ),
    "rby1": Rig(
        _rby1,
        _first(0.002, "torso_0"),
        quick=("flood", "bomb"),
        floods=_H2_FLOODS,
        bombs=_H2_BOMBS,
        wrong_ids=_renumbered(5, 4),
    ),
    "spot": Rig(
        _spot,
        lambda position: {"vx": 0.2},
        quick=("garbled",),
        floods=_H2_FLOODS,
        bombs=_H2_BOMBS,
        wrong_ids=_renumbered(5, 4),
        first=("stand",),
    ),
    "kinova_gen3": Rig(
        _kinova,
        _first(0.005, "joint_1"),
        quick=("garbled", "flood", "bomb"),
        floods={"notifications": Frame(Kind.NOTIFICATION, Call.STOP, 1, 1, b"").encode(), "magic": MAGIC},
        bombs={"a frame of 4 GB": MAGIC + b"\xff\xff\xff\xff"},
        wrong_ids=lambda data: data.replace(MAGIC, MAGIC[::-1]),
        login="the base takes a call only with the number of a session, which it gives in its answer",
    ),
    "robotiq_2f85": Rig(
        _robotiq,
        lambda position: {"gripper": 0.5},
        quick=("older answers", "flood"),
        floods={"unasked answers": bytes.fromhex("ffff00000006010600000000")},
        bombs={"a frame of 64 kB": bytes.fromhex("00010000ffff")},
        wrong_ids=_renumbered(0, 2),
        bound_s=0.1,
        why_longer="a gripper is asked first: a hold would activate one that has lost its power",
    ),
    "so101": Rig(
        _servos(servo.FeetechRig, FeetechStopChannel),
        _first(1.0, "shoulder_pan"),
        quick=("garbled", "older answers"),
        floods={"unasked answers": b"\xff\xff\x63\x02\x00\x9a", "half headers": b"\xff\xff"},
        bombs={"the longest frame": b"\xff\xff\x01\xff"},
        wrong_ids=lambda data: data[:2] + b"\x63" + data[3:],
    ),
    "koch": Rig(
        _servos(servo.DynamixelRig, DynamixelStopChannel),
        _first(1.0, "shoulder_pan"),
        quick=("older answers",),
        floods={"half headers": b"\xff\xff\xfd\x00"},
        bombs={"a frame of 64 kB": b"\xff\xff\xfd\x00\x01\xff\xff"},
        wrong_ids=lambda data: data[:4] + b"\x63" + data[5:],
    ),
    "stretch3": Rig(
        _stretch,
        lambda position: {"lift": position[2] + 0.002},
        quick=("garbled",),
        floods={"empty frames": b"\0"},
        bombs={"a frame without an end": b"\x01"},
    ),
    "crazyflie": Rig(
        _crazyflie,
        lambda position: {"vz": 0.0},
        quick=("older answers", "flood"),
        floods={"null packets": b"\xff", "console": b"\x00" + b"x" * 30},
        first=("takeoff",),
    ),
}
