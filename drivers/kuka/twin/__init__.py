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
from typing import Annotated, Any, Unpack

import trio
from msgspec.structs import replace

from strands_actors.contract.options import option
from strands_actors.drivers.common.twin import (
    Fault,
    Faults,
    Reply,
    Start,
    TwinOptions,
    WireLog,
    own_host,
    parse_fault,
    read_twin_options,
    run_server,
)
from strands_actors.drivers.common.twin.server import Frost
from strands_actors.drivers.kuka.io import LONGEST_NAME, MOST_IOS, Io, IoDirection, IoType
from strands_actors.drivers.kuka.protocol import FRI_PORT, JOINTS, LARGEST, encode_monitoring
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


class KukaServer:
    """Run one simulated controller on its UDP port. Its methods are events, such as a fault or a pulled cable."""

    def __init__(self, arm: Arm, log: WireLog, options: KukaTwinOptions) -> None:
        self._log = log
        self._faults = Faults()
        self._frost = Frost()
        self._clock = MonotonicClock()
        self.controller = Controller(
            arm,
            sample_ms=options.sample_ms,
            multiplier=options.multiplier,
            note=self._note,
            ios=read_ios(options.ios),
        )
        self.body = KukaBody(self.controller)
        self._packed = options.packed
        self._checksum = options.checksum
        self._client = options.client
        self._sock: socket.socket | None = None
        self._plugged = trio.Event()
        host, port = self._find_place(options)
        self._place = host, port if options.from_port is None else options.from_port
        self._peer = self._client, port
        self._answers = Answers(self.controller)
        self._readings: Mapping[str, tuple[float, ...]] = {}  # Measurements that the fault ``stuck`` repeats.
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

    async def serve(self) -> None:
        """Send messages and receive answers until this task is cancelled."""
        async with trio.open_nursery() as nursery:
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
                if data and self._faults.of(None) is not Fault.OFF:
                    self._take(time.monotonic_ns(), data)

    async def _tick(self) -> None:
        async with aclosing(self._clock.ticks(self.controller.sample_ms / 1e3)) as ticks:
            async for now_ns in ticks:
                await self._frost.thawed()
                await trio.lowlevel.checkpoint()  # Let the other task read the received answers first.
                self._say(now_ns)

    # -- receiving and sending

    def _take(self, t_ns: int, data: bytes) -> None:
        kind = self._answers.take(data)
        self._log.write(t_ns, "host", [(kind, data)], "hold" if kind == "safe" else None)

    def _say(self, now_ns: int) -> None:
        message = self.controller.cycle()
        match self._faults.of(None):
            case Fault.WRONG:
                message = replace(message, position=tuple(rad + WRONG_RAD for rad in message.position))
            case Fault.STUCK:
                self._readings = self._readings or {"position": message.position, "torque": message.torque}
                message = replace(message, **self._readings)
        reply = self._faults.apply(Reply(0.0, encode_monitoring(message, self._packed, self._checksum)))
        if reply is not None:
            self._late.append((now_ns + round((reply.delay_s + reply.late_s) * NS), reply.data))
        while self._late and self._late[0][0] <= now_ns:
            data = self._late.popleft()[1]
            if self._sock is not None:
                with suppress(BlockingIOError, ConnectionRefusedError):
                    self._sock.sendto(data, self._peer)

    def _note(self, text: str) -> None:
        self._log.write(time.monotonic_ns(), "robot", [("session", text.encode())])

    # -- events

    def set_fault(self, text: str) -> None:
        """Inject a fault. ``text`` is ``FAULT``, or ``FAULT:JOINT`` with a joint from 1 to 7.

        A joint can only get stuck. Raise ``ValueError`` for any other text.
        """
        fault, joint = parse_fault(text)
        if joint is None:
            self._faults.set(fault)
            self._readings = {}
            stuck = range(JOINTS)
        elif 1 <= joint <= JOINTS and fault in (Fault.OK, Fault.STUCK):
            stuck = range(joint - 1, joint)
        else:
            raise ValueError(f"a joint, 1 to {JOINTS}, can be ok or stuck, not {fault}")
        for index in stuck:
            self.controller.plant.set_stuck(index, fault is Fault.STUCK)

    def power_cycle(self) -> None:
        self.controller.wake_up()

    def freeze(self, seconds: float) -> None:
        """Stop reading and sending for this time. Afterwards process the data received meanwhile."""
        self._frost.freeze(seconds)

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


def main(robot: str, *, options: Mapping[str, Any] | None = None, **start: Unpack[Start]) -> None:
    """Run the simulated robot of this name from ``robots.toml`` until interrupted (see ``common.twin.run``)."""
    chosen = read_twin_options(robot, KukaTwinOptions, options)
    arm = arm_of(robot)

    def build(wire_log: WireLog) -> KukaServer:
        return KukaServer(arm, wire_log, chosen)

    run_server(build, **start)
