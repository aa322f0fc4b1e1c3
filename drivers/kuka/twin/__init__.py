"""Simulate a KUKA controller with its arm (a "twin"): it sends an FRI message by UDP in every sample time.

It binds an address in 127.0.0.0/8 and sends to the option ``client``. Both ends have the same port number.

Its log of the network (wire log) has every answer of the client, by its kind:

    setpoint   its positions differ from those of the previous answer
    safe       it repeats the previous positions (a ``hold``), or has no positions
    garbled    it is not a command message

From the controller the log has each new state of the session with its reason (``session``), but no messages.

A simulated robot is controlled by lines of text. This one accepts the lines of every twin, and also ``motion
start|stop`` (a person starts or ends the robot program on the pendant), ``safety LEVEL``, ``drive JOINT NUMBER``,
``client_mode NUMBER``, ``control_mode NUMBER``, ``overlay NUMBER`` and ``io NAME VALUE`` (a wire at an input). The
numbers are those of the protocol. After a safety stop the line ``safety 0`` is not enough: the program has ended,
and only ``motion start`` starts it again.
"""

from __future__ import annotations

import enum
import math
import random
import socket
import time
from collections import deque
from collections.abc import Mapping, Sequence
from contextlib import aclosing, suppress
from typing import Annotated

import trio
from msgspec.structs import replace

from strands_actors.contract.options import option
from strands_actors.drivers.common.twin import (
    Fault,
    Reply,
    TwinOptions,
    TwinRobot,
    TwinServer,
    WireLog,
    main_of,
    own_host,
)
from strands_actors.drivers.kuka.io import LONGEST_NAME, MOST_IOS, Io, IoDirection, IoType
from strands_actors.drivers.kuka.protocol import FRI_PORT, JOINTS, LARGEST, Monitoring, encode_monitoring
from strands_actors.drivers.kuka.robots import Arm, arm_of
from strands_actors.kernel.clock import NS, MonotonicClock

from .answers import FIELDS, Answers
from .body import KukaBody
from .controller import Controller

MODELLED = (FIELDS,)


class KukaTwinOptions(TwinOptions, frozen=True):
    host: Annotated[str | None, option("address to speak from; None: one of its own in 127.0.0.0/8")] = None
    port: Annotated[
        int,
        option(
            "UDP port of both ends; 0: a free one, so that twins do not meet at the client's end", ge=0, le=65535
        ),
    ] = 0
    from_port: Annotated[int | None, option("UDP port of its own end, when it is another one")] = None
    client: Annotated[str, option("address of the client")] = "127.0.0.1"
    sample_ms: Annotated[int, option("sample time", gt=0)] = 10
    multiplier: Annotated[int, option("receive multiplier: an answer is due every so many cycles", gt=0)] = 1
    packed: Annotated[bool, option("write repeated numbers packed")] = False
    checksum: Annotated[bool, option("write the checksum")] = True
    ios: Annotated[
        str,
        option(
            "inputs and outputs that the robot program registers, at most 10: "
            "'GROUP.NAME:boolean|digital|analog:input|output', with commas between them"
        ),
    ] = ""


LAST_PORT = 32767
"""Ports above this one are assigned by the system."""
ATTEMPTS = 64
WRONG_RAD = 1.0
MODES = ("safety", "client_mode", "control_mode", "overlay")


class KukaTwin(TwinRobot):
    """One simulated controller. A joint has a number from 1 to 7."""

    PARTS = range(1, JOINTS + 1)

    def __init__(self, controller: Controller) -> None:
        super().__init__()
        self.controller = controller
        self.body = KukaBody(controller)
        self._readings: Mapping[str, tuple[float, ...]] = {}  # Measurements that the fault ``stuck`` repeats.

    def begin_fault(self, fault: Fault) -> None:
        self._readings = {}
        for index in range(JOINTS):
            self.jam(index, fault is Fault.STUCK)

    def jam(self, index: int, on: bool) -> None:
        self.controller.plant.set_stuck(index, on)

    def power_cycle(self) -> None:
        self.controller.wake_up()

    def cycle(self) -> Monitoring:
        """Run one cycle of the controller, and return its message."""
        message = self.controller.cycle()
        match self.faults.of(None):
            case Fault.WRONG:
                return replace(message, position=tuple(rad + WRONG_RAD for rad in message.position))
            case Fault.STUCK:
                self._readings = self._readings or {"position": message.position, "torque": message.torque}
                return replace(message, **self._readings)
        return message

    def order(self, words: Sequence[str]) -> bool:
        controller = self.controller
        match words:
            case ["motion", "start"]:
                controller.start_program()
            case ["motion", "stop"]:
                controller.motion = False
            case ["io", name, number] if _is_number(number):
                controller.set_io(name, float(number))
            case ["drive", joint, number] if joint.isdecimal() and number.isdecimal() and 1 <= int(joint) <= JOINTS:
                controller.drives[int(joint) - 1] = int(number)
            case [name, number] if name in MODES and number.isdecimal():
                setattr(controller, name, int(number))
            case _:
                return False
        return True


