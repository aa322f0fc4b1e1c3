"""The handshake with a bus of servos: find all servos, and check that they are those of this robot and of
its calibration."""

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
    where: str,
    others: Collection[int] = (),
) -> None:
    """Ping each servo, then all at once.

    Args:
        bus: The bus.
        codec: Its protocol.
        robot: The name of the robot.
        axes: Its joints.
        where: The port, for messages.
        others: Ids of further servos that may be there.

    Raises:
        WireDown: Servos are missing, answer twice, or are foreign. The text names them.
    """
    heard: Counter[int] = Counter()
    garbled: set[int] = set()
    late_s = 0.0
    for axis in axes:
        answers = await _ping(bus, codec.ping(axis.id), PING_S, PING_SILENCE_S, axis.id)
        heard[axis.id] = sum(packet.id == axis.id for packet in answers)
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
        axis.label for motor, axis in expected.items() if motor in garbled or heard[motor] > 1 or present[motor] > 1
    ]
    missing = [axis.label for motor, axis in expected.items() if not heard[motor] and motor not in garbled]
    foreign = sorted(motor for motor in present if motor not in expected and motor not in others)
    if late_s > BUSY_S and (missing or twice or foreign):
        raise WireDown(too_busy(late_s, "the answers of the servos"))
    if len(missing) == len(axes):
        raise WireDown(f"no servo of {robot} answers on {where}. Check power, the bus cable, port= and baud=")
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
    """Return the answers to a ping. Ping again after a missing or damaged answer, and once more if this host
    was late."""
    tries = PINGS
    while True:
        answers: list[Packet] = await bus.listen(request, first_s, silence_s)
        tries -= 1
        clear = not bus.stray_bytes and any(packet.id == motor for packet in answers)
        if clear or tries < 0 or (tries == 0 and not bus.starved):
            return answers


def too_busy(late_s: float, what: str) -> str:
    return (
        f"this host was too busy to read {what}: it looked {late_s * 1e3:.0f} ms late. "
        "End what else computes on it, then try again"
    )


def check_model(axis: Axis, servo_id: int, model: int, codec: Codec[Packet]) -> None:
    """Raise ``WireDown`` unless the servo has the model and the id of the table."""
    number = next((number for number, name in codec.MODEL_NUMBERS.items() if name == axis.model), None)
    if number is not None and model != number:
        name = codec.MODEL_NUMBERS.get(model, f"model {model}")
        raise WireDown(f"{axis.label} is a {name}, must be {axis.model}. Check which robot is on this port")
    if servo_id != axis.id:
        raise WireDown(f"{axis.label} says its id is {servo_id}. Set its id again")


def check_calibration(axis: Axis, motor: MotorCalibration, found: dict[str, int]) -> None:
    """Raise ``WireDown`` unless the servo is the one that was calibrated. ``found`` has its values, by field
    of the file."""
    for field, value in found.items():
        filed = getattr(motor, field)
        if filed != value:
            raise WireDown(
                f"calibration says {field} {filed} for {axis.key}, servo {axis.id} has {value}. "
                "Use the file of this robot, or calibrate it again"
            )


async def ask(bus: HalfDuplexBus[PacketT], request: bytes, expected: Mapping[int, int]) -> dict[int, PacketT]:
    """Return the replies to a read. Repeat it once if a reply is missing and this host, not a servo, may be
    the reason."""
    replies = await bus.transact(request, expected, ANSWER_S, wait=True)
    if bus.starved and len(replies) + len(bus.refusals) < len(expected):
        replies = await bus.transact(request, expected, ANSWER_S, wait=True)
    return replies


async def block(bus: HalfDuplexBus[PacketT], codec: Codec[PacketT], axis: Axis, address: int, size: int) -> bytes:
    """Return registers of one servo. Raise ``WireDown`` if it does not answer."""
    replies = await ask(bus, codec.read(axis.id, address, size), {axis.id: size})
    if axis.id not in replies:
        raise WireDown(_unanswered(bus, axis, f"a read of register {address}"))
    return replies[axis.id].params


async def command(bus: HalfDuplexBus[Any], axis: Axis, request: bytes, what: str) -> None:
    """Make one acknowledged write. ``what`` names it in a message. Raise ``WireDown``."""
    replies = await bus.transact(request, {axis.id: 0}, ANSWER_S, wait=True)
    if axis.id not in replies:
        raise WireDown(_unanswered(bus, axis, what))


def untold(bus: HalfDuplexBus[Any], who: str, what: str) -> str:
    """Return the message of a failed arming, in which servos did not report a value."""
    if bus.starved:
        return f"arm: {too_busy(bus.late_s, f'{what} of {who}')}"
    why = f" ({', '.join(bus.refusals.values())})" if bus.refusals else ""
    return f"arm: {who} does not tell {what}{why}. Check its cable and power"


def _unanswered(bus: HalfDuplexBus[Any], axis: Axis, what: str) -> str:
    if axis.id in bus.refusals:
        return f"{axis.label} refuses {what}: {bus.refusals[axis.id]}. Power-cycle it and try again"
    if bus.starved:
        return f"{too_busy(bus.late_s, f'the answer of {axis.label} to {what}')}"
    if bus.stray_bytes:
        return f"{axis.label} garbles its answer to {what}. Two servos with one id, or a bad cable?"
    return f"{axis.label} does not answer {what}. Check its cable and power"
