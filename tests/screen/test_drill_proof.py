"""Test which report a drill accepts as proof of a step: confirmed, with the step's reason, from any process
that stopped the robot."""

from __future__ import annotations

import contextlib
from collections.abc import AsyncIterator, Iterator
from types import SimpleNamespace
from typing import Any

import msgspec
import pytest
import trio
from trio.testing import MockClock

from strands_actors.contract.driver import Reason
from strands_actors.supervisors.gate.messages import StopReport
from strands_actors.surfaces.drill import steps
from strands_actors.surfaces.drill.certificate import StepResult
from strands_actors.surfaces.drill.steps import RETURN_S, Drill
from tests.fake_kinds import FakeBase

BEGAN_NS = 1000


def report(reason: Reason, confirmed: bool = True, at_ns: int = BEGAN_NS + 1) -> StopReport:
    return StopReport(reason, "stop", 1, confirmed, (), at_ns=at_ns)


class Tree:
    """Yields the newest reports of gate and root one pair at a time, then repeats the last pair."""

    driver = None

    def __init__(self, *said: tuple[StopReport | None, StopReport | None]) -> None:
        self._said: Iterator[tuple[StopReport | None, StopReport | None]] = iter(said)
        self._now: tuple[StopReport | None, StopReport | None] = (None, None)

    async def status(self) -> Any:
        await trio.lowlevel.checkpoint()
        self._now = next(self._said, self._now)
        return SimpleNamespace(last_stop=self._now[0])

    async def describe(self) -> Any:
        await trio.lowlevel.checkpoint()
        return SimpleNamespace(last_stop=self._now[1])


def proof(*said: tuple[StopReport | None, StopReport | None]) -> StopReport | None:
    async def tell(text: str) -> None:
        raise AssertionError(text)

    drill: Any = Drill(Tree(*said), None, tell)  # type: ignore[arg-type]
    return trio.run(drill._report_of, BEGAN_NS, Reason.LINK, Reason.WIRE, clock=MockClock(autojump_threshold=0))


def test_the_root_may_give_it_as_well_as_the_gate() -> None:
    assert proof((None, None), (report(Reason.LINK), None)) == report(Reason.LINK)
    assert proof((None, None), (None, report(Reason.WIRE))) == report(Reason.WIRE)


def test_an_unconfirmed_report_counts_only_if_no_confirmed_one_follows() -> None:
    failed = report(Reason.LINK, confirmed=False)
    assert proof((failed, None), (failed, None), (failed, report(Reason.WIRE))) == report(Reason.WIRE)
    assert proof((failed, None)) == failed


def test_a_report_of_another_reason_or_an_earlier_stop_is_no_proof() -> None:
    before = report(Reason.WIRE, at_ns=BEGAN_NS - 1)
    assert proof((report(Reason.ROOT), before)) is None
    assert proof((before, report(Reason.ROOT)), (before, report(Reason.WIRE))) == report(Reason.WIRE)


# -- the clock of a link loss on a real port


class Hand:
    """A robot from which a person unplugs the cable and plugs it in again.

    Args:
        confirmed_s: When its safe state was confirmed, in seconds after the unplugging; None for never.
    """

    PULLED_S, BACK_S = 5.0, 8.0
    began_s = 0.0

    def __init__(self, confirmed_s: float | None) -> None:
        self.driver = FakeBase("fake_base", "hand", {})
        self._confirmed_s = confirmed_s

    @property
    def now_s(self) -> float:
        return trio.current_time() - self.began_s

    async def status(self) -> Any:
        await trio.lowlevel.checkpoint()
        is_out = self.PULLED_S <= self.now_s < self.BACK_S
        done_s = None if self._confirmed_s is None else self.PULLED_S + self._confirmed_s
        stop = None
        if done_s is not None and self.now_s >= done_s:
            stop = report(Reason.LINK, at_ns=round((self.began_s + done_s) * 1e9))
            stop = msgspec.structs.replace(stop, safe_state=self.driver.fallbacks[Reason.LINK])
        mode = "lost" if is_out else "disarmed"
        return SimpleNamespace(mode=mode, connected=not is_out, last_stop=stop)

    async def describe(self) -> Any:
        await trio.lowlevel.checkpoint()
        return SimpleNamespace(last_stop=None)


def link_loss(confirmed_s: float | None, monkeypatch: pytest.MonkeyPatch) -> StepResult:
    tree = Hand(confirmed_s)
    told: list[str] = []

    async def tell(text: str) -> None:
        told.append(text)

    @contextlib.asynccontextmanager
    async def writing(self: Drill) -> AsyncIterator[None]:
        yield

    async def run() -> StepResult:
        tree.began_s = trio.current_time()
        monkeypatch.setattr(steps, "monotonic_ns", lambda: round(trio.current_time() * 1e9))
        monkeypatch.setattr(Drill, "_writing", writing)
        return await Drill(tree, None, tell).link_loss()  # type: ignore[arg-type]

    result = trio.run(run, clock=MockClock(autojump_threshold=0))
    assert len(told) == 2
    return result


@pytest.mark.parametrize("confirmed_s", [0.01, 2.9, 3.1, 5.5])
def test_saf_023_the_clock_of_a_link_loss_begins_before_the_cable_is_out(
    confirmed_s: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    result = link_loss(confirmed_s, monkeypatch)
    assert result.passed, result.detail
    assert result.confirmed_ms is not None
    assert 0 <= result.confirmed_ms - confirmed_s * 1e3 <= 50, "within one look of the confirmation"
    away_ms = (Hand.BACK_S - Hand.PULLED_S) * 1e3
    assert 0 <= result.bound_ms - (away_ms + RETURN_S * 1e3) <= 100


def test_saf_023_the_bound_of_a_link_loss_can_be_missed(monkeypatch: pytest.MonkeyPatch) -> None:
    late = link_loss(Hand.BACK_S - Hand.PULLED_S + RETURN_S + 3.0, monkeypatch)
    assert not late.passed and "later than" in late.detail
    never = link_loss(None, monkeypatch)
    assert not never.passed and "no process reported a safe state" in never.detail


def test_saf_023_a_report_from_before_the_fault_is_no_proof() -> None:
    async def run() -> StepResult:
        async def tell(text: str) -> None:
            raise AssertionError(text)

        drill = Drill(Hand(None), None, tell)  # type: ignore[arg-type]
        early = report(Reason.LINK, at_ns=BEGAN_NS - 174_000_000)
        return await drill._judge("link loss", Reason.LINK, BEGAN_NS, 3.0, early, ())

    result = trio.run(run, clock=MockClock(autojump_threshold=0))
    assert not result.passed and result.detail == "the stop was reported 174 ms before the fault"
