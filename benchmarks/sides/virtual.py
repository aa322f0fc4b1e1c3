"""Run all actors of a robot in virtual time, and measure it: ``python -m benchmarks.sides.virtual SIDE [short]``.

SIDE is the name of the program that is measured. With ``short`` the run is short.

The robot is an SO-101 at 50 Hz with all our code for it. Its bus is in memory, with simulated servos and MuJoCo
at the other end. The main figure is the number of simulated seconds per real second, alone, while a recording is
made, and in its replay. ``same_trace`` is 1 if two runs write the same bytes at the same times. ``bare_x`` is the
figure of a driver without bus and physics.
"""

from __future__ import annotations

import os
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import msgspec
import trio

from benchmarks.house import Figures
from strands_actors.drivers.common.twin import Robot
from strands_actors.drivers.feetech.driver import Feetech
from strands_actors.drivers.feetech.twin import FeetechBus
from strands_actors.drivers.feetech.wire import FeetechWire
from strands_actors.kernel.actor import Actor
from strands_actors.kernel.channels.local_mesh import LocalNetwork
from strands_actors.kernel.clock import Clock, VirtualClock
from strands_actors.kernel.node import Node, Ref
from strands_actors.supervisors import addresses
from strands_actors.supervisors.gate.messages import Accepted, Acquire, Beat, Lease, Resume, Resumed, Setpoint
from strands_actors.supervisors.instrument import Acknowledge, Attach, Attached, Batch, Detach, InstrumentKeeper
from strands_actors.supervisors.wire.group import instrument_keeper
from strands_actors.surfaces.recording.file import Recording, new_info
from strands_actors.surfaces.recording.player import replay
from strands_actors.surfaces.recording.rows import Gap, Journal
from strands_actors.testing import InlineTree, open_inline_tree, run_virtual

from .common import answer

ROBOT = "so101"
JOINT = "shoulder_pan"
BYTE_S = 10 / Feetech.DEFAULT_BAUD
CONTROL_S = 0.02
TTL_NS = 100_000_000


def simulated_s(short: bool) -> float:
    return 5.0 if short else 60.0


class MemoryBus:
    """A serial port in memory, with simulated servos at its other end.

    A reply arrives as a whole, when its last byte would have passed a UART at 1 Mbaud. A USB adapter does the same.
    """

    def __init__(self, servos: Robot) -> None:
        self.written: list[tuple[float, bytes]] = []
        self._servos = servos
        self._coming = b""
        self._due_s = 0.0

    def write(self, data: bytes) -> None:
        now_s = trio.current_time()
        self.written.append((now_s, data))
        took_s = 0.0
        for exchange in self._servos.receive(data, Feetech.DEFAULT_BAUD):
            took_s += len(exchange.request) * BYTE_S
            for reply in exchange.replies:
                took_s += reply.delay_s + len(reply.data) * BYTE_S
                self._coming += reply.data
        self._due_s = now_s + took_s

    async def read(self) -> bytes:
        if not self._coming:
            await trio.sleep_forever()
        await trio.sleep_until(self._due_s)
        data, self._coming = self._coming, b""
        return data

    def take(self) -> bytes:
        if self._due_s > trio.current_time():
            return b""
        data, self._coming = self._coming, b""
        return data

    def discard_input(self) -> None:
        self.take()

    def discard_output(self) -> None:
        pass

    async def hung_up(self) -> None:
        await trio.sleep_forever()

    def fileno(self) -> int:
        # The stop channel duplicates this descriptor, but is not used here.
        return os.open(os.devnull, os.O_RDWR)

    def close(self) -> None:
        pass


class VirtualArm(Feetech):
    """An SO-101 with its servos in memory."""

    def __init__(self) -> None:
        super().__init__(ROBOT, "memory", Feetech.resolve(ROBOT, {}))
        self.bus = MemoryBus(FeetechBus.for_robot(ROBOT, now_s=trio.current_time))

    def open_wire(self, clock: Clock) -> FeetechWire:
        return FeetechWire(self.config, clock, lambda path, baud: self.bus)


@dataclass
class Ran:
    span_s: float = 0.0
    written: list[tuple[float, bytes]] = field(default_factory=list)
    recording: Recording | None = None

    def trace(self) -> list[tuple[int, bytes]]:
        """Return the written frames with their times, in nanoseconds since the first frame."""
        began_s = self.written[0][0]
        return [(round((at_s - began_s) * 1e9), data) for at_s, data in self.written]


async def command(tree: InlineTree, gate: Ref, key: str, seconds: float) -> None:
    """Command the robot as a policy does: in every period, send a setpoint, wait for the answer, and send a
    heartbeat.
    """
    assert isinstance(await gate.ask(Resume("bench"), 1.0), Resumed)
    lease = await gate.ask(Acquire("bench"), 1.0)
    assert isinstance(lease, Lease), lease
    clock = tree.node.clock
    for step in range(int(seconds / CONTROL_S)):
        setpoint = Setpoint(
            lease.id, lease.epoch, clock.now_ns() + TTL_NS, {key: (step % 50) * 0.01}, CONTROL_S, False
        )
        accepted = await gate.ask(setpoint, 1.0)
        assert isinstance(accepted, Accepted), accepted
        gate.tell(Beat(lease.id))
        await trio.sleep(CONTROL_S)


