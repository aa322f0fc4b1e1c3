"""A wire that uses an SDK may announce for how long its process will be silent, and may report that it
needs a new process.
"""

from __future__ import annotations

from functools import partial

import msgspec
import pytest
import trio

from strands_actors.contract.wire import ProcessSpent
from strands_actors.kernel.supervisor import Budget
from strands_actors.supervisors.gate.messages import Accepted
from strands_actors.supervisors.root.messages import SilentUntil
from strands_actors.supervisors.wire import group
from strands_actors.supervisors.wire.messages import RootGone
from strands_actors.testing import FakeDriver, InlineTree, open_inline_tree, run_virtual

from .writer import armed, freeze

MS = 1_000_000
FENCED_MS = 250
"""Longest time from the last heartbeat to the stop channel's frame."""


@pytest.fixture
def silent_s(monkeypatch: pytest.MonkeyPatch) -> float:
    """Let the driver declare that its wire may be silent for one second."""
    monkeypatch.setattr(FakeDriver, "timing", msgspec.structs.replace(FakeDriver.timing, silent_s=1.0))
    return 1.0


async def silence(tree: InlineTree, for_s: float) -> int:
    """Let the wire announce a silence and then answer nothing. Return the time of the announcement."""
    now_ns = tree.node.clock.now_ns()
    tree.guardian.tell(SilentUntil(now_ns + round(for_s * 1e9)))
    await trio.sleep(0.001)
    freeze(tree, "gate")
    return now_ns


async def fenced_after_ms(tree: InlineTree, since_ns: int) -> float:
    with trio.fail_after(120):
        while not tree.hardware.of("safe", since_ns):  # noqa: ASYNC110  # the hardware sends no event
            await trio.sleep(0.005)
    return (tree.hardware.of("safe", since_ns)[0].t_ns - since_ns) / MS


def test_an_announced_silence_is_not_a_freeze_until_it_is_over(silent_s: float) -> None:
    async def run() -> None:
        async with open_inline_tree() as tree:
            await armed(tree)
            since_ns = await silence(tree, 0.5)
            assert 500 <= await fenced_after_ms(tree, since_ns) < 500 + FENCED_MS

    run_virtual(run)


def test_the_root_accepts_no_longer_silence_than_the_driver_declares(silent_s: float) -> None:
    async def run() -> None:
        async with open_inline_tree() as tree:
            await armed(tree)
            since_ns = await silence(tree, 60.0)
            assert 1000 <= await fenced_after_ms(tree, since_ns) < 1000 + FENCED_MS

    run_virtual(run)


def test_a_silence_is_not_accepted_if_the_driver_declares_none() -> None:
    async def run() -> None:
        async with open_inline_tree() as tree:
            await armed(tree)
            since_ns = await silence(tree, 60.0)
            assert await fenced_after_ms(tree, since_ns) < FENCED_MS

    run_virtual(run)


def test_the_end_of_a_silence_is_announced_too(silent_s: float) -> None:
    async def run() -> None:
        async with open_inline_tree() as tree:
            await armed(tree)
            tree.guardian.tell(SilentUntil(tree.node.clock.now_ns() + round(1e9)))
            await trio.sleep(0.1)
            tree.guardian.tell(SilentUntil(0))
            await trio.sleep(0.001)
            freeze(tree, "gate")
            assert await fenced_after_ms(tree, tree.node.clock.now_ns()) < FENCED_MS

    run_virtual(run)


