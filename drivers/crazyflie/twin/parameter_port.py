"""Simulate the port for parameters: the table, values, and the commands for defaults and stored values.

A value that is stored survives that the drone is switched off. The parameters are those of ``tables``.

Source: the firmware's page ``crtp_parameters``.
"""

from __future__ import annotations

import enum
import struct
from collections.abc import Callable

from strands_actors.drivers.common.twin.modelled import Modelled
from strands_actors.drivers.crazyflie.protocol import Port, encode

from . import packets
from .packets import Reaction, answer
from .tables import EXTENDED, PARAMETERS, READ_ONLY, Parameter, checksum, packed

_TABLE, _READ, _WRITE, _COMMANDS = range(4)
_GET_ITEM, _GET_INFO = 2, 3
PERSISTENT = 1
"""Extended type of a parameter whose value can be stored."""


class Command(enum.IntEnum):
    SET_BY_NAME = 0
    VALUE_UPDATED = 1
    """Sent by the drone alone."""
    GET_EXTENDED_TYPE = 2
    STORE = 3
    GET_STATE = 4
    CLEAR = 5
    GET_DEFAULT = 6
    GET_EXTENDED_TYPE_2 = 7
    GET_DEFAULT_2 = 8


COMMANDS: Modelled[int] = Modelled(
    "parameter commands",
    {
        Command.SET_BY_NAME: "sets a parameter by its name; errors 2, 13 and 22",
        Command.GET_EXTENDED_TYPE: "returns whether the value can be stored",
        Command.STORE: "stores the present value",
        Command.GET_STATE: "returns the default, and the stored value if there is one",
        Command.CLEAR: "forgets the stored value",
        Command.GET_DEFAULT: "returns the default",
        Command.GET_EXTENDED_TYPE_2: "as 2, with a status",
        Command.GET_DEFAULT_2: "as 6, with a status",
    },
    "silence",
)


class ParameterPort:
    """The parameters and their values. ``values`` has each value by its full name."""

    def __init__(self, changed: Callable[[str], None]) -> None:
        """Make the port. ``changed`` is called with the full name after a client has written a value."""
        self._changed = changed
        self._stored: dict[str, float] = {}
        self.values: dict[str, float] = {}
        self.boot()

    def boot(self) -> None:
        """Give each parameter its stored value, or else its default."""
        self.values.clear()
        self.values.update({each.full: self._stored.get(each.full, each.value) for each in PARAMETERS})

    def updated(self, name: str) -> bytes:
        """Return the packet that reports a value that the drone has changed by itself."""
        number, parameter = next((place, each) for place, each in enumerate(PARAMETERS) if each.full == name)
        head = struct.pack("<BH", Command.VALUE_UPDATED, number)
        return encode(Port.PARAMETERS, _COMMANDS, head + packed(parameter.layout, self.values[name]))

    def receive(self, channel: int, data: bytes) -> Reaction:
        """Answer a packet. Raise ``struct.error`` and ``IndexError`` for a malformed one."""
        match channel:
            case 0:
                return self._describe(data)
            case 3:
                return self._command(data)
        number = struct.unpack("<H", data[:2])[0]
        if number >= len(PARAMETERS):
            return answer(Port.PARAMETERS, channel, data[:2] + bytes((packets.ENOENT,)))
        parameter = PARAMETERS[number]
        if channel == _READ:
            value = packed(parameter.layout, self.values[parameter.full])
            return answer(Port.PARAMETERS, _READ, data[:2] + b"\0" + value)
        if parameter.type_code & READ_ONLY:
            # The firmware does not answer.
            return Reaction("other")
        self._set(parameter, data[2:])
        return answer(Port.PARAMETERS, _WRITE, data)

    def _set(self, parameter: Parameter, data: bytes) -> None:
        self.values[parameter.full] = struct.unpack(parameter.layout, data)[0]
        self._changed(parameter.full)

    def _describe(self, data: bytes) -> Reaction:
        if data[0] == _GET_INFO:
            info = struct.pack("<BHI", _GET_INFO, len(PARAMETERS), checksum(PARAMETERS))
            return answer(Port.PARAMETERS, _TABLE, info)
        if data[0] != _GET_ITEM:
            return Reaction("other")
        number = struct.unpack("<H", data[1:3])[0]
        if number >= len(PARAMETERS):
            return answer(Port.PARAMETERS, _TABLE, data[:1])
        parameter = PARAMETERS[number]
        names = f"{parameter.group}\0{parameter.name}\0".encode()
        return answer(Port.PARAMETERS, _TABLE, data[:3] + bytes((parameter.type_code,)) + names)

    def _command(self, data: bytes) -> Reaction:
        if data[0] not in COMMANDS:
            return Reaction("other")
        if data[0] == Command.SET_BY_NAME:
            return self._set_by_name(data)
        number, missing = struct.unpack("<H", data[1:3])[0], bytes((packets.ENOENT,))
        if number >= len(PARAMETERS):
            return self._reply(data, missing)
        parameter = PARAMETERS[number]
        default = packed(parameter.layout, parameter.value)
        can_default, is_kept = not parameter.type_code & READ_ONLY, bool(parameter.type_code & EXTENDED)
        match data[0]:
            case Command.GET_EXTENDED_TYPE:
                return self._reply(data, bytes((PERSISTENT,)) if is_kept else missing)
            case Command.GET_EXTENDED_TYPE_2:
                return self._reply(data, bytes((0, PERSISTENT)) if is_kept else missing)
            case Command.GET_DEFAULT:
                return self._reply(data, default if can_default else missing)
            case Command.GET_DEFAULT_2:
                return self._reply(data, b"\0" + default if can_default else missing)
            case Command.GET_STATE:
                stored = self._stored.get(parameter.full)
                value = b"" if stored is None else packed(parameter.layout, stored)
                return self._reply(data, bytes((stored is not None,)) + default + value)
        return self._reply(data, bytes((self._keep(data[0], parameter),)))

    def _keep(self, command: int, parameter: Parameter) -> int:
        """Store a value, or forget it. Return an error number; 0 for success."""
        if command == Command.STORE:
            if not parameter.type_code & EXTENDED:
                return packets.ENOENT
            self._stored[parameter.full] = self.values[parameter.full]
            return 0
        return 0 if self._stored.pop(parameter.full, None) is not None else packets.ENOENT

    def _set_by_name(self, data: bytes) -> Reaction:
        group, name, rest = data[1:].split(b"\0", 2)
        head = data[: 1 + len(group) + 1 + len(name) + 1]
        return answer(Port.PARAMETERS, _COMMANDS, head + bytes((self._set_named(group + b"." + name, rest),)))

    def _set_named(self, full: bytes, rest: bytes) -> int:
        parameter = next((each for each in PARAMETERS if each.full.encode() == full), None)
        if parameter is None:
            return packets.ENOENT
        if rest[0] != parameter.type_code & 0x0F:
            return packets.EINVAL
        if parameter.type_code & READ_ONLY:
            return packets.EACCES
        self._set(parameter, rest[1:])
        return 0

    def _reply(self, data: bytes, result: bytes) -> Reaction:
        return answer(Port.PARAMETERS, _COMMANDS, data[:3] + result)


__all__ = ["COMMANDS", "Command", "ParameterPort"]
