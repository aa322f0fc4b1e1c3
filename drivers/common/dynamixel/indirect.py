"""Simulate the indirect addresses of a Dynamixel servo.

A host can read and write registers from all over the control table through one contiguous block of bytes. A second
block holds, for each of these bytes, the address of the register that it refers to.
"""

from __future__ import annotations

import enum
from collections.abc import Sequence
from typing import NamedTuple

from . import protocol as p
from . import table as t

FIRST_TARGET = t.EEPROM_END
"""First register that can be shown. Registers of the EEPROM cannot be."""


class Region(enum.Enum):
    TABLE = enum.auto()
    POINTERS = enum.auto()  # the registers that hold the indirect addresses
    OWN = enum.auto()  # memory of the bytes in the block that refer to no register


class Run(NamedTuple):
    """Consecutive bytes in one memory of the servo (see ``Region``). ``offset`` is the index of the first of these
    bytes in that memory."""

    region: Region
    offset: int
    size: int
    last_target: int = 0

    def refuses(self, data: bytes) -> int:
        """Return the error number of a write of ``data`` to this run, if it would store an indirect address to
        which no byte may refer, or half of an address. Return 0 if the write is allowed."""
        if self.region is not Region.POINTERS:
            return 0
        if self.offset % 2 or self.size % 2:
            return p.LENGTH_ERROR
        words = (int.from_bytes(data[offset : offset + 2], "little") for offset in range(0, len(data), 2))
        return 0 if all(FIRST_TARGET <= word <= self.last_target for word in words) else p.RANGE_ERROR


class Indirect:
    """The indirect addresses of one servo (a block of bytes, each of which can refer to any register). After a
    power-on no byte of the block refers to a register; each one is plain memory."""

    def __init__(self, blocks: Sequence[t.IndirectBlock]) -> None:
        self._addresses = [block.addresses + offset for block in blocks for offset in range(2 * block.size)]
        self._data = [block.data + offset for block in blocks for offset in range(block.size)]
        self._pointers = bytearray(b"".join(address.to_bytes(2, "little") for address in self._data))
        self._own = bytearray(len(self._data))

    def runs(self, address: int, size: int) -> list[Run] | None:
        """Return the parts of the servo's memory that hold the ``size`` bytes from ``address`` on; None if one of
        these bytes does not exist."""
        runs: list[Run] = []
        for byte in range(address, address + size):
            location = self._find(byte)
            if location is None:
                return None
            region, offset = location
            if runs and runs[-1].region is region and runs[-1].offset + runs[-1].size == offset:
                runs[-1] = runs[-1]._replace(size=runs[-1].size + 1)
            else:
                runs.append(Run(region, offset, 1, self._data[-1]))
        return runs

    def read(self, run: Run, table: bytes | bytearray) -> bytes:
        source = {Region.TABLE: table, Region.POINTERS: self._pointers, Region.OWN: self._own}[run.region]
        return bytes(source[run.offset : run.offset + run.size])

    def write(self, run: Run, data: bytes) -> None:
        target = self._pointers if run.region is Region.POINTERS else self._own
        target[run.offset : run.offset + run.size] = data

    def _find(self, address: int) -> tuple[Region, int] | None:
        if address < t.TABLE_SIZE:
            return Region.TABLE, address
        if address in self._addresses:
            return Region.POINTERS, self._addresses.index(address)
        if address not in self._data:
            return None
        offset = self._data.index(address)
        target = int.from_bytes(self._pointers[2 * offset : 2 * offset + 2], "little")
        if target < t.TABLE_SIZE:
            return Region.TABLE, target
        return (Region.OWN, self._data.index(target)) if target in self._data else (Region.OWN, offset)