def test_opening_and_arming_announce_a_silence(silent_s: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """The guardian waits longer for a heartbeat while the wire opens and arms, and no longer afterwards."""
    from strands_actors.testing import fake

    seen: list[int] = []

    async def run() -> None:
        async with open_inline_tree() as tree:
            slow = fake.FakeWire.arm

            async def arm(wire: fake.FakeWire, permit: fake.Permit) -> fake.Observation:
                await trio.sleep(0.001)
                seen.append(tree.keeper._silent_until_ns - tree.node.clock.now_ns())
                return await slow(wire, permit)

            monkeypatch.setattr(fake.FakeWire, "arm", arm)
            await armed(tree)
            await trio.sleep(0.001)
            assert tree.keeper._silent_until_ns == 0

    run_virtual(run)
    assert 0.9e9 < seen[0] < 1.0e9


def test_saf_004_a_wire_whose_sdk_hangs_makes_safe_when_its_root_is_gone_too(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A root that spins fences no process. Observed on a UR: the SDK and the root hung, and no safe frame
    was written.
    """

    async def run() -> None:
        async with open_inline_tree() as tree:
            writer = await armed(tree)
            assert isinstance(await writer.send(latched=True, a=5.0), Accepted)
            await trio.sleep(0.05)
            monkeypatch.setattr(tree.keeper, "_break", lambda *_: None)
            transport = tree.node.cells[tree.gate.address.replace("gate", "transport")].actor

            async def read() -> None:
                raise ProcessSpent("the SDK hangs")

            transport._wire.read = read  # type: ignore[attr-defined]
            await trio.sleep(0.05)
            since_ns = tree.node.clock.now_ns()
            assert not tree.hardware.of("setpoint", since_ns)
            tree.node.ref(tree.gate.address.replace("gate", "watchdog")).tell(RootGone())
            await trio.sleep(0.05)
            assert tree.hardware.of("safe", since_ns)[0].path == "wire"
            assert not tree.hardware.of("setpoint", since_ns)

    run_virtual(run)


def test_a_wire_whose_sdk_hangs_is_replaced_after_a_stop_and_counts_as_no_failure() -> None:
    async def run() -> None:
        async with open_inline_tree(budget=Budget(restarts=0)) as tree:
            for life in range(1, 4):
                writer = await armed(tree)
                assert isinstance(await writer.send(latched=True, a=5.0), Accepted)
                await trio.sleep(0.05)
                since_ns = tree.node.clock.now_ns()
                wire = tree.node.cells[tree.gate.address.replace("gate", "transport")].actor._wire  # type: ignore[attr-defined]

                async def read() -> None:
                    raise ProcessSpent("the SDK hangs")

                wire.read = read
                assert await fenced_after_ms(tree, since_ns) < FENCED_MS
                safe = tree.hardware.of("safe", since_ns)[0]
                assert (safe.path, safe.safe_state) == ("stop_channel", "limp")
                await tree.until("disarmed")
                assert len(tree.wires_made) == life + 1
                assert not tree.hardware.of("setpoint", safe.t_ns + 1), "a restart resumes no motion"
                assert tree.keeper.last_report is not None
                assert tree.keeper.last_report.confirmed

    run_virtual(run)


DYING_MS = 3 * FakeDriver.timing.tick_s * 1000
"""Longest time from the last heartbeat to the safe frame, when the end of the process is seen while it
dies. To detect a silence takes three times as long.
"""


def test_saf_003_the_root_does_not_wait_for_the_end_of_a_wire_that_dies(monkeypatch: pytest.MonkeyPatch) -> None:
    """The system reports the end of a process after its memory is freed, 5 to 20 ms after it died."""

    async def run() -> None:
        async with open_inline_tree() as tree:
            writer = await armed(tree)
            assert isinstance(await writer.send(latched=True, a=5.0), Accepted)
            await trio.sleep(0.05)
            freeze(tree, "transport")
            freeze(tree, "gate")
            since_ns = tree.node.clock.now_ns()
            monkeypatch.setattr(tree.wire, "dying", lambda: True)
            assert await fenced_after_ms(tree, since_ns) < DYING_MS < FakeDriver.timing.heartbeat_ttl_s * 1000
            assert tree.hardware.of("safe", since_ns)[0].path == "stop_channel"
            await trio.sleep(0.1)
            assert not tree.hardware.of("setpoint", since_ns)
            assert tree.keeper._break_cause[1] == "the wire group ended", "the report gives the reason of the end"

    run_virtual(run)


def test_a_wire_that_was_released_and_ends_gets_no_safe_frame(monkeypatch: pytest.MonkeyPatch) -> None:
    """It has confirmed the stop, so the root must not treat it as broken."""

    async def run() -> None:
        async with open_inline_tree() as tree:
            await armed(tree)
            monkeypatch.setattr(tree.wire, "dying", lambda: True)
            freeze(tree, "watchdog")  # the wire sends no more heartbeats
            tree.keeper._released = True
            since_ns = tree.node.clock.now_ns()
            await trio.sleep(DYING_MS / 1000)
            assert not tree.hardware.of("safe", since_ns)

    run_virtual(run)


def test_saf_003_a_wire_does_not_wait_for_the_end_of_a_root_that_dies(monkeypatch: pytest.MonkeyPatch) -> None:
    dead = False

    async def run() -> None:
        def look() -> None:
            if dead:
                tree.node.ref(tree.gate.address.replace("gate", "watchdog")).tell(RootGone())

        monkeypatch.setattr(group, "run_group", partial(group.run_group, missed=look))
        async with open_inline_tree() as tree:
            writer = await armed(tree)
            assert isinstance(await writer.send(latched=True, a=5.0), Accepted)
            await trio.sleep(0.05)
            since_ns = tree.node.clock.now_ns()
            nonlocal dead
            dead = True
            freeze(tree, "guardian")
            await trio.sleep(DYING_MS / 1000)
            safe = tree.hardware.of("safe", since_ns)[0]
            assert safe.path == "wire"
            assert not [each for each in tree.hardware.of("setpoint", since_ns) if each.t_ns > safe.t_ns]

    run_virtual(run)
