"""Simulate the controller's end of FRI: its UDP port sends a message every sample time, with or without
answers.

It binds an address in 127.0.0.0/8, with the port number of the client's end, and sends to that port at
``client``. The log has every answer: ``setpoint`` if its positions differ from those of the previous answer,
``safe`` (``hold``) if they repeat it or are missing, ``garbled`` if it is no command message. From the
controller the log has ``session`` with each state and its reason, but no monitoring messages.

Besides the control lines of every twin it takes ``motion start|stop`` (the pendant), ``safety
LEVEL``, ``drive JOINT NUMBER``, ``client_mode``, ``control_mode`` and ``overlay`` with the numbers
of the protocol.
"""

from __future__ import annotations

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
from strands_actors.drivers.kuka.protocol import FRI_PORT, JOINTS, LARGEST, encode_monitoring
from strands_actors.drivers.kuka.robots import Arm, arm_of
from strands_actors.kernel.clock import NS, MonotonicClock

from .answers import Answers
from .body import KukaBody
from .controller import Controller


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


LAST_PORT = 32767
"""Ports above this one are assigned by the system."""
ATTEMPTS = 64
WRONG_RAD = 1.0
MODES = ("safety", "client_mode", "control_mode", "overlay")


class KukaServer:
    """Serve one controller. Its methods are the events that may happen to it."""

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
        self._readings: Mapping[str, tuple[float, ...]] = {}  # repeated while it is stuck
        self._late: deque[tuple[int, bytes]] = deque()

    @property
    def address(self) -> str:
        host, port = self._place
        return f"{host}:{port}"

    # -- the network

    def _find_place(self, options: KukaTwinOptions) -> tuple[str, int]:
        """Return an address and a port that are free at both ends. Raise ``OSError``."""
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
        """Pull the cable. The controller notices by itself that answers are missing."""
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
        """Serve until cancelled."""
        async with trio.open_nursery() as nursery:
            nursery.start_soon(self._hear)
            nursery.start_soon(self._tick)

    async def _hear(self) -> None:
        while True:
            await self._plugged.wait()
            sock = self._sock
            if sock is None:  # The cable was pulled again before this task ran.
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
                await trio.lowlevel.checkpoint()  # Read the received data first.
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
        """Set the fault ``WORD``, or ``WORD:joint`` (1 to 7) for a joint that gets stuck. Raise
        ``ValueError``."""
        fault, joint = parse_fault(text)
        if joint is None:
            self._faults.set(fault)
            self._readings = {}
            stuck = range(JOINTS)
        elif 1 <= joint <= JOINTS and fault in (Fault.OK, Fault.STUCK):
            stuck = range(joint - 1, joint)
        else:
            raise ValueError(f"a joint, 1 to {JOINTS}, can be ok or stuck, not {fault}")
        for at in stuck:
            self.controller.plant.set_stuck(at, fault is Fault.STUCK)

    def power_cycle(self) -> None:
        self.controller.wake_up()

    def freeze(self, seconds: float) -> None:
        """Neither read nor send for this long. Afterwards process the data received meanwhile."""
        self._frost.freeze(seconds)

    def order(self, words: Sequence[str]) -> bool:
        controller = self.controller
        match words:
            case ["motion", "start" | "stop" as word]:
                controller.motion = word == "start"
            case ["drive", joint, number] if joint.isdecimal() and number.isdecimal() and 1 <= int(joint) <= JOINTS:
                controller.drives[int(joint) - 1] = int(number)
            case [name, number] if name in MODES and number.isdecimal():
                setattr(controller, name, int(number))
            case _:
                return False
        return True


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
    """Serve a robot of ``robots.toml`` until interrupted (see ``common.twin.run``)."""
    given = read_twin_options(robot, KukaTwinOptions, options)
    arm = arm_of(robot)

    def build(wire_log: WireLog) -> KukaServer:
        return KukaServer(arm, wire_log, given)

    run_server(build, **start)
