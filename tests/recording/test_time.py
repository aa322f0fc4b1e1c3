"""The kernel stamps the time at which an actor takes up a message. The gate and the watchdog use no other time
and no other state."""

from __future__ import annotations

import msgspec
import pytest
import trio

from strands_actors.kernel.actor import Actor
from strands_actors.kernel.clock import MonotonicClock, VirtualClock
from strands_actors.kernel.health.failure_detector import DetectorState, FailureDetector
from strands_actors.kernel.health.heartbeat import pair
from strands_actors.kernel.messages import Message
from strands_actors.kernel.node import Node
from strands_actors.supervisors.gate.failsafe import State
from strands_actors.supervisors.gate.gate import Gate
from strands_actors.supervisors.gate.memory import GateMemory
from strands_actors.supervisors.wire.watchdog import Watchdog, WatchdogMemory
from strands_actors.testing.fake import HARDWARE, FakeDriver, FakeHardware
from tests.kernel.kernel import real_time, virtual_time

MESSAGES = 1000


class Count(Message, frozen=True):
    number: int


class Stamped(Actor):
    """Records the stamp of each message. A slow message takes some time."""

    def __init__(self) -> None:
        self.stamps: list[int] = []
        self.done = trio.Event()

    async def receive(self, message: Count) -> None:
        self.stamps.append(self.context.received_ns)
        await trio.sleep(0.01)
        if message.number == 0:
            self.done.set()


class Quick(Actor):
    def __init__(self) -> None:
        self.done = trio.Event()

    def receive(self, message: Count) -> None:
        if message.number == 0:
            self.done.set()


class CountingClock(MonotonicClock):
    reads = 0

    def now_ns(self) -> int:
        self.reads += 1
        return super().now_ns()


@virtual_time
async def test_a_message_is_stamped_when_it_is_taken_up_and_not_when_it_is_sent() -> None:
    node, actor = Node("n", VirtualClock()), Stamped()
    async with trio.open_nursery() as nursery:
        await nursery.start(node.run)
        await nursery.start(node.cell("n/actor/stamped", lambda: actor).run)
        began_ns = node.clock.now_ns()
        for number in (2, 1, 0):
            node.ref("strands/n/actor/stamped").tell(Count(number))
        await actor.done.wait()
        nursery.cancel_scope.cancel()
    assert [stamp - began_ns for stamp in actor.stamps] == [
        pytest.approx(at_ns, abs=1000) for at_ns in (0, 10_000_000, 20_000_000)
    ]


@real_time
async def test_a_message_costs_one_reading_of_the_clock() -> None:
    clock = CountingClock()
    node, actor = Node("n", clock), Quick()
    async with trio.open_nursery() as nursery:
        await nursery.start(node.run)
        await nursery.start(node.cell("n/actor/quick", lambda: actor).run)
        before = clock.reads
        for number in reversed(range(MESSAGES)):
            node.ref("strands/n/actor/quick").tell(Count(number))
        await actor.done.wait()
        reads = clock.reads - before
        nursery.cancel_scope.cancel()
    # One reading per message, and one per burst. A burst on a busy machine may be short.
    assert MESSAGES <= reads <= 2 * MESSAGES + 10


# -- the memory at the start of a recording is complete

WIRING = {"_driver", "_addresses", "_admission"}


def test_a_gate_has_no_state_but_its_memory() -> None:
    HARDWARE["memory"] = FakeHardware()
    try:
        gate = Gate(FakeDriver("fake", "memory", {}), "t", "w", "g", State())
    finally:
        del HARDWARE["memory"]
    remembered = {f"_{name}" for name in GateMemory.__struct_fields__}
    assert set(vars(gate)) - WIRING == remembered


def test_a_watchdog_has_no_state_but_its_memory() -> None:
    watchdog = Watchdog(FakeDriver.timing, "g", "t", lambda _: None, pair()[0])
    wiring = {
        "_addresses",
        "_heartbeat_ttl_ns",
        "_tick_s",
        "_tick_ns",
        "_cycle_ns",
        "_orphaned",
        "_heartbeat",
        "_leave_s",
    }
    wiring |= {"_root_use", "_missed"}
    changing = set(vars(watchdog)) - wiring
    assert len(changing) == len(WatchdogMemory.__struct_fields__) - 1  # the two times of answers are in one list
    memory = WatchdogMemory(1, 2, 3, 4, 5, 6, 7, 8, 9, watchdog._alive, DetectorState(10, 11, 12, None), True)
    watchdog.recall(memory)
    assert watchdog.memory() == memory
    assert msgspec.msgpack.decode(msgspec.msgpack.encode(memory), type=WatchdogMemory) == memory


def test_a_silence_has_no_state_but_its_memory() -> None:
    failure_detector = FailureDetector(0.1, 0.01)
    wiring = {"_own_ticks", "_most_ns", "_ttl_ns", "_longest_ns", "_look"}
    told_at_once = {"_after"}
    kept = {"last_received_ns", "_ticks", "_looked_ns", "_before", "_ticked_ns", "_counted_ns"}
    assert set(vars(failure_detector)) - wiring - told_at_once == kept
    failure_detector.recall(DetectorState(1, 2, 3, None, 4, 5))
    assert failure_detector.memory() == DetectorState(1, 2, 3, None, 4, 5)
