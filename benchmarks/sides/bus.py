"""``bus PROGRAM LENGTH ROBOT PORT``: read and write six servos as fast as possible.

LENGTH is ``short`` or ``long`` (1 or 3 s). PORT is the port of the simulated servos.

PROGRAM is the program that is measured: ``ours`` (our driver's bus), ``wire`` (the full cycle of our robots),
``sdk`` (the vendor's SDK), ``lerobot``, ``floor`` (reads and writes of bytes only) or ``loop`` (the same in a
trio loop).

The simulated servos (``line``) delay every byte as a bus at 1 Mbaud does. All sides send the same requests: the
positions of all servos in one sync read, and the same goals in one sync write. ``wire`` reads all values that a
servo reports, decodes them into an observation, and checks before each write that it is still allowed.
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
    # Bytes for n servos. Sync read: a request of 8 + n, replies of n x (6 + 2). Sync write: 8 + n x 3.
    FEETECH: 1 / (BYTE_S * ((8 + 6 + 6 * 8) + (8 + 6 * 3))),
    # Bytes for n servos. Fast sync read: a request of 14 + n, a reply of 8 + n x (4 + 4). Sync write: 14 + n x 5.
    DYNAMIXEL: 1 / (BYTE_S * ((14 + 6 + 8 + 6 * 8) + (14 + 6 * 5))),
}
"""Cycles per second if the bus were never silent. It follows from both protocols, with servos that answer
without delay."""

Cycle = Callable[[int], None]


def goal(number: int) -> int:
    return GOAL + number % 20


class Laps:
    """Yield the number of each cycle, 0, 1, 2 and so on, for ``seconds``. Afterwards ``figures`` has the durations
    of the cycles.
    """

    def __init__(self, seconds: float) -> None:
        self._seconds = seconds

    def __iter__(self) -> Iterator[int]:
        # These cycles are a warm-up and are not measured.
        yield from range(50)
        took_us: list[float] = []
        used_s, began_s = time.process_time(), time.perf_counter()
        while time.perf_counter() - began_s < self._seconds:
            at_s = time.perf_counter()
            yield len(took_us)
            took_us.append((time.perf_counter() - at_s) * 1e6)
        elapsed_s = time.perf_counter() - began_s
        self.figures = figures(took_us, time.process_time() - used_s, elapsed_s)


def run_cycles(cycle: Cycle, seconds: float) -> dict[str, float]:
    """Repeat ``cycle`` for ``seconds``. Return the cycles per second and the processor time."""
    laps = Laps(seconds)
    for number in laps:
        cycle(number)
    return laps.figures


async def run_cycles_async(cycle: Callable[[int], Awaitable[None]], seconds: float) -> dict[str, float]:
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
        packets.write1ByteTxRx(line, motor, 7, 0)  # return delay 0
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

    return _unless_lost(run_cycles(cycle, seconds), lost)


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

    return _unless_lost(run_cycles(cycle, seconds), lost)


def _unless_lost(result: dict[str, float], lost: list[int]) -> dict[str, float]:
    """Raise ``RuntimeError`` if too many reads had no reply. A busy computer causes a few; more mean that the setup
    is wrong.
    """
    if len(lost) > 0.02 * result["cycles_hz"]:
        raise RuntimeError(f"{len(lost)} reads got no reply, which is too many. Check the port and the baud rate")
    return result | {"lost": float(len(lost))}


def lerobot(port: str, robot: str, seconds: float) -> dict[str, float]:
    _without_torch()
    from lerobot.motors import Motor, MotorNormMode
    from lerobot.motors.feetech import FeetechMotorsBus

    names = {f"m{motor}": Motor(motor, "sts3215", MotorNormMode.RANGE_M100_100) for motor in MOTORS}
    bus = FeetechMotorsBus(port, names)
    bus.connect()
    # This also sets the servos' return delay to 0.
    bus.configure_motors()
    bus.enable_torque()
    lost: list[int] = []

    def cycle(number: int) -> None:
        try:
            bus.sync_read("Present_Position", normalize=False)
        except ConnectionError:
            lost.append(number)
            return
        bus.sync_write("Goal_Position", dict.fromkeys(names, goal(number)), normalize=False)

    return _unless_lost(run_cycles(cycle, seconds), lost)


def _without_torch() -> None:
    """Replace modules that lerobot's buses do not use, but that other modules of lerobot import."""
    import types

    for name in ("torch", "accelerate", "datasets", "datasets.utils", "datasets.utils.logging"):
        module = types.ModuleType(name)
        module.__getattr__ = lambda attribute: type(attribute, (), {})  # type: ignore[method-assign]
        sys.modules[name] = module


