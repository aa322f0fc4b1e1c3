"""Simulate the drone's memories: their contents, and which of them can be written.

A Crazyflie 2.1 with one deck, a Flow deck v2, has the memories of the table ``MEMORIES``. A memory of a deck that
is not attached does not exist. An address outside a memory gives error 5.

Sources: the firmware's pages ``memory-subsystem`` and ``deck_memory_format``, tried with cflib.
"""

from __future__ import annotations

import enum
import struct
import zlib

from strands_actors.drivers.common.twin.modelled import Modelled

EEPROM_BYTES = 0x1FFF
ONE_WIRE_BYTES = 112
DECK_BYTES = 0x10000000
"""Size of the memory of one deck, and of the description of all."""
TESTER_BYTES = 0x1000
TRAJECTORY_BYTES = 4096
"""Size of the memory for trajectories: 31 uncompressed pieces."""
_SERIAL_BYTES = 8
_MOST_READ = 24
"""Largest number of bytes in one answer [assumed]: the rest of a packet."""


class Kind(enum.IntEnum):
    """Types of memories."""

    EEPROM = 0x00
    ONE_WIRE = 0x01
    TRAJECTORY = 0x12
    TESTER = 0x15
    DECKS = 0x19


MEMORIES: Modelled[int] = Modelled(
    "memories, by type",
    {
        Kind.EEPROM: "keeps the settings of the radio and the trim",
        Kind.ONE_WIRE: "names the deck that is attached, a Flow deck v2",
        Kind.TRAJECTORY: "keeps the trajectories of the high-level commander, 4096 bytes",
        Kind.TESTER: "returns the low byte of each address, and counts packets that write another",
        Kind.DECKS: "describes the memories of decks: the Flow deck has none",
    },
    "there is no such memory. The firmware restarts when its number is used",
)

_RADIO_CHANNEL, _RADIO_RATE, _RADIO_ADDRESS = 80, 2, 0xE7E7E7E7E7
_FLOW_DECK_VID, _FLOW_DECK_PID = 0xBC, 0x0F
_DECKS_VERSION = 3


class Memory:
    """One memory of bytes that can be read and written."""

    def __init__(self, kind: Kind, data: bytearray, serial: bytes = bytes(_SERIAL_BYTES)) -> None:
        self.kind = kind
        self.data = data
        self.serial = serial

    @property
    def size(self) -> int:
        return len(self.data)

    def read(self, address: int, count: int) -> bytes | None:
        """Return bytes; None if they cannot be read."""
        return bytes(self.data[address : address + count]) if address + count <= len(self.data) else None

    def write(self, address: int, data: bytes) -> bool:
        """Store bytes. Return False if they cannot be written."""
        if address + len(data) > len(self.data):
            return False
        self.data[address : address + len(data)] = data
        return True


class Tester(Memory):
    """The memory for tests of the link: the low byte of the address stands at each address."""

    def __init__(self) -> None:
        super().__init__(Kind.TESTER, bytearray())
        self.errors = 0

    @property
    def size(self) -> int:
        return TESTER_BYTES

    def read(self, address: int, count: int) -> bytes | None:
        return bytes(place & 0xFF for place in range(address, address + count))

    def write(self, address: int, data: bytes) -> bool:
        self.errors += data != self.read(address, len(data))
        return True


class Decks(Memory):
    """The memories of decks: a description of each, and then the memories. The Flow deck has no memory."""

    def __init__(self) -> None:
        super().__init__(Kind.DECKS, bytearray((_DECKS_VERSION,)))

    @property
    def size(self) -> int:
        return 5 * DECK_BYTES

    def read(self, address: int, count: int) -> bytes | None:
        if address >= DECK_BYTES:
            return None
        return bytes(self.data[address : address + count]).ljust(count, b"\0")

    def write(self, address: int, data: bytes) -> bool:
        return False


class Memories:
    """All memories, by their numbers."""

    def __init__(self) -> None:
        self.trajectories = bytearray(TRAJECTORY_BYTES)
        self.tester = Tester()
        self._memories: tuple[Memory, ...] = (
            Memory(Kind.EEPROM, _eeprom()),
            Memory(Kind.TRAJECTORY, self.trajectories),
            self.tester,
            Decks(),
            Memory(Kind.ONE_WIRE, _one_wire(), bytes((0x0D, 0x02, 0x6F, 0x11, 0, 0, 0, 0x5A))),
        )

    def __len__(self) -> int:
        return len(self._memories)

    def boot(self) -> None:
        """Lose the contents that need power."""
        self.trajectories[:] = bytes(TRAJECTORY_BYTES)
        self.tester.errors = 0

    def describe(self, number: int) -> bytes:
        """Return type, size and serial number of a memory."""
        memory = self._memories[number]
        return struct.pack("<BI", memory.kind, memory.size) + memory.serial

    def read(self, number: int, address: int, count: int) -> bytes | None:
        """Return bytes of a memory; None if they cannot be read."""
        return self._memories[number].read(address, count) if count <= _MOST_READ else None

    def write(self, number: int, address: int, data: bytes) -> bool:
        """Store bytes in a memory. Return False if they cannot be written."""
        return self._memories[number].write(address, data)


def _eeprom() -> bytearray:
    """Return the EEPROM of a new drone: its radio's channel, rate and address, its trim, and a sum of all bytes."""
    upper, lower = _RADIO_ADDRESS >> 32, _RADIO_ADDRESS & 0xFFFFFFFF
    settings = b"0xBC" + struct.pack("<BBBffBI", 1, _RADIO_CHANNEL, _RADIO_RATE, 0.0, 0.0, upper, lower)
    data = bytearray(b"\xff") * EEPROM_BYTES
    data[: len(settings) + 1] = settings + bytes((sum(settings) % 256,))
    return data


def _one_wire() -> bytearray:
    """Return the memory of the Flow deck: a header, and its name and revision."""
    header = struct.pack("<BIBB", 0xEB, 0, _FLOW_DECK_VID, _FLOW_DECK_PID)
    names = b"".join(bytes((key, len(text))) + text for key, text in ((1, b"bcFlow2"), (2, b"A")))
    body = bytes((0, len(names))) + names
    data = bytearray(b"\xff") * ONE_WIRE_BYTES
    text = header + bytes((zlib.crc32(header) & 0xFF,)) + body + bytes((zlib.crc32(body) & 0xFF,))
    data[: len(text)] = text
    return data


__all__ = ["MEMORIES", "Kind", "Memories"]