def run_bare(seconds: float) -> float:
    """Return the real time, in seconds, that all actors need with a driver that only stores its setpoints."""
    spans_s: list[float] = []

    async def main() -> None:
        async with open_inline_tree() as tree:
            began_s = time.perf_counter()
            await command(tree, tree.node.ref(tree.gate.address, sender="strands/bench/writer"), "a", seconds)
            spans_s.append(time.perf_counter() - began_s)

    run_virtual(main)
    return spans_s[0]


def run_tree(seconds: float) -> Ran:
    ran = Ran()

    async def main() -> None:
        arm = VirtualArm()
        async with open_inline_tree(driver=arm) as tree:
            began_s = time.perf_counter()
            await command(tree, tree.node.ref(tree.gate.address, sender="strands/bench/writer"), JOINT, seconds)
            ran.span_s = time.perf_counter() - began_s
        ran.written = arm.bus.written

    run_virtual(main)
    return ran


class Taker(Actor):
    """An actor that stores and acknowledges the batches of a recording."""

    def __init__(self, instrument: str) -> None:
        self.batches: list[Batch] = []
        self._instrument = instrument

    def receive(self, message: Batch) -> None:
        self.batches.append(message)
        self.context.ref(self._instrument).tell(Acknowledge(message.session, message.number))


def run_recorded(seconds: float) -> Ran:
    ran = Ran()

    async def main() -> None:
        network = LocalNetwork()
        async with open_inline_tree(driver=VirtualArm()) as tree, trio.open_nursery() as nursery:
            robot = tree.gate.address.split("/")[1]
            network.join().attach(tree.node)
            path = addresses.of(robot).instrument("wire")
            description: Mapping[str, Any] = {"class": "memory", "robot": ROBOT, "port": "memory", "options": {}}
            keeper = tree.node.cell(
                path, lambda: instrument_keeper(tree.node, tree.driver, dict(description), robot), "instrument"
            )
            await nursery.start(keeper.run)
            node = Node("recorder", VirtualClock())
            network.join().attach(node)
            await nursery.start(node.run)
            taker = Taker(f"strands/{path}")
            cell = node.cell("recorder/actor/wire", lambda: taker)
            await nursery.start(cell.run)
            instrument = node.ref(f"strands/{path}", InstrumentKeeper)
            attached = await instrument.ask(Attach(cell.address, 1, "bench"), 5.0)
            assert isinstance(attached, Attached), attached
            began_s = time.perf_counter()
            await command(tree, tree.node.ref(tree.gate.address, sender="strands/bench/writer"), JOINT, seconds)
            ran.span_s = time.perf_counter() - began_s
            await instrument.ask(Detach(1), 5.0)
            parts: list[Journal | Gap] = [
                Journal("wire", batch.session, batch.number, msgspec.msgpack.encode(batch.entries))
                for batch in taker.batches
            ]
            ran.recording = Recording(new_info(robot, "", attached), parts)
            nursery.cancel_scope.cancel()

    run_virtual(main)
    return ran


def replayed(recording: Recording) -> float:
    """Replay a recording, and return the real time of that, in seconds. Raise ``RuntimeError`` if the decisions in
    the replay differ from the recorded ones.
    """
    began_s = time.perf_counter()
    outcome = replay(recording, Feetech(ROBOT, "memory", Feetech.resolve(ROBOT, {})))
    span_s = time.perf_counter() - began_s
    if not outcome.equal:
        raise RuntimeError(f"the replay differs from the recording: {outcome.difference}")
    return span_s


def ours(short: bool) -> Figures:
    seconds = simulated_s(short)
    first, second = run_tree(seconds), run_tree(seconds)
    recorded = run_recorded(seconds)
    assert recorded.recording is not None
    return {
        "tree_x": seconds / first.span_s,
        "bare_x": seconds / run_bare(seconds),
        "recorded_x": seconds / recorded.span_s,
        "replayed_x": seconds / replayed(recorded.recording),
        "same_trace": float(first.trace() == second.trace()),
    }


PASSES_HZ = 470
"""Passes of the trio loop in a simulated second of an SO-101: for 100 ticks, 30 exchanges on its bus, the times
of bytes, and answers."""


def passes(short: bool) -> Figures:
    """Measure a loop that wakes up as often as the robot's actors do, but computes only the physics."""
    seconds = simulated_s(short)
    plant = FeetechBus.for_robot(ROBOT, lambda: 0.0).plant
    spans_s: list[float] = []

    async def main() -> None:
        began_s = time.perf_counter()
        for _ in range(int(seconds * PASSES_HZ)):
            await trio.sleep(1 / PASSES_HZ)
            plant.catch_up(trio.current_time())
        spans_s.append(time.perf_counter() - began_s)

    run_virtual(main)
    return {"tree_x": seconds / spans_s[0]}


if __name__ == "__main__":
    answer({"ours": ours, "passes": passes})
