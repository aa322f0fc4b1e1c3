"""An SO-101 whose wire process notes when a setpoint passes: for ``benchmarks.sides.hops``.

Everything is the arm's own. A note is a reading of the clock, under 0.1 µs; they go to a file in memory that the
caller reads afterwards.
"""

from __future__ import annotations

import mmap
import os
import struct
import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from strands_actors.drivers.common.serial_port import SerialPort, open_serial
from strands_actors.drivers.feetech.driver import Feetech
from strands_actors.drivers.feetech.wire import FeetechWire
from strands_actors.runtime.clock import Clock
from strands_actors.runtime.contract import Candidate, GateState, Permit
from strands_actors.runtime.messages import Refused
from strands_actors.runtime.node import Node

NOTES = "HOPS_NOTES"
"""Environment: path of the file."""

ROW = struct.Struct("<qqqqq")
ROWS = 4096


class Passed(NamedTuple):
    """CLOCK_MONOTONIC, ns, of one setpoint in the wire process."""

    arrived: int  # its frame was read off the line
    judged: int  # the gate has checked mode, lockout, lease, epoch and deadline, and asks the driver
    taken: int  # the driver's gates have passed, the transport has it
    at_port: int  # encoded, the permit given
    written: int  # the system call has returned


def blank(path: Path) -> None:
    path.write_bytes(bytes(ROW.size * ROWS))


def passed(path: Path) -> Iterator[Passed]:
    """One by one, in order."""
    for row in ROW.iter_unpack(path.read_bytes()):
        if row[0]:
            yield Passed(*row)


class Notes:
    """What the wire process knows of the setpoint that passes now."""

    def __init__(self) -> None:
        with open(os.environ[NOTES], "r+b") as file:
            self._rows = mmap.mmap(file.fileno(), 0)
        self._count = 0
        self.arrived = self.judged = self.taken = 0

    def note(self, at_port: int, written: int) -> None:
        if not self.judged or self._count == ROWS:
            return  # re-sent by the watchdog: nobody asked
        ROW.pack_into(self._rows, self._count * ROW.size, self.arrived, self.judged, self.taken, at_port, written)
        self._count += 1
        self.judged = 0


class _Port(SerialPort):
    notes: Notes

    def write(self, data: bytes) -> None:
        at_port = time.monotonic_ns()
        super().write(data)
        self.notes.note(at_port, time.monotonic_ns())


class _Wire(FeetechWire):
    def __init__(self, driver: TimedArm, clock: Clock, notes: Notes) -> None:
        def open_port(path: str, baud: int) -> SerialPort:
            opened = open_serial(path, baud)
            port = _Port(opened.fileno(), path, owner=True)
            port.notes = notes
            return port

        super().__init__(driver, clock, open_port)
        self._notes = notes

    async def write(self, values: tuple[float, ...], permit: Permit) -> None:
        self._notes.taken = time.monotonic_ns()
        await super().write(values, permit)


class TimedArm(Feetech):
    _notes: Notes | None = None

    def parse(self, action: Mapping[str, float], state: GateState) -> Candidate | Refused:
        if self._notes is not None:
            self._notes.judged = time.monotonic_ns()
            self._notes.arrived = _last_frame_ns
        return super().parse(action, state)

    def open_wire(self, clock: Clock) -> FeetechWire:
        self._notes = Notes()
        _watch_frames()
        return _Wire(self, clock, self._notes)


_last_frame_ns = 0


def _watch_frames() -> None:
    """The kernel has no hook where a frame comes in: it is wrapped there, in this process."""
    receive = Node.receive_frame

    def received(node: Node, *frame: Any) -> None:
        global _last_frame_ns
        _last_frame_ns = time.monotonic_ns()
        receive(node, *frame)

    Node.receive_frame = received  # type: ignore[method-assign,assignment]
