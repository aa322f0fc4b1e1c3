"""Walk all messages of the radio protocol on the simulated firmware."""

from __future__ import annotations

import struct
from collections.abc import Iterator

from strands_actors.drivers.crazyflie import protocol as p
from strands_actors.drivers.crazyflie.protocol import HighLevel, Port, Setpoint
from strands_actors.drivers.crazyflie.robots import TABLES
from strands_actors.drivers.crazyflie.twin import packets
from strands_actors.drivers.crazyflie.twin.firmware import ADDRESS, Firmware
from strands_actors.drivers.crazyflie.twin.log_port import CONTROLS, Control
from strands_actors.drivers.crazyflie.twin.memories import MEMORIES
from strands_actors.drivers.crazyflie.twin.packets import LOCALIZATIONS, ORDERS, PACKETS, SETPOINTS, key_of
from strands_actors.drivers.crazyflie.twin.parameter_port import COMMANDS, Command
from strands_actors.drivers.crazyflie.twin.tables import PARAMETERS
from strands_actors.drivers.crazyflie.twin.trajectories import PIECE
from tests.drivers.modelled.walk import Answer, Walk

READY_STEPS = 50
"""Steps after which the supervisor has seen that the drone is armed."""


def still() -> float:
    return 100.0


def firmware() -> Firmware:
    return Firmware(TABLES.table("crazyflie"), still)


def armed() -> Firmware:
    twin = firmware()
    twin.receive(p.ARM)
    for _ in range(READY_STEPS):
        twin.step()
    return twin


def ask_packet(twin: Firmware, key: str, data: bytes) -> Answer:
    port, channel = map(int, key.split("."))
    reaction = twin.receive(p.encode(port, channel, data))
    return Answer(reaction.kind not in ("other", "garbled"), b"".join(reaction.replies))


def ask_setpoint(twin: Firmware, kind: int, data: bytes) -> Answer:
    return ask_packet(twin, key_of(Port.SETPOINT, 0), bytes((kind,)) + data)


def ask_order(twin: Firmware, kind: int, data: bytes) -> Answer:
    (reply,) = twin.receive(p.encode(Port.HIGH_LEVEL, 0, bytes((kind,)) + data)).replies
    return Answer(reply[-1] == 0)


def ask_localization(twin: Firmware, kind: int, data: bytes) -> Answer:
    return ask_packet(twin, key_of(Port.LOCALIZATION, 1), bytes((kind,)) + data)


def ask_parameters(twin: Firmware, command: int, data: bytes) -> Answer:
    return ask_packet(twin, key_of(Port.PARAMETERS, 3), bytes((command,)) + data)


def ask_log(twin: Firmware, command: int, data: bytes) -> Answer:
    (reply,) = twin.receive(p.encode(Port.LOG, 1, bytes((command,)) + data)).replies
    return Answer(reply[-1] == 0)


def ask_memory(twin: Firmware, kind: int, data: bytes) -> Answer:
    """Read the first bytes of the memory of a type. Without such a memory, read the number after the last."""
    numbers = range(len(twin.memories))
    number = next((one for one in numbers if twin.memories.describe(one)[0] == kind), len(numbers))
    replies = twin.receive(p.encode(Port.MEMORY, 1, struct.pack("<BIB", number, 0, 8))).replies
    return Answer(bool(replies) and replies[0][6] == 0, b"".join(replies)[7:])


def hover(twin: Firmware) -> None:
    twin.receive(p.hover(0.1, 0.0, 0.0, 0.5))


def take_off(twin: Firmware) -> None:
    ask_order(twin, HighLevel.TAKEOFF, TAKEOFF)


def define(twin: Firmware) -> None:
    """Upload a trajectory of one second."""
    twin.memories.trajectories[: PIECE.size] = PIECE.pack(*[0.0] * 32, 1.0)
    ask_order(twin, HighLevel.DEFINE_TRAJECTORY, DEFINITION)


def store(twin: Firmware) -> None:
    ask_parameters(twin, Command.STORE, b"\0\0")


def create(twin: Firmware) -> None:
    ask_log(twin, Control.CREATE, VARIABLE)


def start(twin: Firmware) -> None:
    create(twin)
    ask_log(twin, Control.START, b"\1\5")


TAKEOFF = struct.pack("<Bff?f", 0, 0.5, 0.0, False, 2.0)
DEFINITION = struct.pack("<BBBIB", 1, 1, 0, 0, 1)
VARIABLE = b"\1\7\0\0"
WRITABLE = next(number for number, each in enumerate(PARAMETERS) if each.full == "stabilizer.controller")
NAMED = b"stabilizer\0controller\0\x08\2"

