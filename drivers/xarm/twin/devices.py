"""The devices at the simulated controller: the gripper, the tool's board, and the control box's inputs and outputs.

Nothing is connected to the inputs. An open digital input of the control box reads 1 [assumed], every other input 0.
"""

from __future__ import annotations

import struct
from collections.abc import Callable

from strands_actors.drivers.common.codecs.malformed import MalformedFrame
from strands_actors.drivers.common.physics.hand_motion import HandMotion
from strands_actors.drivers.xarm import protocol as p
from strands_actors.drivers.xarm.protocol import Register

from .registers import Other

TOOL_BOARD, GRIPPER = 9, 8
"""Numbers of the tool's board and of the gripper on the tool's bus."""

BAUD_2M = 11
"""Index of the gripper's baud rate, 2,000,000, in the vendor's list. The gripper answers at no other one."""

INPUTS = 16


class Gripper:
    """A simulated xArm gripper. Its position is in pulses: 0 is closed, and 850 open."""

    STATUS, ERROR, ENABLE, MODE, RESET, SPEED = 0x0000, 0x000F, 0x0100, 0x0101, 0x0109, 0x0303
    TARGET, POSITION, VERSION = 0x0700, 0x0702, 0x0801

    LOWEST, HIGHEST, FASTEST = -10, 850, 5000
    OVER_LIMIT = 25
    PULSES_OF_SPEED = 0.2
    """Pulses a second at a speed of 1 [assumed]."""

    MOVING, GRASPED = 1, 2
    """Values of the status; 0 at rest."""

    def __init__(self, motion: HandMotion | None = None) -> None:
        self.enabled = False
        self.motion = motion or HandMotion(most=1.0 - self.LOWEST / self.HIGHEST)
        self.error = self.mode = 0
        self.speed = 1500
        self.target = self.HIGHEST
        self.lost = False  # True while nothing on the bus gets an answer of the gripper

    @property
    def position(self) -> float:
        return self.HIGHEST * (1.0 - self.motion.closed)

    def tick(self, elapsed_s: float) -> None:
        self.motion.stuck = bool(self.error)
        self.motion.advance(elapsed_s, self.speed * self.PULSES_OF_SPEED / self.HIGHEST)

    def fail(self, error: int) -> None:
        """Set an error: the motor stops. The fingers keep their grip [assumed]. The code 0 removes the error."""
        if error:
            self.motion.halt()
        self.error = error

    @property
    def status(self) -> int:
        return self.GRASPED if self.motion.holds else int(self.motion.moves)

    def read(self, address: int) -> int:
        """Return a number of 16 or 32 bits. Raise ``MalformedFrame`` for an unknown address."""
        match address:
            case self.STATUS:
                return self.status
            case self.ERROR:
                return self.error
            case self.ENABLE:
                return int(self.enabled)
            case self.MODE:
                return self.mode
            case self.SPEED:
                return self.speed
            case self.TARGET:
                return self.target
            case self.POSITION:
                return round(self.position)
            case _ if self.VERSION <= address < self.VERSION + 3:
                return (3, 4, 3)[address - self.VERSION]
        raise MalformedFrame(f"the gripper has no register {address:#06x}")

    def write(self, address: int, value: int) -> None:
        """Write a number. Raise ``MalformedFrame`` for an unknown address, or for a value that is not possible."""
        match address:
            case self.ENABLE if value in (0, 1):
                # A gripper that gets power, or loses it, holds its position.
                if self.enabled != bool(value):
                    self.motion.halt()
                self.enabled, self.target = bool(value), round(self.position)
            case self.MODE if value == 0:
                self.mode = value
            case self.SPEED if value >= 0:
                self.speed = min(value, self.FASTEST)
            case self.TARGET if self.LOWEST <= value <= self.HIGHEST:
                self.target = value
                if self.enabled and not self.error:
                    self.motion.move_to(1.0 - value / self.HIGHEST)
            case self.TARGET:
                self.fail(self.OVER_LIMIT)
            case self.RESET:
                self.error = 0
            case _:
                raise MalformedFrame(f"register {address:#06x} of the gripper with {value}")


