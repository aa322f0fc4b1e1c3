"""SAF-024, in virtual time: each process frees its reserve for a stop. A root that could not confirm a
stop checks at once which resource is missing.
"""

from __future__ import annotations

import pytest
import trio

from strands_actors.contract.driver import Reason
from strands_actors.contract.safe_state import SafeState
from strands_actors.contract.wire import MotorReport
from strands_actors.kernel.clock import NS
from strands_actors.kernel.processes.reserve import RESERVE
from strands_actors.supervisors.gate.messages import Stop
from strands_actors.testing import open_inline_tree, run_virtual
from strands_actors.testing.fake import FakeStopChannel, FakeWire

from .writer import armed


def note_reserve(monkeypatch: pytest.MonkeyPatch, channel: type[FakeWire] | type[FakeStopChannel]) -> list[bool]:
    """Return a list that gets, for each stop by ``channel``, whether the reserve was free."""
    seen: list[bool] = []
    make_safe = channel.make_safe

    async def noting(self: FakeWire | FakeStopChannel, safe_state: SafeState) -> tuple[MotorReport, ...]:
        seen.append(RESERVE.is_freed)
        return await make_safe(self, safe_state)  # type: ignore[arg-type]

    monkeypatch.setattr(channel, "make_safe", noting)
    return seen


def test_saf_024_the_wire_frees_its_reserve_for_a_stop_and_not_for_a_hold(monkeypatch: pytest.MonkeyPatch) -> None:
    seen = note_reserve(monkeypatch, FakeWire)

    async def run() -> None:
        async with open_inline_tree() as tree:
            await armed(tree)
            await tree.gate.ask(Stop(Reason.POLICY), 1.0)
            await tree.gate.ask(Stop(Reason.STOP), 1.0)
            assert seen == [False, True]
            assert not RESERVE.is_freed

    run_virtual(run)


def test_saf_024_the_root_frees_its_reserve_for_a_stop(monkeypatch: pytest.MonkeyPatch) -> None:
    seen = note_reserve(monkeypatch, FakeStopChannel)

    async def run() -> None:
        async with open_inline_tree() as tree:
            await armed(tree)
            tree.wire._scope.cancel()
            await trio.sleep(0.05)
            assert seen and all(seen)
            assert not RESERVE.is_freed

    run_virtual(run)


def test_saf_024_a_root_that_could_not_confirm_a_stop_checks_its_resources_at_once() -> None:
    async def run() -> None:
        async with open_inline_tree() as tree:
            await armed(tree)
            clock, failed_ns = tree.node.clock, list[int]()
            tree.keeper._on_failed = lambda: failed_ns.append(clock.now_ns())
            tree.hardware.plugged = False
            killed_ns = clock.now_ns()
            tree.wire._scope.cancel()
            await trio.sleep(1.0)
            assert failed_ns[0] - killed_ns <= tree.driver.bound_s * NS
            assert len(failed_ns) > 1, "the root checks after each further attempt, too"

    run_virtual(run)


def test_saf_024_a_root_whose_stop_was_confirmed_checks_nothing() -> None:
    async def run() -> None:
        async with open_inline_tree() as tree:
            await armed(tree)
            checks: list[None] = []
            tree.keeper._on_failed = lambda: checks.append(None)
            tree.wire._scope.cancel()
            await trio.sleep(1.0)
            assert tree.keeper.confirmed and not checks

    run_virtual(run)
