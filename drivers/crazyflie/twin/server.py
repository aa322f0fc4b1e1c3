"""Run the simulated drone as a process: its firmware behind one link, which may lose and delay packets.

Besides the control lines of every simulated robot it takes ``battery VOLTS``, ``tip-over`` (onto its back),
``stand-up`` (onto its feet) and ``link LOSS DELAY_S`` (the share of lost packets, and their delay in seconds).
"""

from __future__ import annotations

import heapq
import itertools
import math
import random
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import aclosing
from typing import Annotated, Any, Literal

import trio

from strands_actors.contract.options import option
from strands_actors.drivers.common.twin import (
    Fault,
    NetworkOptions,
    Reply,
    TwinRobot,
    TwinServer,
    WireLog,
    main_of,
    own_host,
)
from strands_actors.drivers.common.twin.lateness import Lateness
from strands_actors.drivers.crazyflie.robots import TABLES
from strands_actors.kernel.clock import NS, MonotonicClock

from .ends import End, SerialEnd, TcpEnd, UdpEnd
from .firmware import Firmware
from .simulated import CrazyflieBody


class CrazyflieTwinOptions(NetworkOptions, frozen=True):
    link: Annotated[Literal["udp", "tcp", "serial"], option("what it is connected by")] = "udp"
    loss: Annotated[float, option("share of packets that are lost, each way", ge=0, le=1)] = 0.0
    delay_s: Annotated[float, option("seconds that a packet takes, each way", ge=0)] = 0.0
    protocol: Annotated[int, option("CRTP protocol version it reports")] = 12
    auto_arm: Annotated[bool, option("whether it arms by itself at boot, as a drone with brushed motors does")] = (
        False
    )
    spin_up_s: Annotated[float, option("seconds that its motors need to spin up after arming", ge=0, le=1.9)] = 0.2
    trace: Annotated[str, option("path of a file with time, height and tilt, a line every 10 ms; empty: none")] = ""


TICK_S = 0.01
WRONG_M = 1.0
SEED = 23


class Drone(TwinRobot):
    """The faults and restarts of one simulated drone."""

    def __init__(self, firmware: Firmware) -> None:
        super().__init__()
        self.firmware = firmware
        self.body = CrazyflieBody(firmware)

    def begin_fault(self, fault: Fault) -> None:
        firmware = self.firmware
        firmware.pass_time()
        firmware.stuck = None
        firmware.stuck = firmware.reading if fault is Fault.STUCK else None
        firmware.wrong_m = WRONG_M if fault is Fault.WRONG else 0.0

    def power_cycle(self) -> None:
        self.firmware.boot()