# -- programs that do only the least necessary work


def _made(robot: str) -> tuple[bytes, int, list[bytes]]:
    """Return a read request, the number of bytes in its reply, and encoded messages that write target angles."""
    if robot == FEETECH:
        from strands_actors.drivers.feetech import protocol as feetech

        frames = [feetech.goals(dict.fromkeys(MOTORS, goal(number))) for number in range(20)]
        return feetech.sync_read(MOTORS, 56, 2), 6 * 8, frames
    from strands_actors.drivers.common.dynamixel import protocol as dynamixel

    frames = [dynamixel.goals(dict.fromkeys(MOTORS, goal(number))) for number in range(20)]
    return dynamixel.fast_sync_read(MOTORS, 132, 4), 8 + 6 * 8, frames


def floor(robot: str, port: str, seconds: float) -> dict[str, float]:
    """Measure blocking reads that only count bytes. No program can be faster with this pseudo-terminal on this
    computer.
    """
    import termios

    import serial

    ask, answer_bytes, frames = _made(robot)
    device = serial.Serial(port, BAUD)
    fd = device.fileno()
    os.set_blocking(fd, True)
    attributes = termios.tcgetattr(fd)
    attributes[6][termios.VMIN] = 1  # a read waits for at least one byte
    termios.tcsetattr(fd, termios.TCSANOW, attributes)

    def cycle(number: int) -> None:
        os.write(fd, ask)
        missing = answer_bytes
        while missing > 0:
            missing -= len(os.read(fd, 4096))
        os.write(fd, frames[number % 20])

    return run_cycles(cycle, seconds)


def loop(robot: str, port: str, seconds: float) -> dict[str, float]:
    """Measure the reads and writes of ``floor`` in a trio loop, which could run other tasks while it waits."""
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

    return trio.run(run_cycles_async, cycle, seconds)


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
    # As in the process that talks to a real robot: the garbage collector leaves the present objects out.
    gc.freeze()
    lost: list[int] = []
    cycle = _whole(wire, driver, lost) if whole_wire else _bus(wire, robot, lost)
    result = await run_cycles_async(cycle, seconds)
    wire.close()
    return _unless_lost(result, lost)


class _Permit:
    def check(self) -> None:
        """Do a comparison before each write, in place of the check that the process of a robot makes there."""
        if time.monotonic_ns() < 0:
            raise RuntimeError


def _bus(wire: Any, robot: str, lost: list[int]) -> Callable[[int], Any]:
    codec, bus, ids = wire.CODEC, wire.session.bus, wire.driver.ids
    position, permit = codec.POSITION, _Permit()
    if robot == FEETECH:
        request, expected = codec.sync_read(ids, position.address, position.size), dict.fromkeys(ids, position.size)
    # All servos reply in one frame. Its first error byte and its last checksum are not among the parameters.
    else:
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


def main(program: str, length: str, robot: str, port: str) -> None:
    seconds = SECONDS[length]
    match program:
        case "ours" | "wire":
            result = ours(robot, port, seconds, program == "wire")
        case "floor":
            result = floor(robot, port, seconds)
        case "loop":
            result = loop(robot, port, seconds)
        case "sdk" if robot == FEETECH:
            result = feetech_sdk(port, seconds)
        case "sdk":
            result = dynamixel_sdk(port, seconds)
        case _:
            result = lerobot(port, robot, seconds)
    result["of_limit_x"] = result["cycles_hz"] / LIMIT_HZ[robot]
    print(json.dumps(result), flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
