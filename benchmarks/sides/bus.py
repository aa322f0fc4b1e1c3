"""``bus WHO LENGTH ROBOT PORT``: read and write six servos as fast as possible.

WHO is one of ours, wire, sdk, lerobot, floor, loop (the floor in a trio loop).

The other end (``line``) delays every byte as 1 Mbaud does. All sides send the same requests: the positions of
all servos in one sync read, and the same goals in one sync write. ``wire`` is the full cycle of our robots:
it reads all values that a servo reports, decodes them into an observation, and writes with a permit.
"""

from __future__ import annotations

import gc
import json
import os
import sys
import time
from collections.abc import Awaitable, Callable, Iterator
from typing import Any

from .wire import percentile

SECONDS = {"short": 1.0, "long": 3.0}
BAUD = 1_000_000
BYTE_S = 10 / BAUD
MOTORS = tuple(range(1, 7))
GOAL = 2048

FEETECH, DYNAMIXEL = "so101", "koch"
LIMIT_HZ = {
    # sync read: 8 + n asked, n x (6 + 2) answered; sync write: 8 + n x 3
    FEETECH: 1 / (BYTE_S * ((8 + 6 + 6 * 8) + (8 + 6 * 3))),
    # fast sync read: 14 + n asked, 8 + n x (4 + 4) answered; sync write: 14 + n x 5
    DYNAMIXEL: 1 / (BYTE_S * ((14 + 6 + 8 + 6 * 8) + (14 + 6 * 5))),
}
"""Cycles per second if the bus were never silent. It follows from both protocols, with servos that answer
without delay."""

Cycle = Callable[[int], None]


def goal(number: int) -> int:
    return GOAL + number % 20


class Laps:
    """Yields the number of each cycle, for so many seconds. Then ``figures`` has the times of the cycles."""

    def __init__(self, seconds: float) -> None:
        self._seconds = seconds

    def __iter__(self) -> Iterator[int]:
        yield from range(50)  # warm-up, not counted
        took_us: list[float] = []
        used_s, began_s = time.process_time(), time.perf_counter()
        while time.perf_counter() - began_s < self._seconds:
            at_s = time.perf_counter()
            yield len(took_us)
            took_us.append((time.perf_counter() - at_s) * 1e6)
        elapsed_s = time.perf_counter() - began_s
        self.figures = figures(took_us, time.process_time() - used_s, elapsed_s)


def told(cycle: Cycle, seconds: float) -> dict[str, float]:
    """Repeat a cycle for so many seconds. Return cycles per second and processor time."""
    laps = Laps(seconds)
    for number in laps:
        cycle(number)
    return laps.figures


async def told_async(cycle: Callable[[int], Awaitable[None]], seconds: float) -> dict[str, float]:
    laps = Laps(seconds)
    for number in laps:
        await cycle(number)
    return laps.figures


def figures(took_us: list[float], used_s: float, elapsed_s: float) -> dict[str, float]:
    return {
        "cycles_hz": len(took_us) / elapsed_s,
        "cpu_us": 1e6 * used_s / len(took_us),
        "cpu_pct": 100 * used_s / elapsed_s,
        "cycle_p50_us": percentile(took_us, 0.5),
        "cycle_p99_us": percentile(took_us, 0.99),
    }


# -- vendors


def feetech_sdk(port: str, seconds: float) -> dict[str, float]:
    from scservo_sdk import COMM_SUCCESS, GroupSyncRead, GroupSyncWrite, PacketHandler, PortHandler

    line, packets = PortHandler(port), PacketHandler(0)
    line.openPort()
    line.setBaudRate(BAUD)
    for motor in MOTORS:
        packets.write1ByteTxRx(line, motor, 7, 0)  # answer without delay
        packets.write1ByteTxRx(line, motor, 40, 1)
    lost: list[int] = []
    reader, writer = GroupSyncRead(line, packets, 56, 2), GroupSyncWrite(line, packets, 42, 2)
    for motor in MOTORS:
        reader.addParam(motor)
        writer.addParam(motor, [0, 8])

    def cycle(number: int) -> None:
        if reader.txRxPacket() != COMM_SUCCESS:
            lost.append(number)
        for motor in MOTORS:
            reader.getData(motor, 56, 2)
        count = goal(number)
        for motor in MOTORS:
            writer.changeParam(motor, [count & 255, count >> 8])
        writer.txPacket()

    return _unless_lost(told(cycle, seconds), lost)


