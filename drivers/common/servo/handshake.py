"""Find all servos on a bus, and check that they belong to this robot and to its calibration."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from typing import Any

from strands_actors.contract.wire import WireDown
from strands_actors.drivers.common.kit.calibration import MotorCalibration
from strands_actors.drivers.common.ports.half_duplex import BUSY_S, HalfDuplexBus, Packet, PacketT

from .axes import Axis
from .codec import Codec

PING_S = 0.15
"""Timeout of a ping. A servo answers within its return delay (0.5 ms); the rest is for the adapter and a busy
host. Only a missing servo costs this time, as with ``ANSWER_S``."""

PINGS = 2
"""Number of pings. A byte lost to noise must not look like a missing servo, nor a damaged one like two."""

PING_SILENCE_S = 0.004
ROLL_CALL_S = 0.05
ROLL_CALL_SLOT_S = 0.003
"""Slot of one id after a broadcast ping: servos answer one after the other, by id (assumed, after lerobot's
wait)."""

ANSWER_S = 0.25


async def roll_call(
    bus: HalfDuplexBus[Any],
    codec: Codec[Packet],
    robot: str,
    axes: Sequence[Axis],
    port_name: str,
    others: Collection[int] = (),
) -> None:
    """Ping each servo by its id, then all servos at once. Raise ``WireDown`` unless exactly the expected servos
    answer.

    Args:
        bus: The bus.
        codec: The protocol of the bus.
        robot: The name of the robot.
        axes: The joints, whose servos must answer.
        port_name: The name of the port, for messages.
        others: Ids of further servos that may answer.

    Raises:
        WireDown: Servos are missing, have the same id, or belong to another robot. The text names them.
    """
    answer_counts: Counter[int] = Counter()
    garbled: set[int] = set()
    late_s = 0.0
    for axis in axes:
        answers = await _ping(bus, codec.ping(axis.id), PING_S, PING_SILENCE_S, axis.id)
        answer_counts[axis.id] = sum(packet.id == axis.id for packet in answers)
        late_s = max(late_s, bus.late_s)
        if bus.stray_bytes:
            garbled.add(axis.id)
    slots_s = ROLL_CALL_SLOT_S * max(axis.id for axis in axes)
    everybody = await bus.listen(codec.ping(codec.BROADCAST), ROLL_CALL_S + slots_s, ROLL_CALL_S)
    if bus.starved:
        everybody = await bus.listen(codec.ping(codec.BROADCAST), ROLL_CALL_S + slots_s, ROLL_CALL_S)
    late_s = max(late_s, bus.late_s)
    present = Counter(packet.id for packet in everybody)

    expected = {axis.id: axis for axis in axes}
    twice = [
        axis.label
        for motor, axis in expected.items()
        if motor in garbled or answer_counts[motor] > 1 or present[motor] > 1
    ]
    missing = [axis.label for motor, axis in expected.items() if not answer_counts[motor] and motor not in garbled]
    foreign = sorted(motor for motor in present if motor not in expected and motor not in others)
    if late_s > BUSY_S and (missing or twice or foreign):
        raise WireDown(too_busy(late_s, "the answers of the servos"))
    if len(missing) == len(axes):
        raise WireDown(f"no servo of {robot} answers on {port_name}. Check power, the bus cable, port= and baud=")
    wrong = []
    if missing:
        wrong.append(f"{', '.join(missing)} does not answer")
    if twice:
        wrong.append(f"{', '.join(twice)} answers more than once or garbled: two servos with one id?")
    if foreign:
        wrong.append(f"{', '.join(f'id {motor}' for motor in foreign)} is not of {robot}")
    if wrong:
        ids = ", ".join(str(axis.id) for axis in axes)
        raise WireDown(f"{'; '.join(wrong)}. Check cables and ids; {robot} has ids {ids}")


async def _ping(
    bus: HalfDuplexBus[Any], request: bytes, first_s: float, silence_s: float, motor: int
) -> list[Packet]:
    """Return the answers to a ping. Repeat the ping after a missing or damaged answer, and once more if this
    computer was late."""
    tries = PINGS
    while True:
        answers: list[Packet] = await bus.listen(request, first_s, silence_s)
        tries -= 1
        clear = not bus.stray_bytes and any(packet.id == motor for packet in answers)
        if clear or tries < 0 or (tries == 0 and not bus.starved):
            return answers


def too_busy(late_s: float, subject: str) -> str:
    return (
        f"this host was too busy to read {subject}: it looked {late_s * 1e3:.0f} ms late. "
        "End what else computes on it, then try again"
    )


def check_model(axis: Axis, servo_id: int, model: int, codec: Codec[Packet]) -> None:
    """Raise ``WireDown`` unless the servo has the model and the id of the robot's table."""
    number = next((number for number, name in codec.MODEL_NUMBERS.items() if name == axis.model), None)
    if number is not None and model != number:
        name = codec.MODEL_NUMBERS.get(model, f"model {model}")
        raise WireDown(f"{axis.label} is a {name}, must be {axis.model}. Check which robot is on this port")
    if servo_id != axis.id:
        raise WireDown(f"{axis.label} reports the id {servo_id}. Set its id again")