class KukaServer(TwinServer):
    """Run one simulated controller on its UDP port."""

    def __init__(self, arm: Arm, log: WireLog, options: KukaTwinOptions) -> None:
        self._clock = MonotonicClock()
        self.controller = controller = Controller(
            arm,
            sample_ms=options.sample_ms,
            multiplier=options.multiplier,
            note=lambda text: log.write(time.monotonic_ns(), "robot", [("session", text.encode())]),
            ios=read_ios(options.ios),
        )
        self._twin = KukaTwin(controller)
        super().__init__(self._twin, log)
        self._packed = options.packed
        self._checksum = options.checksum
        self._client = options.client
        self._sock: socket.socket | None = None
        self._plugged = trio.Event()
        host, port = self._find_place(options)
        self._place = host, port if options.from_port is None else options.from_port
        self._peer = self._client, port
        self._answers = Answers(controller)
        self._late: deque[tuple[int, bytes]] = deque()

    @property
    def address(self) -> str:
        host, port = self._place
        return f"{host}:{port}"

    # -- the network

    def _find_place(self, options: KukaTwinOptions) -> tuple[str, int]:
        """Return the address and the port of this controller. Without a given port, choose one that is free here
        and at the client's address. Raise ``OSError``."""
        host, port = options.host or own_host(), options.port
        if port:
            return host, port
        for _ in range(ATTEMPTS):
            port = random.randint(FRI_PORT, LAST_PORT)
            with suppress(OSError):
                for end in (self._client, host):
                    _bound(end, port).close()
                return host, port
        raise OSError(f"no free UDP port on {host} and {self._client}")

    def plug(self) -> None:
        if self._sock is None:
            self._sock = _bound(*self._place)
            self._plugged.set()

    def unplug(self) -> None:
        """Close the socket, like a pulled network cable. The controller runs on, without answers."""
        if self._sock is not None:
            self._plugged = trio.Event()
            trio.lowlevel.notify_closing(self._sock)
            self._sock.close()
            self._sock = None

    def close(self) -> None:
        if self._sock is not None:
            self._sock.close()
            self._sock = None

    def start(self, nursery: trio.Nursery) -> None:
        nursery.start_soon(self._hear)
        nursery.start_soon(self._tick)

    async def _hear(self) -> None:
        while True:
            await self._plugged.wait()
            sock = self._sock
            if sock is None:  # The socket was closed again (``unplug``) before this task ran.
                continue
            with suppress(BlockingIOError, ConnectionRefusedError, trio.ClosedResourceError):
                await trio.lowlevel.wait_readable(sock)
                await self._frost.thawed()
                data = sock.recv(LARGEST + 1) if sock.fileno() >= 0 else b""
                if data and not self._twin.is_off:
                    self._take(time.monotonic_ns(), data)

    async def _tick(self) -> None:
        async with aclosing(self._clock.ticks(self._twin.controller.sample_ms / 1e3)) as ticks:
            async for now_ns in ticks:
                await self._frost.thawed()
                await trio.lowlevel.checkpoint()  # Let the other task read the received answers first.
                self._say(now_ns)

    # -- receiving and sending

    def _take(self, t_ns: int, data: bytes) -> None:
        kind = self._answers.take(data)
        self._log.write(t_ns, "host", [(kind, data)], "hold" if kind == "safe" else None)

    def _say(self, now_ns: int) -> None:
        reply = self._twin.faults.apply(
            Reply(0.0, encode_monitoring(self._twin.cycle(), self._packed, self._checksum))
        )
        if reply is not None:
            self._late.append((now_ns + round((reply.delay_s + reply.late_s) * NS), reply.data))
        while self._late and self._late[0][0] <= now_ns:
            data = self._late.popleft()[1]
            if self._sock is not None:
                with suppress(BlockingIOError, ConnectionRefusedError):
                    self._sock.sendto(data, self._peer)


def read_ios(text: str) -> tuple[Io, ...]:
    """Read the option ``ios``. Raise ``ValueError``."""
    rows = [row.strip().split(":") for row in text.split(",") if row.strip()]
    ios = []
    for row in rows:
        match row:
            case [name, kind, way] if 0 < len(name.encode()) <= LONGEST_NAME:
                ios.append(Io(name, _member(IoType, kind), _member(IoDirection, way)))
            case _:
                raise ValueError(f"input or output {':'.join(row)!r} is not NAME:TYPE:DIRECTION")
    if len({io.name for io in ios}) < len(ios) or len(ios) > MOST_IOS:
        raise ValueError(f"register at most {MOST_IOS} inputs and outputs, each name once")
    return tuple(ios)


def _member(kinds: type[enum.IntEnum], name: str) -> int:
    try:
        return kinds[name.upper()]
    except KeyError:
        raise ValueError(f"{name!r} is none of {', '.join(kind.name.lower() for kind in kinds)}") from None


def _is_number(text: str) -> bool:
    try:
        return math.isfinite(float(text))
    except ValueError:
        return False


def _bound(host: str, port: int) -> socket.socket:
    sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    try:
        sock.setblocking(False)
        sock.bind((host, port))
    except BaseException:
        sock.close()
        raise
    return sock


def build(robot: str, options: KukaTwinOptions, log: WireLog) -> KukaServer:
    """Return the server of a robot of ``robots.toml``."""
    return KukaServer(arm_of(robot), log, options)


main = main_of(KukaTwinOptions, build)
