"""The twin's log of a bus that LeRobot writes to. Its frames are not ours: it takes the torque of
one servo after the other, and holds by a setpoint like any other. Here a frame is safe when, with
those before it, all servos are without torque; or when it gives every servo the position that this
servo has just told as its goal."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from strands_actors.testing import Twin, WireLog
from strands_actors.testing.wirelog import Entry, Tail

from .calibration import MOTORS

ALL = frozenset(range(1, len(MOTORS) + 1))
DYNAMIXEL = b"\xff\xff\xfd\x00"
BROADCAST = 0xFE
SYNC_WRITE = 0x83
"""Of both protocols."""


class Packet(NamedTuple):
    """Of a request or a status. ``places``: how many bytes an address has, and a size."""

    id: int
    code: int
    params: bytes
    places: int


def packet_of(frame: bytes) -> Packet:
    """Read a whole frame of Dynamixel's protocol 2 or Feetech's."""
    if frame.startswith(DYNAMIXEL):
        return Packet(frame[4], frame[7], frame[8:-2], 2)
    return Packet(frame[2], frame[4], frame[5:-1], 1)


def rows_of(packet: Packet) -> dict[int, bytes]:
    """The bytes for each servo of a write."""
    places = packet.places
    if packet.code != SYNC_WRITE:
        return {packet.id: packet.params[places:]}
    size = int.from_bytes(packet.params[places : 2 * places], "little")
    rows = packet.params[2 * places :]
    return {rows[at]: rows[at + 1 : at + 1 + size] for at in range(0, len(rows), size + 1)}


class TheirTail(Tail):
    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self._told: dict[int, bytes] = {}  # by each servo, last
        self._off: frozenset[int] = frozenset()

    def new(self) -> Iterator[Entry]:
        return map(self._judged, super().new())

    def _judged(self, entry: Entry) -> Entry:
        packet = packet_of(entry.data) if len(entry.data) > 6 else None
        if packet is None:
            return entry
        if entry.sender == "robot":
            error = packet.places - 1  # Dynamixel tells it with the params
            self._told[packet.id] = packet.params[error:]
            return entry
        ids = ALL if packet.id == BROADCAST and packet.code != SYNC_WRITE else frozenset(rows_of(packet))
        match entry.kind:
            case "enable":
                self._off -= ids
            case "safe" if entry.safe_state != "hold":
                self._off |= ids
                done = self._off >= ALL
                return entry._replace(kind="safe" if done else "other", safe_state="limp" if done else None)
            case "setpoint" if ids >= ALL and all(self._told.get(at) == row for at, row in rows_of(packet).items()):
                return entry._replace(kind="safe", safe_state="hold")
        return entry


class TheirLog(WireLog):
    def tail(self) -> Tail:
        return TheirTail(self.path)


def read_as_theirs(twin: Twin) -> None:
    """Have a twin's log read so."""
    twin.log = TheirLog(twin.log.path)
