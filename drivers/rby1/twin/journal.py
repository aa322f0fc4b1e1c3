"""The log of the simulated robot, and the files in which it keeps the state at each fault."""

from __future__ import annotations

import enum
from collections import deque
from collections.abc import Mapping, Sequence
from typing import NamedTuple

from strands_actors.drivers.common.codecs import protobuf as pb

NS = 1_000_000_000
LINES, FAULTS = 1000, 20
"""The robot keeps so many lines and files. The oldest are dropped first [assumed]."""


class Level(enum.IntEnum):
    TRACE = 0
    DEBUG = 1
    INFO = 2
    WARN = 3
    ERROR = 4
    CRITICAL = 5


class Line(NamedTuple):
    number: int  # counts from 1
    time_ns: int
    level: Level
    text: str

    def encode(self) -> bytes:
        """Encode ``Log``. Both of its times are the robot's."""
        stamp = stamped(self.time_ns)
        return (
            pb.bytes_field(1, stamp)
            + pb.varint_field(2, self.level)
            + pb.bytes_field(3, self.text.encode())
            + pb.bytes_field(4, stamp)
        )


class Journal:
    def __init__(self) -> None:
        self.level = Level.INFO
        self.newest = 0  # number of the newest line
        self.faults: dict[str, bytes] = {}
        self._lines: deque[Line] = deque(maxlen=LINES)

    def write(self, time_ns: int, level: Level, text: str) -> None:
        """Add a line. Lines below the robot's log level are not kept."""
        if level >= self.level:
            self.newest += 1
            self._lines.append(Line(self.newest, time_ns, level, text))

    def last(self, count: int) -> list[Line]:
        """Return the newest lines, the oldest of them first."""
        return list(self._lines)[-count:] if count > 0 else []

    def since(self, number: int) -> list[Line]:
        """Return the lines after the line with this number."""
        return [line for line in self._lines if line.number > number]

    def keep_fault(self, time_ns: int, fault: str, joints: Mapping[str, Sequence[float]]) -> None:
        """Keep a file with the state of the joints at a fault, as comma-separated values."""
        lines = ["time_ns,fault,joint,position,velocity,torque"]
        lines += [f"{time_ns},{fault},{name}," + ",".join(map(repr, row)) for name, row in joints.items()]
        self.faults[f"fault_{time_ns}.csv"] = ("\n".join(lines) + "\n").encode()
        while len(self.faults) > FAULTS:
            del self.faults[next(iter(self.faults))]


def stamped(time_ns: int) -> bytes:
    """Encode a ``Timestamp``."""
    seconds, nanos = divmod(max(0, time_ns), NS)
    return pb.varint_field(1, seconds) + pb.varint_field(2, nanos)