class CrazyflieServer(TwinServer):
    """Serve one simulated drone over its link."""

    def __init__(self, table: Mapping[str, Any], log: WireLog, end: End, options: CrazyflieTwinOptions) -> None:
        self._end = end
        self._clock = MonotonicClock()
        self._chance = random.Random(SEED)
        self._loss, self._delay_s = options.loss, options.delay_s
        self._lateness = Lateness()
        self._late_of: dict[tuple[str, int], float] = {}
        # Packets on their way: arrival time, sequence number, True if for the robot, and the packet.
        self._underway: list[tuple[int, int, bool, bytes]] = []
        self._order = itertools.count()
        self.firmware = Firmware(
            table,
            time.monotonic,
            protocol=options.protocol,
            auto_arm=options.auto_arm,
            spin_up_s=options.spin_up_s,
            note=lambda text: log.write(time.monotonic_ns(), "robot", [("note", text.encode())]),
        )
        self._drone = Drone(self.firmware)
        super().__init__(self._drone, log)
        self._trace = open(options.trace, "w", buffering=1) if options.trace else None  # noqa: SIM115  # closed with the twin

    @property
    def address(self) -> str:
        return self._end.address

    def start(self, nursery: trio.Nursery) -> None:
        nursery.start_soon(self._listen)
        nursery.start_soon(self._tick)

    async def _listen(self) -> None:
        while True:
            packet = await self._end.receive()
            await self._frost.thawed()
            if not self._drone.is_off:
                self._pass_on(packet, to_robot=True, late_s=self._late_s())

    def _late_s(self) -> float:
        """Return the delay of the newest packet, in seconds. A fault can delay the packets of one sender."""
        peer = self._end.peer if isinstance(self._end, UdpEnd) else None
        if peer is None:
            return 0.0
        if peer not in self._late_of:
            self._late_of[peer] = self._lateness.of_address(peer)
        return self._late_of[peer]

    async def _tick(self) -> None:
        async with aclosing(self._clock.ticks(TICK_S)) as ticks:
            async for _ in ticks:
                await self._frost.thawed()
                self.firmware.pass_time()
                self._deliver()
                for report in self.firmware.reports():
                    self._send_reply(report)
                if self._trace is not None:
                    body = self.firmware.body
                    line = (time.monotonic(), body.xyz_m[2], math.degrees(body.tilt_rad))
                    self._trace.write("{:.4f} {:.4f} {:.3f}\n".format(*line))

    # -- the link

    def _pass_on(self, packet: bytes, to_robot: bool, late_s: float = 0.0) -> None:
        """Deliver a packet now or later, or lose it."""
        if self._loss and self._chance.random() < self._loss:
            return
        late_s += self._delay_s
        if late_s <= 0:
            self._arrive(packet, to_robot)
        else:
            due_ns = time.monotonic_ns() + round(late_s * NS)
            heapq.heappush(self._underway, (due_ns, next(self._order), to_robot, packet))

    def _deliver(self) -> None:
        while self._underway and self._underway[0][0] <= time.monotonic_ns():
            _, _, to_robot, packet = heapq.heappop(self._underway)
            self._arrive(packet, to_robot)

    def _arrive(self, packet: bytes, to_robot: bool) -> None:
        if not to_robot:
            self._end.send(packet)
            return
        t_ns = time.monotonic_ns()
        self.firmware.pass_time()
        reaction = self.firmware.receive(packet)
        self._log.write(t_ns, "host", [(reaction.kind, packet)], reaction.safe_state)
        for reply in reaction.replies:
            self._send_reply(reply)

    def _send_reply(self, packet: bytes) -> None:
        reply = self._drone.faults.apply(Reply(0.0, packet))
        if reply is not None:
            self._log.write(time.monotonic_ns(), "robot", [("read", reply.data)])
            self._pass_on(reply.data, to_robot=False, late_s=reply.delay_s + reply.late_s)

    # -- events

    def plug(self) -> None:
        self._end.plug()

    def unplug(self) -> None:
        """Cut the link. The drone notices by itself that setpoints are missing."""
        self._end.unplug()

    def set_delay(self, lateness: Lateness) -> None:
        """Delay the UDP packets of one client process."""
        self._lateness = lateness
        self._late_of.clear()

    def order(self, words: Sequence[str]) -> bool:
        match words:
            case ["battery", volts]:
                self.firmware.battery_v = float(volts)
            case ["tip-over"]:
                self.firmware.body.tip_over()
            case ["stand-up"]:
                self.firmware.body.stand_up()
            case ["link", loss, delay_s]:
                self._loss, self._delay_s = float(loss), float(delay_s)
            case _:
                return False
        return True

    def close(self) -> None:
        self._end.close()
        if self._trace is not None:
            self._trace.close()


def open_end(options: CrazyflieTwinOptions) -> End:
    """Open the drone's side of the link that ``options`` names. Raise ``OSError``."""
    host, port = options.host or own_host(), options.port
    ends: dict[str, Callable[[], End]] = {
        "udp": lambda: UdpEnd(host, port),
        "tcp": lambda: TcpEnd(host, port),
        "serial": SerialEnd,
    }
    return ends[options.link]()


def build(robot: str, options: CrazyflieTwinOptions, log: WireLog) -> CrazyflieServer:
    """Return the server of a robot of ``robots.toml``."""
    return CrazyflieServer(TABLES.table(robot), log, open_end(options), options)


main = main_of(CrazyflieTwinOptions, build)
