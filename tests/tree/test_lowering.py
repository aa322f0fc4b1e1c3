"""A robot that is lowered takes seconds for its stop. What comes meanwhile cuts it short, or lets it go on
(SAF-026). In virtual time.
"""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

import pytest
import trio

from strands_actors.contract.driver import Reason, Timing
from strands_actors.contract.fallbacks import fallbacks_for
from strands_actors.contract.safe_state import SafeState
from strands_actors.contract.wire import MotorReport, Observation
from strands_actors.kernel.messages import Message
from strands_actors.supervisors.gate.messages import Accepted, Resume, Resumed, Stop, StopReport
from strands_actors.testing import InlineTree, open_inline_tree, run_virtual
from strands_actors.testing.fake import FakeDriver, FakeWire

from .writer import Writer, armed, setpoints

LOWER_S = 2.0
WITHOUT_HURRY = (Reason.STOP, Reason.CLEANUP, Reason.CALLER)


@pytest.fixture(autouse=True)
def lowered(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let the fake robot be lowered in two seconds, and only by its wire."""
    fallbacks = fallbacks_for(late=SafeState.HOLD, otherwise=SafeState.LIMP)
    fallbacks |= dict.fromkeys(WITHOUT_HURRY, SafeState.LOWERED)
    timing = Timing(control_hz=50.0, keepalive_s=0.02, stream_ttl_s=0.1, safe_s=LOWER_S + 2.0)
    monkeypatch.setattr(FakeDriver, "fallbacks", fallbacks)
    monkeypatch.setattr(FakeDriver, "timing", timing)
    limp = FakeWire.make_safe

    async def make_safe(self: FakeWire, safe_state: SafeState) -> tuple[MotorReport, ...]:
        if safe_state == SafeState.LOWERED:
            self._hardware.record(self._clock, "safe", "wire", SafeState.HOLD)
            await trio.sleep(LOWER_S)
            safe_state = SafeState.LIMP
        return await limp(self, safe_state)

    monkeypatch.setattr(FakeWire, "make_safe", make_safe)


@asynccontextmanager
async def moving() -> AsyncIterator[tuple[InlineTree, Writer]]:
    async with open_inline_tree() as tree:
        writer = await armed(tree)
        assert isinstance(await writer.send(a=1.0), Accepted)
        yield tree, writer


def states(tree: InlineTree, since_ns: int) -> list[tuple[str, float, str]]:
    """Return the safe states on the wire: state, time since then in seconds, and who wrote it."""
    return [
        (entry.safe_state, round((entry.t_ns - since_ns) / 1e9, 2), entry.path)
        for entry in tree.hardware.of("safe", since_ns)
    ]


async def ordered(tree: InlineTree, *stops: tuple[float, Reason, bool]) -> tuple[int, list[Message | None]]:
    """Order stops one after the other, at these times. Return when the first was ordered, and all answers."""
    began_ns, began_s = tree.node.clock.now_ns(), trio.current_time()
    answers: list[Message | None] = [None] * len(stops)

    async def order(number: int, after_s: float, reason: Reason, lock: bool) -> None:
        await trio.sleep_until(began_s + after_s)
        answers[number] = await tree.gate.ask(Stop(reason, "test", lock), 9.0)

    async with trio.open_nursery() as nursery:
        for number, stop in enumerate(stops):
            nursery.start_soon(order, number, *stop)
    return began_ns, answers


@pytest.mark.parametrize("reason", WITHOUT_HURRY)
def test_saf_026_a_stop_without_hurry_lowers_and_then_lets_go(reason: Reason) -> None:
    async def run() -> None:
        async with moving() as (tree, _):
            began_ns, answers = await ordered(tree, (0.0, reason, False))
            assert [state[:2] for state in states(tree, began_ns)] == [("hold", 0.0), ("limp", LOWER_S)]
            assert isinstance(answers[0], StopReport) and answers[0].confirmed
            assert answers[0].safe_state == SafeState.LOWERED
            assert tree.hardware.after("setpoint", tree.hardware.of("safe", began_ns)[0]) == []

    run_virtual(run)


@pytest.mark.parametrize(("again", "lock"), [(Reason.STOP, False), (Reason.ESTOP, True), (Reason.FAULT, False)])
def test_saf_026_a_further_stop_makes_the_arm_limp_at_once(again: Reason, lock: bool) -> None:
    async def run() -> None:
        async with moving() as (tree, _):
            began_ns, answers = await ordered(tree, (0.0, Reason.STOP, False), (0.7, again, lock))
            assert [state[:2] for state in states(tree, began_ns)] == [("hold", 0.0), ("limp", 0.7)]
            for answer in answers:
                assert isinstance(answer, StopReport) and answer.confirmed
                assert answer.safe_state == SafeState.LIMP
            assert tree.hardware.after("setpoint", tree.hardware.of("safe", began_ns)[0]) == []

    run_virtual(run)


def test_saf_026_the_end_of_the_script_during_its_cleanup_lets_the_arm_go_on_down() -> None:
    async def run() -> None:
        async with moving() as (tree, _):
            began_ns, answers = await ordered(tree, (0.0, Reason.CLEANUP, False), (0.7, Reason.CALLER, False))
            found = [state[:2] for state in states(tree, began_ns)]
            assert found == [("hold", 0.0), ("hold", 0.7), ("limp", 0.7 + LOWER_S)]
            assert all(isinstance(answer, StopReport) and answer.confirmed for answer in answers)

    run_virtual(run)


def test_saf_026_an_estop_is_limp_at_once() -> None:
    async def run() -> None:
        async with moving() as (tree, _):
            began_ns, _ = await ordered(tree, (0.0, Reason.ESTOP, True))
            assert [state[:2] for state in states(tree, began_ns)] == [("limp", 0.0)]

    run_virtual(run)


def test_saf_026_if_the_wire_dies_meanwhile_the_root_makes_the_arm_limp_at_once() -> None:
    async def run() -> None:
        async with moving() as (tree, _):
            began_ns = tree.node.clock.now_ns()
            async with trio.open_nursery() as nursery:
                nursery.start_soon(tree.gate.ask, Stop(Reason.STOP, "test"), 0.6)
                await trio.sleep(0.5)
                await tree.wires_made[-1].fence()
                await trio.sleep(0.05)
                nursery.cancel_scope.cancel()
            found = states(tree, began_ns)
            assert found[0][:2] == ("hold", 0.0)
            assert found[1] == ("limp", pytest.approx(0.5, abs=0.05), "stop_channel")

    run_virtual(run)


def test_saf_007_a_lowered_robot_moves_again_only_after_a_resume() -> None:
    async def run() -> None:
        async with moving() as (tree, writer):
            await ordered(tree, (0.0, Reason.STOP, False))
            began_ns = tree.node.clock.now_ns()
            await writer.acquire()
            assert not isinstance(await writer.send(a=2.0), Accepted)
            assert setpoints(tree, began_ns) == []
            assert isinstance(await tree.gate.ask(Resume("test"), 1.0), Resumed)
            await writer.acquire()
            assert isinstance(await writer.send(a=2.0), Accepted)

    run_virtual(run)


def test_saf_026_a_resume_during_a_lowering_is_refused() -> None:
    async def run() -> None:
        async with moving() as (tree, _), trio.open_nursery() as nursery:
            nursery.start_soon(tree.gate.ask, Stop(Reason.STOP, "test"), 9.0)
            await trio.sleep(0.5)
            assert not isinstance(await tree.gate.ask(Resume("test"), 1.0), Resumed)

    run_virtual(run)


def test_what_the_wire_reads_meanwhile_is_published(monkeypatch: pytest.MonkeyPatch) -> None:
    """Others see how the arm comes down, and nothing later than the end of the stop."""

    async def run() -> None:
        clock_ns = [0]

        def seen(self: FakeWire) -> Observation:
            return Observation(clock_ns[0], (clock_ns[0] / 1e9, 0.0), (clock_ns[0], clock_ns[0]))

        monkeypatch.setattr(FakeWire, "seen", property(seen))
        async with moving() as (tree, _), trio.open_nursery() as nursery:
            nursery.start_soon(tree.gate.ask, Stop(Reason.STOP, "test"), 9.0)
            positions = []
            for _look in range(4):
                clock_ns[0] = tree.node.clock.now_ns()
                await trio.sleep(0.3)
                status = await tree.status()
                assert status.observation is not None
                positions.append(status.observation.position[0])
            assert positions == sorted(set(positions)), positions

    run_virtual(run)


def test_saf_023_an_arm_that_could_not_be_lowered_is_reported_as_limp(monkeypatch: pytest.MonkeyPatch) -> None:
    async def run() -> None:
        lowers = FakeWire.make_safe

        async def make_safe(self: FakeWire, safe_state: SafeState) -> tuple[MotorReport, ...]:
            if safe_state == SafeState.LOWERED:
                self.ended_in = SafeState.LIMP
                safe_state = SafeState.LIMP
            return await lowers(self, safe_state)

        async with moving() as (tree, _):
            monkeypatch.setattr(FakeWire, "make_safe", make_safe)
            _, answers = await ordered(tree, (0.0, Reason.STOP, False))
            assert isinstance(answers[0], StopReport) and answers[0].confirmed
            assert answers[0].safe_state == SafeState.LIMP
            # The next stop is reported as it ended.
            monkeypatch.setattr(FakeWire, "make_safe", lowers)
            assert isinstance(await tree.gate.ask(Resume(), 9.0), Resumed)
            _, answers = await ordered(tree, (0.0, Reason.STOP, False))
            assert isinstance(answers[0], StopReport) and answers[0].safe_state == SafeState.LOWERED

    run_virtual(run)