PACKET_DATA = {
    key_of(Port.PARAMETERS, 0): b"\3",
    key_of(Port.PARAMETERS, 1): b"\0\0",
    key_of(Port.PARAMETERS, 2): struct.pack("<HB", WRITABLE, 2),
    key_of(Port.PARAMETERS, 3): b"\6\0\0",
    key_of(Port.RPYT, 0): struct.pack("<fffH", 0.0, 0.0, 0.0, 40000),
    key_of(Port.MEMORY, 0): b"\1",
    key_of(Port.MEMORY, 1): bytes(5) + b"\1",
    key_of(Port.MEMORY, 2): bytes(6),
    key_of(Port.LOG, 0): b"\3",
    key_of(Port.LOG, 1): b"\6\1\7\0\0",
    key_of(Port.LOCALIZATION, 0): struct.pack("<fff", 1.0, 2.0, 3.0),
    key_of(Port.LOCALIZATION, 1): b"\3",
    key_of(Port.LOCALIZATION, 2): struct.pack("<B3h", ADDRESS, 1000, 2000, 3000),
    key_of(Port.SETPOINT, 0): b"\0",
    key_of(Port.SETPOINT, 1): b"\0",
    key_of(Port.HIGH_LEVEL, 0): bytes((HighLevel.TAKEOFF,)) + TAKEOFF,
    key_of(Port.SUPERVISOR, 0): b"\x0c",
    key_of(Port.SUPERVISOR, 1): b"\1\0",
    key_of(Port.PLATFORM, 0): b"\1\0",
    key_of(Port.PLATFORM, 1): b"\0",
    key_of(Port.LINK, 0): b"x",
    key_of(Port.LINK, 1): b"\0",
    key_of(Port.LINK, 3): b"",
}
FOUR = struct.pack("<4f", 0.1, 0.0, 0.0, 0.5)
SETPOINT_DATA = {
    **dict.fromkeys(SETPOINTS.effects, FOUR),
    Setpoint.STOP: b"",
    Setpoint.FULL_STATE: struct.pack("<9hI3h", 100, 0, 500, *[0] * 6, 3 << 30, 0, 0, 0),
    Setpoint.MANUAL: struct.pack("<fffH?", 0.0, 0.0, 0.0, 40000, False),
}
ORDER_DATA = {
    HighLevel.SET_GROUP_MASK: b"\1",
    HighLevel.OLD_TAKEOFF: struct.pack("<Bff", 0, 0.5, 2.0),
    HighLevel.OLD_LAND: struct.pack("<Bff", 0, 0.0, 2.0),
    HighLevel.STOP: b"\0",
    HighLevel.GO_TO: struct.pack("<B?5f", 0, False, 0.5, 0.0, 0.5, 0.0, 2.0),
    HighLevel.START_TRAJECTORY: struct.pack("<B??Bf", 0, False, False, 1, 1.0),
    HighLevel.DEFINE_TRAJECTORY: DEFINITION,
    HighLevel.TAKEOFF: TAKEOFF,
    HighLevel.LAND: struct.pack("<Bff?f", 0, 0.0, 0.0, False, 2.0),
    HighLevel.TAKEOFF_WITH_VELOCITY: struct.pack("<Bf?f?f", 0, 0.5, False, 0.0, False, 0.2),
    HighLevel.LAND_WITH_VELOCITY: struct.pack("<Bf?f?f", 0, 0.0, False, 0.0, False, 0.2),
    HighLevel.SPIRAL: struct.pack("<B??5f", 0, False, False, 1.0, 0.5, 0.5, 0.0, 2.0),
    HighLevel.GO_TO_2: struct.pack("<B??5f", 0, False, False, 0.5, 0.0, 0.5, 0.0, 2.0),
    HighLevel.START_TRAJECTORY_2: struct.pack("<B???Bf", 0, False, False, False, 1, 1.0),
}
LOCALIZATION_DATA = {
    packets.EMERGENCY_STOP: b"",
    packets.KEEP_ALIVE: b"",
    packets.EXTERNAL_POSES: struct.pack("<B3hI", ADDRESS, 1000, 2000, 3000, 3 << 30),
    packets.EXTERNAL_POSE: struct.pack("<7f", 1.0, 2.0, 3.0, 0.0, 0.0, 0.0, 1.0),
}
OTHERS = (b"", b"\0", b"\1\1", bytes(16), b"\x05" * 29)


def walks() -> Iterator[Walk]:
    """Yield a walk for each table of the simulated drone."""
    keys = [key_of(port, channel) for port in range(16) for channel in range(4)]
    hovers = {key_of(Port.SETPOINT, 0): hover, key_of(Port.SETPOINT, 1): hover}
    yield Walk("crazyflie", PACKETS, keys, armed, ask_packet, PACKET_DATA, OTHERS, hovers)
    yield Walk(
        "setpoints", SETPOINTS, range(256), armed, ask_setpoint, SETPOINT_DATA, OTHERS, {Setpoint.STOP: hover}
    )
    yield Walk(
        "orders",
        ORDERS,
        range(256),
        armed,
        ask_order,
        ORDER_DATA,
        OTHERS,
        {
            HighLevel.STOP: take_off,
            HighLevel.START_TRAJECTORY: define,
            HighLevel.START_TRAJECTORY_2: define,
        },
    )
    yield Walk(
        "localization", LOCALIZATIONS, range(256), armed, ask_localization, LOCALIZATION_DATA, (b"", bytes(28))
    )
    yield Walk(
        "parameters",
        COMMANDS,
        range(256),
        firmware,
        ask_parameters,
        {**dict.fromkeys(COMMANDS.effects, b"\0\0"), Command.SET_BY_NAME: NAMED},
        (b"\0\0", NAMED),
        {Command.CLEAR: store},
    )
    yield Walk(
        "log",
        CONTROLS,
        range(256),
        firmware,
        ask_log,
        {**dict.fromkeys(CONTROLS.effects, VARIABLE), Control.START: b"\1\5", Control.START_2: b"\1\5\0"},
        (b"", b"\1", VARIABLE),
        {
            Control.DELETE: create,
            Control.START: create,
            Control.STOP: start,
            Control.RESET: create,
            Control.APPEND: create,
            Control.START_2: create,
        },
    )
    yield Walk("memories", MEMORIES, range(256), firmware, ask_memory, dict.fromkeys(MEMORIES.effects, b""), (b"",))
