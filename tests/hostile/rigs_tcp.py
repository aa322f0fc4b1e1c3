"""Rigs of arms and grippers with frames over TCP or datagrams: xArm, Kinova, Robotiq."""

from __future__ import annotations

import contextlib
from collections.abc import Iterable, Mapping
from typing import Any

import trio

from strands_actors.drivers.common.twin import ClientGone
from strands_actors.drivers.kinova.protocol import MAGIC, Call, Frame, Kind
from strands_actors.drivers.kinova.stop_channel import KinovaStopChannel
from strands_actors.drivers.kinova.wire import KinovaWire
from strands_actors.drivers.robotiq.sessions import TcpSession
from strands_actors.drivers.robotiq.stop_channel import RobotiqStopChannel
from strands_actors.drivers.robotiq.wire import RobotiqWire
from strands_actors.drivers.xarm.protocol import Register, frame
from tests.drivers.common.memory_port import MemoryPort
from tests.drivers.kinova import rig as kinova
from tests.drivers.robotiq import rig as robotiq
from tests.drivers.xarm import rig as xarm

from .bench import Bench, Log, Rig, Situation, first_joint, on_bench, renumbered
from .peer import HostilePeer, HostileStream


def _xarm(peer: HostilePeer) -> Bench:
    world = xarm.World()

    async def open_stream(host: str, port: int) -> HostileStream:
        return HostileStream(peer, await xarm.World.open_stream(world, host, port))

    world.open_stream = open_stream  # type: ignore[assignment, method-assign]
    driver = on_bench(world.driver, lambda clock: world.wire(), lambda clock: world.stop_channel())
    return Bench(driver, lambda: [(entry.t_s, entry.kind) for entry in world.written])


_KORTEX = {Call.STOP: "safe", Call.SEND_JOINT_SPEEDS: "setpoint"}


def _kinova(peer: HostilePeer) -> Bench:
    made = kinova.Rig()

    async def connect(host: str, port: int) -> HostileStream:
        return HostileStream(peer, await made.connect(host, port))

    config = made.driver.config
    driver = on_bench(
        made.driver,
        lambda clock: KinovaWire(config, clock, connect),
        lambda clock: KinovaStopChannel(config, (), clock, connect),
    )
    return Bench(driver, lambda: [(t_s, _KORTEX.get(Call(one.call), "other")) for t_s, one in made.received])


def _robotiq(peer: HostilePeer) -> Bench:
    made = robotiq.Rig()
    log: Log = []

    async def connect(host: str, port: int) -> HostileStream:
        await trio.lowlevel.checkpoint()
        session = TcpSession(made.twin)
        return HostileStream(peer, MemoryPort(lambda data: _answers(session, data, log)))

    config = made.driver.config
    driver = on_bench(
        made.driver,
        lambda clock: RobotiqWire(config, clock, connect),
        lambda clock: RobotiqStopChannel(config, (), clock, connect),
    )
    return Bench(driver, lambda: log)


def _answers(session: Any, data: bytes, log: Log) -> Iterable[tuple[float, bytes]]:
    """Yield the answers of a session of the twin, as a ``Peer`` does. Note the kinds of the messages."""
    with contextlib.suppress(ClientGone):
        for exchange in session.receive(data, None):
            log.append((trio.current_time(), exchange.kind))
            for reply in exchange.replies:
                yield 0.001 + reply.late_s, reply.data


RIGS: Mapping[str, Rig] = {
    "xarm7": Rig(
        _xarm,
        first_joint(0.002, "joint1"),
        quick=("garbled", "flood", "bomb"),
        floods={"unasked answers": frame(60_000, bytes((Register.SERVO_JOINT, 0)))},
        bombs={"a report of 4 GB": b"\xff\xff\xff\xff", "a frame of 64 kB": b"\x00\x01\x00\x02\xff\xff"},
        wrong_ids={"transaction": renumbered(0, 2)},
    ),
    "kinova_gen3": Rig(
        _kinova,
        first_joint(0.005, "joint_1"),
        quick=("garbled", "flood", "bomb"),
        floods={"notifications": Frame(Kind.NOTIFICATION, Call.STOP, 1, 1, b"").encode(), "magic": MAGIC},
        bombs={"a frame of 4 GB": MAGIC + b"\xff\xff\xff\xff"},
        wrong_ids={"magic": lambda data: data.replace(MAGIC, MAGIC[::-1])},
        login="the base takes a call only with the number of a session, which it gives in its answer",
        latest_s={Situation.RESET: 0.001},  # the time of that answer
    ),
    "robotiq_2f85": Rig(
        _robotiq,
        lambda position: {"gripper": 0.5},
        quick=("older answers", "flood"),
        floods={"unasked answers": bytes.fromhex("ffff00000006010600000000")},
        bombs={"a frame of 64 kB": bytes.fromhex("00010000ffff")},
        wrong_ids={"transaction": renumbered(0, 2)},
        bound_s=0.1,
        why_longer="a gripper is asked first: a hold would activate one that has lost its power",
        # The time of its answer, on a new connection. The stop channel does not know the wire's last command, so it
        # asks twice.
        latest_s={Situation.RESET: 0.001, Situation.WIRE_ENDS: 0.002},
    ),
}
