"""Test the gripper, the tool's board, and the inputs and outputs at the twin's controller."""

from __future__ import annotations

import struct

import pytest

from strands_actors.drivers.xarm import protocol as p
from strands_actors.drivers.xarm.protocol import INVALID, Mode, Register
from strands_actors.drivers.xarm.twin.devices import GRIPPER, TOOL_BOARD, Devices, Gripper
from strands_actors.drivers.xarm.twin.registers import ANSWER_SIZE, Other

from .requests import tool
from .test_twin import World


def modbus(world: World, function: int, address: int, count: int, values: bytes = b"") -> bytes:
    body = struct.pack(">BHH", function, address, count) + (bytes((len(values),)) + values if values else b"")
    flags, data = world.controller.obey(Register.TOOL_RS485, bytes((TOOL_BOARD, GRIPPER)) + body)
    assert not flags & INVALID
    return data


def position(world: World) -> int:
    return int.from_bytes(modbus(world, 3, Gripper.POSITION, 2)[4:], "big", signed=True)


def invalid(world: World, register: int, data: bytes) -> bool:
    flags, answer = world.controller.obey(register, data)
    return bool(flags & INVALID) and answer == bytes(ANSWER_SIZE)


def test_the_gripper_moves_with_its_speed_when_it_is_enabled() -> None:
    world = World()
    assert position(world) == 850
    modbus(world, 16, Gripper.TARGET, 2, struct.pack(">i", 350))
    world.run(0.5)
    assert position(world) == 850, "it has no power"
    modbus(world, 16, Gripper.ENABLE, 1, b"\0\1")
    modbus(world, 16, Gripper.SPEED, 1, struct.pack(">H", 1000))
    assert modbus(world, 16, Gripper.TARGET, 2, struct.pack(">i", 350)) == bytes((9, 8, 16)) + b"\7\0\0\2"
    world.run(1.0)
    assert position(world) == pytest.approx(650, abs=5)
    assert modbus(world, 3, Gripper.STATUS, 1)[4:] == b"\0\1", "it moves"
    world.run(2.0)
    assert position(world) == 350 and modbus(world, 3, Gripper.STATUS, 1)[4:] == b"\0\0"


def test_a_target_past_its_range_is_an_error_until_it_is_cleared() -> None:
    world = World()
    modbus(world, 16, Gripper.ENABLE, 1, b"\0\1")
    modbus(world, 16, Gripper.TARGET, 2, struct.pack(">i", -50))
    assert world.controller.obey(Other.TOOL_ERRORS, b"") == (0x10, b"\x19\0")
    world.run(1.0)
    assert position(world) == 850
    modbus(world, 16, Gripper.RESET, 1, b"\0\1")
    modbus(world, 16, Gripper.TARGET, 2, struct.pack(">i", -10))
    world.run(5.0)
    assert position(world) == -10


@pytest.mark.parametrize(
    ("function", "address", "count", "exception"), [(3, 0x0999, 1, 2), (4, 0x0702, 1, 1), (16, 0x0101, 1, 1)]
)
def test_what_the_gripper_has_not_is_its_modbus_exception(
    function: int, address: int, count: int, exception: int
) -> None:
    answer = modbus(World(), function, address, count)
    assert answer == bytes((TOOL_BOARD, GRIPPER, function | 0x80, exception))


def test_the_gripper_hears_nothing_at_another_baud_rate() -> None:
    world = World()
    assert world.controller.obey(Register.TOOL_READ_16, tool(TOOL_BOARD, Devices.BAUD))[1] == struct.pack(">i", 11)
    world.say(Register.TOOL_WRITE_16, tool(TOOL_BOARD, Devices.SET_BAUD, 5.0))
    assert invalid(world, Other.TOOL_READ_32, tool(GRIPPER, Gripper.POSITION))
    world.say(Register.TOOL_WRITE_16, tool(TOOL_BOARD, Devices.SET_BAUD, 11.0))
    assert world.controller.obey(Other.TOOL_READ_32, tool(GRIPPER, Gripper.POSITION))[1] == struct.pack(">i", 850)


