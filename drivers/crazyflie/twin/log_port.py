"""Simulate the port for the log: the table of variables, and blocks of variables that are reported periodically.

Source: the firmware's page ``crtp_log``, and cflib.
"""

from __future__ import annotations

import enum
import struct
from collections.abc import Iterator
from dataclasses import dataclass, field

from strands_actors.drivers.common.twin.modelled import Modelled
from strands_actors.drivers.crazyflie.protocol import STAMP_WRAP_MS, Port, encode

from . import packets
from .packets import Reaction, answer
from .tables import LOG, LOG_LAYOUTS, Reading, checksum, packed

BLOCK_BYTES = 26
"""Largest size of the values of a block."""
BLOCKS, VARIABLES = 16, 128
"""Largest number of blocks, and of variables in all of them."""
_TABLE, _CONTROL, _DATA = range(3)
_GET_ITEM, _GET_INFO = 2, 3


class Control(enum.IntEnum):
    DELETE = 2
    START = 3
    STOP = 4
    RESET = 5
    CREATE = 6
    APPEND = 7
    START_2 = 8


CONTROLS: Modelled[int] = Modelled(
    "commands to the log",
    {
        Control.DELETE: "deletes a block; error 2 for an unknown one",
        Control.START: "reports a block, with a period in units of 10 ms; 0 for once",
        Control.STOP: "stops the reports of a block",
        Control.RESET: "deletes all blocks",
        Control.CREATE: "creates a block; errors 2, 7, 12 and 17",
        Control.APPEND: "appends variables to a block",
        Control.START_2: "as 3, with a period in ms",
    },
    "error 8, no such command",
)


@dataclass
class Block:
    # number of the variable in the table, and type in which it is sent
    variables: list[tuple[int, int]] = field(default_factory=list)
    period_s: float = 0.0  # 0 if the block is not started
    due_s: float | None = None

    @property
    def size(self) -> int:
        return sum(struct.calcsize(LOG_LAYOUTS[code]) for _, code in self.variables)


class LogPort:
    def __init__(self) -> None:
        self.blocks: dict[int, Block] = {}

    def boot(self) -> None:
        """Lose all blocks."""
        self.blocks.clear()

    def reports(self, reading: Reading, now_s: float, since_boot_s: float) -> Iterator[bytes]:
        """Return the reports that are due."""
        for number, block in self.blocks.items():
            if block.due_s is None or now_s < block.due_s:
                continue
            block.due_s = max(block.due_s + block.period_s, now_s) if block.period_s else None
            values = (packed(LOG_LAYOUTS[code], LOG[index].read(reading)) for index, code in block.variables)
            stamp_ms = round(since_boot_s * 1e3) % STAMP_WRAP_MS
            head = bytes((number,)) + stamp_ms.to_bytes(3, "little")
            yield encode(Port.LOG, _DATA, head + b"".join(values))

    def is_due(self, now_s: float) -> bool:
        return any(block.due_s is not None and now_s >= block.due_s for block in self.blocks.values())

    def receive(self, channel: int, data: bytes, now_s: float) -> Reaction:
        """Answer a packet. Raise ``struct.error`` and ``IndexError`` for a malformed one."""
        if channel == _TABLE:
            return self._describe(data)
        command = data[0]
        if command == Control.RESET:
            self.blocks.clear()
            return answer(Port.LOG, _CONTROL, b"\5\0\0")
        status = self._change(command, data[1], data[2:], now_s) if command in CONTROLS else packets.ENOEXEC
        return answer(Port.LOG, _CONTROL, data[:2].ljust(2, b"\0") + bytes((status,)))

    def _describe(self, data: bytes) -> Reaction:
        if data[0] == _GET_INFO:
            info = struct.pack("<BHIBB", _GET_INFO, len(LOG), checksum(LOG), BLOCKS, VARIABLES)
            return answer(Port.LOG, _TABLE, info)
        if data[0] != _GET_ITEM:
            return Reaction("other")
        number = struct.unpack("<H", data[1:3])[0]
        if number >= len(LOG):
            return answer(Port.LOG, _TABLE, data[:1])
        variable = LOG[number]
        names = f"{variable.group}\0{variable.name}\0".encode()
        return answer(Port.LOG, _TABLE, data[:3] + bytes((variable.type_code,)) + names)

    def _change(self, command: int, number: int, data: bytes, now_s: float) -> int:
        """Carry out a command on one block. Return an error number; 0 for success."""
        block = self.blocks.get(number)
        if command == Control.CREATE:
            if block is not None:
                return packets.EEXIST
            if len(self.blocks) >= BLOCKS:
                return packets.ENOMEM
            block = self.blocks[number] = Block()
            return self._append(block, data)
        if block is None:
            return packets.ENOENT
        match command:
            case Control.APPEND:
                return self._append(block, data)
            case Control.START:
                block.period_s, block.due_s = data[0] / 100, now_s
            case Control.START_2:
                block.period_s, block.due_s = struct.unpack("<H", data[:2])[0] / 1000, now_s
            case Control.STOP:
                block.due_s = None
            case _:
                del self.blocks[number]
        return 0

    def _append(self, block: Block, data: bytes) -> int:
        """Append variables until one does not fit. Return an error number; 0 for success."""
        for type_code, index in struct.iter_unpack("<BH", data[: len(data) // 3 * 3]):
            code = type_code & 0x0F
            if code not in LOG_LAYOUTS:
                return packets.ENOENT
            if block.size + struct.calcsize(LOG_LAYOUTS[code]) > BLOCK_BYTES:
                return packets.E2BIG
            if sum(len(each.variables) for each in self.blocks.values()) >= VARIABLES:
                return packets.ENOMEM
            if index >= len(LOG):
                return packets.ENOENT
            block.variables.append((index, code))
        return 0


__all__ = ["CONTROLS", "Control", "LogPort"]