def dynamixel_sdk(port: str, seconds: float) -> dict[str, float]:
    from dynamixel_sdk import COMM_SUCCESS, GroupSyncRead, GroupSyncWrite, PacketHandler, PortHandler

    line, packets = PortHandler(port), PacketHandler(2.0)
    line.openPort()
    line.setBaudRate(BAUD)
    for motor in MOTORS:
        packets.write1ByteTxRx(line, motor, 9, 0)
        packets.write1ByteTxRx(line, motor, 64, 1)
    lost: list[int] = []
    reader, writer = GroupSyncRead(line, packets, 132, 4), GroupSyncWrite(line, packets, 116, 4)
    for motor in MOTORS:
        reader.addParam(motor)
        writer.addParam(motor, [0, 8, 0, 0])

    def cycle(number: int) -> None:
        if reader.fastSyncRead() != COMM_SUCCESS:
            lost.append(number)
            return
        for motor in MOTORS:
            reader.getData(motor, 132, 4)
        count = goal(number)
        for motor in MOTORS:
            writer.changeParam(motor, [count & 255, count >> 8, 0, 0])
        writer.txPacket()

    return _unless_lost(told(cycle, seconds), lost)


def _unless_lost(found: dict[str, float], lost: list[int]) -> dict[str, float]:
    """Raise ``RuntimeError`` if too many readings had no reply. A few are caused by a busy computer, but more
    mean that the setup is wrong."""
    if len(lost) > 0.02 * found["cycles_hz"]:
        raise RuntimeError(f"{len(lost)} readings were not answered")
    return found | {"lost": float(len(lost))}


def lerobot(port: str, robot: str, seconds: float) -> dict[str, float]:
    _without_torch()
    from lerobot.motors import Motor, MotorNormMode
    from lerobot.motors.feetech import FeetechMotorsBus

    names = {f"m{motor}": Motor(motor, "sts3215", MotorNormMode.RANGE_M100_100) for motor in MOTORS}
    bus = FeetechMotorsBus(port, names)
    bus.connect()
    bus.configure_motors()  # return delay 0, among others
    bus.enable_torque()
    lost: list[int] = []

    def cycle(number: int) -> None:
        try:
            bus.sync_read("Present_Position", normalize=False)
        except ConnectionError:
            lost.append(number)
            return
        bus.sync_write("Goal_Position", dict.fromkeys(names, goal(number)), normalize=False)

    return _unless_lost(told(cycle, seconds), lost)


def _without_torch() -> None:
    """Replace modules that lerobot's buses do not use, but that other modules of lerobot import."""
    import types

    for name in ("torch", "accelerate", "datasets", "datasets.utils", "datasets.utils.logging"):
        module = types.ModuleType(name)
        module.__getattr__ = lambda attribute: type(attribute, (), {})  # type: ignore[method-assign]
        sys.modules[name] = module


# -- the least work that is possible


def _made(robot: str) -> tuple[bytes, int, list[bytes]]:
    """Return a request, the number of bytes of its answer, and frames of goals, all made in advance."""
    if robot == FEETECH:
        from strands_actors.drivers.feetech import protocol as feetech

        frames = [feetech.goals(dict.fromkeys(MOTORS, goal(number))) for number in range(20)]
        return feetech.sync_read(MOTORS, 56, 2), 6 * 8, frames
    from strands_actors.drivers.common.dynamixel import protocol as dynamixel

    frames = [dynamixel.goals(dict.fromkeys(MOTORS, goal(number))) for number in range(20)]
    return dynamixel.fast_sync_read(MOTORS, 132, 4), 8 + 6 * 8, frames


def floor(robot: str, port: str, seconds: float) -> dict[str, float]:
    """Measure blocking reads that only count bytes: the limit of the terminal and the computer."""
    import termios

    import serial

    ask, answer_bytes, frames = _made(robot)
    device = serial.Serial(port, BAUD)
    fd = device.fileno()
    os.set_blocking(fd, True)
    attributes = termios.tcgetattr(fd)
    attributes[6][termios.VMIN] = 1  # wait for a byte
    termios.tcsetattr(fd, termios.TCSANOW, attributes)

    def cycle(number: int) -> None:
        os.write(fd, ask)
        missing = answer_bytes
        while missing > 0:
            missing -= len(os.read(fd, 4096))
        os.write(fd, frames[number % 20])

    return told(cycle, seconds)