@pytest.mark.parametrize(
    ("register", "data"),
    [
        (Register.TOOL_RS485, bytes((11, 1, 3, 0, 0, 0, 1))),  # a linear motor at the control box
        (Register.TOOL_RS485, bytes((9, 1, 3, 0, 0, 0, 1))),  # another gripper
        (Register.TOOL_RS485, b"\x09\x08"),
        (Register.TOOL_READ_16, tool(11, Devices.BAUD)),
        (Register.TOOL_READ_16, tool(TOOL_BOARD, 0x0333)),
        (Register.TOOL_READ_16, b"\x09"),
        (Register.TOOL_WRITE_16, tool(TOOL_BOARD, 0x0333, 1.0)),
        (Register.TOOL_WRITE_16, tool(TOOL_BOARD, Devices.SET_BAUD, 77.0)),
        (Register.TOOL_WRITE_16, tool(TOOL_BOARD, Devices.SET_DIGITAL, float("nan"))),
        (Other.IO_DIGITAL_OUTPUTS, b"\1"),
        (Other.IO_INPUT_FUNCTION, b"\x10\1"),
        (Other.IO_OUTPUT_FUNCTION, b"\1"),
    ],
)
def test_what_is_not_there_is_invalid(register: int, data: bytes) -> None:
    assert invalid(World(), register, data)


def test_outputs_of_the_tool_are_set_by_their_mask() -> None:
    world = World()
    for value in (0x0101, 0x0202, 0x0100):
        world.say(Register.TOOL_WRITE_16, tool(TOOL_BOARD, Devices.SET_DIGITAL, float(value)))
    answer = world.controller.obey(Register.TOOL_READ_16, tool(TOOL_BOARD, Devices.DIGITAL_OUTPUTS))[1]
    assert answer == struct.pack(">i", 2)


def words(world: World) -> tuple[int, ...]:
    return struct.unpack_from(">8H", world.controller.obey(Other.IO_STATE, b"")[1], 2)


def test_outputs_of_the_box_are_set_by_their_mask_and_read_back() -> None:
    world = World()
    world.say(Other.IO_DIGITAL_OUTPUTS, struct.pack(">H", 0x0808))
    world.say(Other.IO_DIGITAL_OUTPUTS, struct.pack(">HH", 0, 0x0202))
    world.say(Other.IO_ANALOG_OUTPUT_2, struct.pack(">H", 1474))
    world.say(Other.IO_OUTPUT_FUNCTION, b"\x09\x05")
    assert words(world)[3] == 0x0208 and words(world)[7] == 1474
    state = world.controller.obey(Other.IO_STATE, b"")[1]
    assert len(state) == 50 and state[-8 + 1] == 5
    assert world.controller.obey(Other.IO_DIGITAL_INPUTS, b"")[1] == b"\xff\xff"
    assert world.controller.obey(Other.IO_ANALOG_INPUT_1, b"")[1] == b"\0\0"


def test_an_output_waits_for_the_motions_before_it_unless_it_need_not() -> None:
    world = World()
    world.arm(Mode.POSITION)
    world.say(Register.MOVE_JOINT, p.floats((0.3, *world.home[1:], 1.0, 20.0, 0.0)))
    world.say(Other.IO_DIGITAL_OUTPUTS, struct.pack(">H", 0x0101))
    world.say(Other.IO_DIGITAL_OUTPUTS, struct.pack(">H", 0x0202) + b"\0")
    world.run(0.1)
    assert words(world)[3] == 2, "the one that need not wait"
    world.run(1.0)
    assert words(world)[3] == 3 and world.position[0] == pytest.approx(0.3, abs=2e-3)


def test_a_stop_deletes_an_output_that_waits() -> None:
    world = World()
    world.arm(Mode.POSITION)
    world.say(Register.MOVE_JOINT, p.floats((0.3, *world.home[1:], 1.0, 20.0, 0.0)))
    world.say(Other.IO_DIGITAL_OUTPUTS, struct.pack(">H", 0x0101))
    world.say(Register.SET_STATE, b"\x04")
    world.run(1.0)
    assert words(world)[3] == 0


def test_the_counter_is_increased_and_reset() -> None:
    world = World()
    for _ in range(3):
        world.say(Other.COUNTER_PLUS)
    assert world.controller.count == 3
    world.say(Other.COUNTER_RESET)
    assert world.controller.count == 0
