"""Answer standard Modbus TCP, which the control port of an xArm accepts beside the vendor's own protocol.

Functions, addresses, units and exceptions are those of the vendor's manual (UF_ModbusTCP_Manual in the source of
xarm-python-sdk 1.18). Registers of the manual that this controller lacks get exception 2: inputs and outputs that
are not effective, brakes, payload, offsets and offline tasks, and a write to a state of the robot.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Mapping, Sequence

from strands_actors.drivers.common.twin.modelled import Modelled
from strands_actors.drivers.xarm.protocol import JOINTS, State

from .controller import Controller
from .registers import Other

ILLEGAL_FUNCTION, ILLEGAL_ADDRESS, ILLEGAL_DATA = 1, 2, 3
COILS, INPUTS, HOLDING, INPUT_REGISTERS = 1, 2, 3, 4
WRITE_COIL, WRITE_REGISTER, WRITE_COILS, WRITE_REGISTERS = 5, 6, 15, 16

FUNCTIONS: Modelled[int] = Modelled(
    "functions of standard Modbus at the control port",
    {
        COILS: "returns digital outputs, enabled joints, reduced mode, boundary, state and mode, bit by bit",
        INPUTS: "returns digital inputs",
        HOLDING: "returns outputs, mode and state",
        INPUT_REGISTERS: "returns inputs, error, pose, angles and speeds",
        WRITE_COIL: "sets a digital output, the reduced mode, the boundary or a bit of the user's",
        WRITE_REGISTER: "sets the outputs, the mode, the state or a word of the user's",
        WRITE_COILS: "sets several bits",
        WRITE_REGISTERS: "sets several words",
    },
    "exception 1 of Modbus; exception 2 for an address that is not modelled",
)

USER = range(0x100, 0x200)
"""Coils and holding registers that a user may define."""
MODES = 14
_SWITCHES = {0x8E: Other.SET_REDUCED, 0x8F: Other.SET_FENCE}


class _Refused(Exception):
    """Raised with the number of a Modbus exception."""


class Modbus:
    """The registers of one controller. All clients share them."""

    def __init__(self, controller: Controller) -> None:
        self._controller = controller
        self._bits = dict.fromkeys(USER, 0)
        self._words = dict.fromkeys(USER, 0)

    def answer(self, request: bytes) -> bytes:
        """Carry out a request (unit, function and data), and return the reply in the same form."""
        head, data = request[:2], request[2:]
        try:
            if len(head) < 2 or head[1] not in FUNCTIONS:
                raise _Refused(ILLEGAL_FUNCTION)
            return head + self._do(head[1], data)
        except _Refused as refused:
            return request[:1] + bytes((request[1] | 0x80 if len(head) > 1 else 0x80, refused.args[0]))
        except struct.error:
            return request[:1] + bytes((request[1] | 0x80, ILLEGAL_DATA))

    def _do(self, function: int, data: bytes) -> bytes:
        first, count = struct.unpack_from(">HH", data)
        match function:
            case _ if function in (COILS, INPUTS):
                bits = _read(self._coils() if function == COILS else self._inputs(), first, count)
                packed = sum(bit << index for index, bit in enumerate(bits)).to_bytes(-(-count // 8), "little")
                return bytes((len(packed),)) + packed
            case _ if function in (HOLDING, INPUT_REGISTERS):
                words = _read(self._holding() if function == HOLDING else self._input_registers(), first, count)
                return struct.pack(f">B{count}H", 2 * count, *(word & 0xFFFF for word in words))
            case _ if function == WRITE_COIL:
                self._write(self._set_coil, self._coils(), first, [int(count == 0xFF00)])
            case _ if function == WRITE_REGISTER:
                self._write(self._set_word, self._holding(), first, [count])
            case _ if function == WRITE_COILS:
                size = -(-count // 8)
                (row,) = struct.unpack_from(f"{size}s", data, 5)
                word = int.from_bytes(row, "little")
                self._write(self._set_coil, self._coils(), first, [word >> index & 1 for index in range(count)])
            case _:
                self._write(self._set_word, self._holding(), first, struct.unpack_from(f">{count}H", data, 5))
        return data[:4]

    def _write(
        self, set_one: Callable[[int, int], None], registers: Mapping[int, int], first: int, values: Sequence[int]
    ) -> None:
        _read(registers, first, len(values))
        for address, value in enumerate(values, first):
            set_one(address, value)

    # -- reading

    def _coils(self) -> dict[int, int]:
        robot = self._controller
        reduced, fence = (robot.obey(register, b"")[1] for register in (Other.GET_REDUCED, Other.REDUCED_STATE))
        return {
            **_bits(0, 16, robot.devices.outputs),
            **_bits(0x20, 2, robot.devices.tool_outputs),
            **_bits(0x87, JOINTS, robot.enabled),
            0x8E: reduced[0],
            0x8F: fence[-2],
            0x90: int(robot.state == State.PAUSED),
            0x91: int(robot.state == State.STOPPED),
            **_bits(0x92, MODES, 1 << robot.mode),
            **self._bits,
        }

    @staticmethod
    def _inputs() -> dict[int, int]:
        return {**_bits(0, 16, 0xFFFF), **_bits(0x20, 2, 0)}

    def _holding(self) -> dict[int, int]:
        robot = self._controller
        analog = dict(enumerate(robot.devices.analog_outputs, 3))
        return {
            0: robot.devices.outputs,
            2: robot.devices.tool_outputs,
            **analog,
            0x20: robot.mode,
            0x21: robot.state,
        } | (self._words)

    def _input_registers(self) -> dict[int, int]:
        robot = self._controller
        x, y, z, *angles = robot.pose()
        turned = [*angles, *robot.pose(axis_angle=True)[3:]]
        pose = [round(10 * value) for value in (x, y, z, *map(math.degrees, turned))]
        position, speed = (
            [round(10 * math.degrees(value)) for value in row]
            for row in (robot.plant.position_rad, robot.plant.velocity_rad_s)
        )
        return {
            0: 0xFFFF,
            2: 0,
            0x20: robot.error,
            0x21: robot.warning,
            **dict(enumerate(pose, 0x40)),
            **dict(enumerate(position, 0x59)),
            **dict(enumerate(speed, 0x67)),
        }

    # -- writing

    def _set_coil(self, address: int, value: int) -> None:
        robot, devices = self._controller, self._controller.devices
        if address < 16:
            devices.outputs = devices.outputs & ~(1 << address) | value << address
        elif address in _SWITCHES:
            robot.obey(_SWITCHES[address], bytes((value,)))
        elif address in self._bits:
            self._bits[address] = value
        else:
            raise _Refused(ILLEGAL_ADDRESS)

    def _set_word(self, address: int, value: int) -> None:
        robot, devices = self._controller, self._controller.devices
        if address == 0:
            devices.outputs = value
        elif address in (3, 4):
            devices.analog_outputs[address - 3] = value
        elif address == 0x20 and value < MODES:
            robot.set_mode(value)
        elif address == 0x21:
            robot.set_state(value)
        elif address in self._words:
            self._words[address] = value
        else:
            raise _Refused(ILLEGAL_ADDRESS)


def _bits(first: int, count: int, word: int) -> dict[int, int]:
    return {first + index: word >> index & 1 for index in range(count)}


def _read(registers: Mapping[int, int], first: int, count: int) -> list[int]:
    """Return registers. Raise ``_Refused`` if one of them is not there."""
    if not count or any(address not in registers for address in range(first, first + count)):
        raise _Refused(ILLEGAL_ADDRESS if count else ILLEGAL_DATA)
    return [registers[address] for address in range(first, first + count)]


__all__ = ["FUNCTIONS", "Modbus"]