def loop(robot: str, port: str, seconds: float) -> dict[str, float]:
    """Measure as ``floor`` does, in a trio loop, which could run other tasks meanwhile."""
    import serial
    import trio

    ask, answer_bytes, frames = _made(robot)
    device = serial.Serial(port, BAUD)
    fd = device.fileno()
    os.set_blocking(fd, False)

    async def cycle(number: int) -> None:
        os.write(fd, ask)
        missing = answer_bytes
        while missing > 0:
            await trio.lowlevel.wait_readable(fd)
            missing -= len(os.read(fd, 4096))
        os.write(fd, frames[number % 20])

    return trio.run(told_async, cycle, seconds)


# -- ours


def ours(robot: str, port: str, seconds: float, whole_wire: bool) -> dict[str, float]:
    import trio

    return trio.run(_ours, robot, port, seconds, whole_wire)


async def _ours(robot: str, port: str, seconds: float, whole_wire: bool) -> dict[str, float]:
    from strands_actors.drivers import get_native_driver_class
    from strands_actors.kernel.clock import MonotonicClock

    driver_class: Any = get_native_driver_class(robot)
    driver = driver_class(robot, port, driver_class.resolve(robot, {"baud": BAUD}))
    wire = driver.open_wire(MonotonicClock())
    await wire.open()
    await wire.arm(_Permit())
    gc.freeze()  # as the wire process does
    lost: list[int] = []
    cycle = _whole(wire, driver, lost) if whole_wire else _bus(wire, robot, lost)
    found = await told_async(cycle, seconds)
    wire.close()
    return _unless_lost(found, lost)


class _Permit:
    def check(self) -> None:
        """Do a comparison before each write, as the transport's permit does."""
        if time.monotonic_ns() < 0:
            raise RuntimeError


def _bus(wire: Any, robot: str, lost: list[int]) -> Callable[[int], Any]:
    codec, bus, ids = wire.CODEC, wire.session.bus, wire.driver.ids
    position, permit = codec.POSITION, _Permit()
    if robot == FEETECH:
        request, expected = codec.sync_read(ids, position.address, position.size), dict.fromkeys(ids, position.size)
    else:  # all answer in one frame; its first error byte and last checksum do not count as parameters
        request = codec.fast_sync_read(ids, position.address, position.size)
        expected = {codec.BROADCAST: len(ids) * (4 + position.size) - 3}

    async def cycle(number: int) -> None:
        replies = await bus.transact(request, expected, wait=True)
        if codec.BROADCAST in replies:
            replies = codec.fast_answers(replies[codec.BROADCAST], position.size)
        if len(replies) != len(ids):
            lost.append(number)
            return
        for reply in replies.values():
            position.decode(reply.params)
        frame = codec.goals(dict.fromkeys(ids, goal(number)))
        permit.check()
        bus.send(frame)

    return cycle


def _whole(wire: Any, driver: Any, lost: list[int]) -> Callable[[int], Any]:
    permit = _Permit()

    async def cycle(number: int) -> None:
        observation = await wire.read()
        if observation.faults:
            lost.append(number)
        await wire.write(tuple(axis.value(goal(number)) for axis in driver.joints), permit)

    return cycle


def main(who: str, length: str, robot: str, port: str) -> None:
    seconds = SECONDS[length]
    match who:
        case "ours" | "wire":
            found = ours(robot, port, seconds, who == "wire")
        case "floor":
            found = floor(robot, port, seconds)
        case "loop":
            found = loop(robot, port, seconds)
        case "sdk" if robot == FEETECH:
            found = feetech_sdk(port, seconds)
        case "sdk":
            found = dynamixel_sdk(port, seconds)
        case _:
            found = lerobot(port, robot, seconds)
    found["of_limit_x"] = found["cycles_hz"] / LIMIT_HZ[robot]
    print(json.dumps(found), flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