def check_calibration(axis: Axis, motor: MotorCalibration, servo_values: dict[str, int]) -> None:
    """Raise ``WireDown`` unless the servo's registers have the values of the calibration. ``servo_values`` has the
    servo's values, by the field names of the calibration file."""
    for field, value in servo_values.items():
        filed = getattr(motor, field)
        if filed != value:
            raise WireDown(
                f"the calibration has {field} {filed} for {axis.key}, servo {axis.id} has {value}. "
                "Use the calibration file of this robot, or calibrate it again"
            )


async def ask(bus: HalfDuplexBus[PacketT], request: bytes, expected: Mapping[int, int]) -> dict[int, PacketT]:
    """Send a read request and return the replies. Repeat it once if a reply is missing because this computer was
    late."""
    replies = await bus.transact(request, expected, ANSWER_S, wait=True)
    if bus.starved and len(replies) + len(bus.refusals) < len(expected):
        replies = await bus.transact(request, expected, ANSWER_S, wait=True)
    return replies


async def block(bus: HalfDuplexBus[PacketT], codec: Codec[PacketT], axis: Axis, address: int, size: int) -> bytes:
    """Read a block of registers of one servo. Raise ``WireDown`` if the servo does not answer."""
    replies = await ask(bus, codec.read(axis.id, address, size), {axis.id: size})
    if axis.id not in replies:
        raise WireDown(_unanswered(bus, axis, f"a read of register {address}"))
    return replies[axis.id].params


async def command(bus: HalfDuplexBus[Any], axis: Axis, request: bytes, label: str) -> None:
    """Send a write request, and wait for its acknowledgement. Raise ``WireDown`` if it does not come.

    Args:
        bus: The bus.
        axis: The joint of the servo.
        request: The frame.
        label: The name of the write, for messages.
    """
    replies = await bus.transact(request, {axis.id: 0}, ANSWER_S, wait=True)
    if axis.id not in replies:
        raise WireDown(_unanswered(bus, axis, label))


def not_reported(bus: HalfDuplexBus[Any], servos: str, label: str) -> str:
    """Return the error message if servos did not report a value, so that the robot cannot be energised."""
    if bus.starved:
        return f"arming: {too_busy(bus.late_s, f'{label} of {servos}')}"
    detail = f" ({', '.join(bus.refusals.values())})" if bus.refusals else ""
    return f"arming: {servos} does not report {label}{detail}. Check its cable and power"


def _unanswered(bus: HalfDuplexBus[Any], axis: Axis, label: str) -> str:
    if axis.id in bus.refusals:
        return f"{axis.label} refuses {label}: {bus.refusals[axis.id]}. Power-cycle it and try again"
    if bus.starved:
        return f"{too_busy(bus.late_s, f'the answer of {axis.label} to {label}')}"
    if bus.stray_bytes:
        return f"{axis.label} garbles its answer to {label}. Two servos with one id, or a bad cable?"
    return f"{axis.label} does not answer {label}. Check its cable and power"
