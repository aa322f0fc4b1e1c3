"""Indirect addresses of one servo: a block of bytes that shows other registers side by side."""

from __future__ import annotations

import enum
from collections.abc import Sequence
from typing import NamedTuple

from . import protocol as p
from . import table as t

FIRST_TARGET = t.EEPROM_END
"""First register that can be shown. Registers of the EEPROM cannot be."""


class Where(enum.Enum):
    TABLE = enum.auto()
    POINTERS = enum.auto()  # the registers with the addresses
    OWN = enum.auto()  # bytes that show themselves


class Run(NamedTuple):
    """Bytes side by side. ``at`` is their index in the place that ``where`` names."""

    where: Where
    at: int
    size: int
    last_target: int = 0

    def refuses(self, data: bytes) -> int:
        """Return the error number of a write outside the table; 0 if it is allowed."""
        if self.where is not Where.POINTERS:
            return 0
        if self.at % 2 or self.size % 2:
            return p.LENGTH_ERROR
        words = (int.from_bytes(data[at : at + 2], "little") for at in range(0, len(data), 2))
        return 0 if all(FIRST_TARGET <= word <= self.last_target for word in words) else p.RANGE_ERROR


class Indirect:
    """The indirect addresses in their state after a power-on: each byte shows itself."""

    def __init__(self, blocks: Sequence[t.IndirectBlock]) -> None:
        self._addresses = [block.addresses + at for block in blocks for at in range(2 * block.size)]
        self._data = [block.data + at for block in blocks for at in range(block.size)]
        self._pointers = bytearray(b"".join(address.to_bytes(2, "little") for address in self._data))
        self._own = bytearray(len(self._data))

    def runs(self, address: int, size: int) -> list[Run] | None:
        """Return the places of ``size`` bytes from ``address``; None if one of them does not exist."""
        runs: list[Run] = []
        for byte in range(address, address + size):
            found = self._find(byte)
            if found is None:
                return None
            where, at = found
            if runs and runs[-1].where is where and runs[-1].at + runs[-1].size == at:
                runs[-1] = runs[-1]._replace(size=runs[-1].size + 1)
            else:
                runs.append(Run(where, at, 1, self._data[-1]))
        return runs

    def read(self, run: Run, table: bytes | bytearray) -> bytes:
        source = {Where.TABLE: table, Where.POINTERS: self._pointers, Where.OWN: self._own}[run.where]
        return bytes(source[run.at : run.at + run.size])

    def write(self, run: Run, data: bytes) -> None:
        target = self._pointers if run.where is Where.POINTERS else self._own
        target[run.at : run.at + run.size] = data

    def _find(self, address: int) -> tuple[Where, int] | None:
        if address < t.TABLE_SIZE:
            return Where.TABLE, address
        if address in self._addresses:
            return Where.POINTERS, self._addresses.index(address)
        if address not in self._data:
            return None
        at = self._data.index(address)
        target = int.from_bytes(self._pointers[2 * at : 2 * at + 2], "little")
        if target < t.TABLE_SIZE:
            return Where.TABLE, target
        return (Where.OWN, self._data.index(target)) if target in self._data else (Where.OWN, at)