class Devices:
    """Answer the requests to all devices."""

    BAUD, SET_BAUD, REBOOT, VERSION = 0x0A0B, 0x1A0B, 0x0607, 0x0801
    DIGITAL_INPUTS, SET_DIGITAL, ANALOG_INPUTS, DIGITAL_OUTPUTS = (0x0A14, 0x0A12), 0x0A15, (0x0A16, 0x0A17), 0x0A18

    def __init__(self, defer: Callable[[Callable[[], None]], None], motion: HandMotion | None = None) -> None:
        """Args:
        defer: Runs a function when the motions that are queued now have ended.
        motion: The motion of the gripper's fingers; None for fingers without physics.
        """
        self._defer = defer
        self.gripper = Gripper(motion)
        self.has_picked = False  # what the vacuum gripper's sensor shows, on the first input of the tool
        self.tool_outputs = 0
        self.baud = BAUD_2M
        self.outputs = 0
        self.analog_outputs = [0, 0]
        self.functions = {Other.IO_INPUT_FUNCTION: [0] * INPUTS, Other.IO_OUTPUT_FUNCTION: [0] * INPUTS}

    def tick(self, elapsed_s: float) -> None:
        self.gripper.tick(elapsed_s)

    def put_object(self, closed: float | None) -> None:
        """Put an object between the fingers, which meet it at this share of their travel. None: take it away."""
        self.gripper.motion.object_at = closed
        self.has_picked = closed is not None

    def obey(self, register: int, data: bytes) -> bytes:
        """Carry out a request, and return the data of the reply. Raise ``MalformedFrame`` or ``IndexError`` if the
        request is invalid."""
        match register:
            case Register.TOOL_RS485:
                return self._rs485(data)
            case Other.TOOL_ERRORS:
                return bytes((self.gripper.error, 0))
            case Register.TOOL_WRITE_16 | Other.TOOL_WRITE_32:
                (value,) = p.unpack_floats(data, 1, 3)
                if not abs(value) < 2**31:
                    raise MalformedFrame(f"value {value}")
                self._write(data[0], int.from_bytes(data[1:3], "big"), int(value), data[7:8] == b"\0")
            case Register.TOOL_READ_16 | Other.TOOL_READ_32 if len(data) >= 3:
                return struct.pack(">i", self._read(data[0], int.from_bytes(data[1:3], "big")))
            case Other.IO_DIGITAL_INPUTS:
                return struct.pack(">H", _OPEN)
            case Other.IO_ANALOG_INPUT_1 | Other.IO_ANALOG_INPUT_2:
                return bytes(2)
            case Other.IO_DIGITAL_OUTPUTS if len(data) >= 2:
                self._set_outputs(data)
            case Other.IO_ANALOG_OUTPUT_1 | Other.IO_ANALOG_OUTPUT_2 if len(data) >= 2:
                self._set_analog(register - Other.IO_ANALOG_OUTPUT_1, int.from_bytes(data[:2], "big"), data[2:3])
            case Other.IO_INPUT_FUNCTION | Other.IO_OUTPUT_FUNCTION if data[0] < INPUTS:
                self.functions[Other(register)][data[0]] = data[1]
            case Other.IO_STATE:
                return self.state()
            case _:
                raise MalformedFrame(f"register {register} with {data.hex()}")
        return b""

    def state(self) -> bytes:
        """Return the state of the control box's inputs and outputs, as register 139 and the rich reports have it.

        These are state, error, eight words, and the functions of the first eight and the last eight inputs and
        outputs. The words are: inputs with a fixed function, inputs, outputs with a fixed function, outputs, then
        the analog inputs and outputs.
        """
        words = (0, _OPEN, 0, self.outputs, 0, 0, *self.analog_outputs)
        inputs, outputs = self.functions.values()
        return bytes(2) + struct.pack(">8H", *words) + bytes((*inputs[:8], *outputs[:8], *inputs[8:], *outputs[8:]))

    # -- outputs

    def _set_outputs(self, data: bytes) -> None:
        """Set digital outputs: a mask and values for the first eight, then for the last eight."""
        words = struct.unpack_from(f">{min(len(data) // 2, 2)}H", data)
        mask = sum((word >> 8) << 8 * index for index, word in enumerate(words))
        values = sum((word & 0xFF) << 8 * index for index, word in enumerate(words))

        def act() -> None:
            self.outputs = self.outputs & ~mask | values & mask

        self._in_turn(act, data[2 * len(words) :] == b"\0")

    def _set_analog(self, index: int, value: int, sync: bytes) -> None:
        def act() -> None:
            self.analog_outputs[index] = value

        self._in_turn(act, sync == b"\0")

    def _in_turn(self, act: Callable[[], None], at_once: bool) -> None:
        """Set an output: at once, or when the queued motions have ended."""
        if at_once:
            act()
        else:
            self._defer(act)

    # -- the tool's board and bus

    def _write(self, device: int, address: int, value: int, at_once: bool) -> None:
        if device == GRIPPER:
            self._on_bus().write(address, value)
        elif device != TOOL_BOARD:
            raise MalformedFrame(f"no device {device}")
        elif address == self.SET_DIGITAL:
            mask, values = value >> 8 & 0xFF, value & 0xFF

            def act() -> None:
                self.tool_outputs = self.tool_outputs & ~mask | values & mask

            self._in_turn(act, at_once)
        elif address == self.SET_BAUD and 0 <= value <= 12:
            self.baud = value
        elif address == self.REBOOT:
            self.tool_outputs = 0
        else:
            raise MalformedFrame(f"register {address:#06x} of the tool's board with {value}")

    def _read(self, device: int, address: int) -> int:
        if device == GRIPPER:
            return self._on_bus().read(address)
        if device != TOOL_BOARD:
            raise MalformedFrame(f"no device {device}")
        if address == self.BAUD:
            return self.baud
        if address in self.DIGITAL_INPUTS:
            return int(self.has_picked and bool(self.tool_outputs & 1))
        if address in self.ANALOG_INPUTS:
            return 0
        if address == self.DIGITAL_OUTPUTS:
            return self.tool_outputs
        if self.VERSION <= address < self.VERSION + 3:
            return (2, 8, 12)[address - self.VERSION]
        raise MalformedFrame(f"the tool's board has no register {address:#06x}")

    def _on_bus(self) -> Gripper:
        if self.baud != BAUD_2M or self.gripper.lost:
            raise MalformedFrame("the gripper does not answer")
        return self.gripper

    def _rs485(self, data: bytes) -> bytes:
        """Answer a Modbus frame without its checksum. Its first byte is the bus, the second one the device."""
        if len(data) < 7 or data[0] != TOOL_BOARD or data[1] != GRIPPER:
            raise MalformedFrame("no such device")
        gripper = self._on_bus()
        function, address, count = struct.unpack_from(">BHH", data, 2)
        head = data[:3]
        try:
            if function == 3 and 1 <= count <= 2:
                value = gripper.read(address)
                return head + bytes((2 * count,)) + value.to_bytes(2 * count, "big", signed=value < 0)
            if function == 16 and 1 <= count <= 2 and len(data) == 8 + 2 * count == 8 + data[7]:
                gripper.write(address, int.from_bytes(data[8:], "big", signed=count == 2))
                return data[:7]
        except MalformedFrame:
            return data[:2] + bytes((function | 0x80, 2))
        return data[:2] + bytes((function | 0x80, 1))


_OPEN = (1 << INPUTS) - 1
