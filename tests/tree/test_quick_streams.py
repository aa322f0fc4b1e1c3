"""A stream of setpoints that does not wait for every answer also ends when one of them is refused."""

from __future__ import annotations

import pytest
import trio

from strands_actors.contract.driver import Condition
from strands_actors.contract.wire import Observation
from strands_actors.kernel.health.heartbeat import Heartbeat
from strands_actors.kernel.messages import Refused
from strands_actors.supervisors.gate.lease import LEASE_TTL_NS
from strands_actors.supervisors.gate.messages import Accepted, Acquire, Lease
from strands_actors.supervisors.wire.watchdog import Watchdog, WatchdogMemory
from strands_actors.testing import FakeDriver, InlineTree, open_inline_tree, run_virtual

from .writer import Writer, armed, setpoints


def test_saf_014_after_a_refusal_in_a_stream_no_setpoint_passes() -> None:
    async def run() -> None:
        async with open_inline_tree() as tree:
            writer = await armed(tree)
            for value in (1.0, 2.0, 1e9, 3.0):  # the third is out of range
                writer.ref.tell(writer.setpoint(a=value))
                await trio.sleep(0.002)
            assert [entry.values[0] for entry in tree.hardware.of("setpoint")] == [1.0, 2.0]
            answer = await writer.send(a=4.0)
            assert isinstance(answer, Refused) and answer.code == "range" and "1000000000" in answer.reason
            assert (await tree.status()).refusals == 3
            await writer.acquire()  # a new lease starts a new stream
            assert isinstance(await writer.send(a=4.0), Accepted)

    run_virtual(run)


def test_a_writer_that_waits_for_the_refusal_may_continue() -> None:
    async def run() -> None:
        async with open_inline_tree() as tree:
            writer = await armed(tree)
            answer = await writer.send(a=1e9)
            assert isinstance(answer, Refused) and answer.code == "range"
            assert isinstance(await writer.send(a=1.0), Accepted)

    run_virtual(run)


# # -- a stream at the rate of the watchdog's ticks (10 ms here), in which each setpoint carries a tick


async def stream(writer: Writer, for_s: float, stand: bool = False) -> None:
    """Send one setpoint each tick, without waiting for refusals."""
    until_s = trio.current_time() + for_s
    value = 0.0
    while trio.current_time() < until_s:
        value += 0.0 if stand else 0.01
        writer.ref.tell(writer.setpoint(period_s=0.01, a=value))
        await trio.sleep(0.01)


def watchdog(tree: InlineTree) -> WatchdogMemory:
    actor = tree.node.cells[tree.gate.address.replace("gate", "watchdog")].actor
    assert isinstance(actor, Watchdog)
    return actor.memory()


def test_the_setpoints_of_a_quick_stream_carry_the_watchdogs_ticks() -> None:
    async def run() -> None:
        async with open_inline_tree() as tree:
            writer = await armed(tree)
            before = watchdog(tree)
            await stream(writer, 2.0)
            after = watchdog(tree)
            assert len(tree.hardware.of("setpoint")) == 200
            assert after.probe - before.probe <= 2  # of 200, before the first setpoint
            assert after.cycle - before.cycle == pytest.approx(100, abs=2)  # 50 per second, as without a stream
            await trio.sleep(1.0)
            assert watchdog(tree).probe - after.probe == pytest.approx(100, abs=2)

    run_virtual(run)


def test_saf_001_the_last_setpoint_of_a_quick_stream_expires_like_any_other() -> None:
    async def run() -> None:
        async with open_inline_tree() as tree:
            writer = await armed(tree)
            await stream(writer, 0.5)
            last_ns = tree.hardware.of("setpoint")[-1].t_ns
            await trio.sleep(0.5)
            safe = tree.hardware.of("safe")[0]
            assert 70 <= (safe.t_ns - last_ns) / 1e6 <= 111
            assert tree.hardware.after("setpoint", safe) == []

    run_virtual(run)


def test_saf_009_a_quick_stream_ends_with_the_lease_above_its_own() -> None:
    async def run() -> None:
        async with open_inline_tree() as tree:
            owner = await armed(tree)
            policy = Writer(tree, "policy")
            answer = await policy.ref.ask(Acquire("policy", owner.lease.id), 1.0)
            assert isinstance(answer, Lease)
            policy.lease = answer
            began_ns = tree.node.clock.now_ns()  # the owner of the lease sends no heartbeat from now on
            await stream(policy, 2.0)
            safe = tree.hardware.of("safe")[0]
            assert safe.t_ns - began_ns <= LEASE_TTL_NS + 11_000_000
            assert setpoints(tree, began_ns + 50_000_000)
            assert tree.hardware.after("setpoint", safe) == []

    run_virtual(run)


def test_a_broken_condition_ends_a_quick_stream_with_the_next_setpoint(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    broken = False

    def condition(observation: Observation, now_ns: int) -> Refused | None:
        return Refused("fault", "it broke") if broken else None

    monkeypatch.setattr(FakeDriver, "conditions", (Condition(condition),))

    async def run() -> None:
        nonlocal broken
        async with open_inline_tree() as tree:
            writer = await armed(tree)
            await stream(writer, 0.2)
            broken, broke_ns = True, tree.node.clock.now_ns()
            await stream(writer, 0.1)
            # half a tick after the refused setpoint
            assert tree.hardware.of("safe")[0].t_ns - broke_ns <= 5_000_000
            assert tree.hardware.of("setpoint")[-1].t_ns < broke_ns

    run_virtual(run)


def test_saf_003_a_root_that_falls_silent_is_detected_during_a_quick_stream(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    async def run() -> None:
        async with open_inline_tree() as tree:
            writer = await armed(tree)
            await stream(writer, 0.2)
            monkeypatch.setattr(Heartbeat, "last_received_ns", watchdog(tree).root.last_received_ns)
            silent_ns = watchdog(tree).root.last_received_ns
            await stream(writer, 0.5, stand=True)
            safe = tree.hardware.of("safe")[0]
            limit_ns = round((FakeDriver.timing.heartbeat_ttl_s + 2 * FakeDriver.timing.tick_s) * 1e9)
            assert safe.t_ns - silent_ns <= limit_ns
            assert tree.hardware.after("setpoint", safe) == []

    run_virtual(run)
