"""A robot's whole tree in virtual time: ``python -m benchmarks.sides.virtual SIDE [short]``.

Guardian, gate, watchdog, transport and a robot in memory, commanded at 50 Hz: how many of its seconds pass in
one of ours; the same recorded and replayed; and whether two runs write the same at the same times.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, field

import msgspec
import trio

from benchmarks.house import Figures
from strands_actors.recording.file import Recording, new_info
from strands_actors.recording.lines import Gap, Journal
from strands_actors.recording.player import replay
from strands_actors.runtime.actor import Actor
from strands_actors.runtime.clock import VirtualClock
from strands_actors.runtime.local_mesh import LocalNetwork
from strands_actors.runtime.node import Node, Ref
from strands_actors.supervisors import addresses
from strands_actors.supervisors.messages import Accepted, Acquire, Beat, Lease, Resume, Resumed, Setpoint
from strands_actors.supervisors.tap import Acknowledge, Attach, Attached, Batch, Detach, TapKeeper
from strands_actors.supervisors.wire import tap_keeper
from strands_actors.testing import FakeDriver, FakeHardware, InlineTree, Written, open_inline_tree, run_virtual
from strands_actors.testing.fake import HARDWARE

from .common import answer

CONTROL_S = 0.02
TTL_NS = 100_000_000


def simulated_s(short: bool) -> float:
    return 5.0 if short else 60.0


@dataclass
class Ran:
    span_s: float = 0.0
    written: list[Written] = field(default_factory=list)
    recording: Recording | None = None

    def trace(self) -> list[tuple[object, ...]]:
        """What was written, from the first entry on."""
        began_ns = self.written[0].t_ns
        return [(one.t_ns - began_ns, one.kind, one.path, one.rung, repr(one.values)) for one in self.written]


async def command(tree: InlineTree, gate: Ref, seconds: float) -> None:
    """What a rollout does: a setpoint every period, asked, and a beat."""
    assert isinstance(await gate.ask(Resume("bench"), 1.0), Resumed)
    lease = await gate.ask(Acquire("bench"), 1.0)
    assert isinstance(lease, Lease), lease
    clock = tree.node.clock
    for step in range(int(seconds / CONTROL_S)):
        action = {"a": (step % 50) * 0.01}
        setpoint = Setpoint(lease.id, lease.epoch, clock.now_ns() + TTL_NS, action, CONTROL_S, False)
        accepted = await gate.ask(setpoint, 1.0)
        assert isinstance(accepted, Accepted), accepted
        gate.tell(Beat(lease.id))
        await trio.sleep(CONTROL_S)


def run_tree(seconds: float) -> Ran:
    ran = Ran()

    async def main() -> None:
        hardware = FakeHardware()
        async with open_inline_tree(hardware) as tree:
            began_s = time.perf_counter()
            await command(tree, tree.node.ref(tree.gate.address, sender="strands/bench/writer"), seconds)
            ran.span_s = time.perf_counter() - began_s
        ran.written = list(hardware.written)

    run_virtual(main)
    return ran


class Taker(Actor):
    """Keeps what is recorded."""

    def __init__(self, tap: str) -> None:
        self.batches: list[Batch] = []
        self._tap = tap

    def receive(self, message: Batch) -> None:
        self.batches.append(message)
        self.context.ref(self._tap).tell(Acknowledge(message.session, message.number))


def run_recorded(seconds: float) -> Ran:
    ran = Ran()

    async def main() -> None:
        network = LocalNetwork()
        async with open_inline_tree(FakeHardware()) as tree, trio.open_nursery() as nursery:
            robot = tree.gate.address.split("/")[1]
            network.join().attach(tree.node)
            path = addresses.of(robot).tap("wire")
            description = {"class": "fake", "robot": "fake", "port": robot, "options": {}}
            keeper = tree.node.cell(path, lambda: tap_keeper(tree.node, tree.driver, description, robot), "tap")
            await nursery.start(keeper.run)
            node = Node("recorder", VirtualClock())
            network.join().attach(node)
            await nursery.start(node.run)
            taker = Taker(f"strands/{path}")
            cell = node.cell("recorder/actor/wire", lambda: taker)
            await nursery.start(cell.run)
            tap = node.ref(f"strands/{path}", TapKeeper)
            attached = await tap.ask(Attach(cell.address, 1, "bench"), 5.0)
            assert isinstance(attached, Attached), attached
            began_s = time.perf_counter()
            await command(tree, tree.node.ref(tree.gate.address, sender="strands/bench/writer"), seconds)
            ran.span_s = time.perf_counter() - began_s
            await tap.ask(Detach(1), 5.0)
            parts: list[Journal | Gap] = [
                Journal("wire", batch.session, batch.number, msgspec.msgpack.encode(batch.entries))
                for batch in taker.batches
            ]
            ran.recording = Recording(new_info(robot, "", attached), parts)
            nursery.cancel_scope.cancel()

    run_virtual(main)
    return ran


def replayed(recording: Recording) -> float:
    """Seconds of ours that the replay took; it must decide as the robot did."""
    HARDWARE["replay"] = FakeHardware()
    try:
        began_s = time.perf_counter()
        outcome = replay(recording, FakeDriver("fake", "replay", {}))
        span_s = time.perf_counter() - began_s
    finally:
        del HARDWARE["replay"]
    if not outcome.equal:
        raise RuntimeError(f"the replay decided otherwise: {outcome.difference}")
    return span_s


def ours(short: bool) -> Figures:
    seconds = simulated_s(short)
    first, second = run_tree(seconds), run_tree(seconds)
    recorded = run_recorded(seconds)
    assert recorded.recording is not None
    return {
        "tree_x": seconds / first.span_s,
        "recorded_x": seconds / recorded.span_s,
        "replayed_x": seconds / replayed(recorded.recording),
        "same_trace": float(first.trace() == second.trace()),
    }


if __name__ == "__main__":
    answer({"ours": ours})
