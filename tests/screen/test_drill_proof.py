"""Which report a step of a drill takes for its proof: one for its own reason, confirmed, by whoever
made safe."""

from __future__ import annotations

from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any

import trio
from trio.testing import MockClock

from strands_actors.contract.driver import Reason
from strands_actors.supervisors.gate.messages import StopReport
from strands_actors.surfaces.drill.steps import Drill

BEGAN_NS = 1000


def report(reason: Reason, confirmed: bool = True, at_ns: int = BEGAN_NS + 1) -> StopReport:
    return StopReport(reason, "stop", 1, confirmed, (), at_ns=at_ns)


class Tree:
    """Says in turn what was last reported by the gate and by the root; then the last of it for
    ever."""

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


def test_what_is_not_confirmed_is_waited_beyond_and_told_if_nothing_better_comes() -> None:
    failed = report(Reason.LINK, confirmed=False)
    assert proof((failed, None), (failed, None), (failed, report(Reason.WIRE))) == report(Reason.WIRE)
    assert proof((failed, None)) == failed


def test_another_reason_or_an_earlier_stop_is_none() -> None:
    before = report(Reason.WIRE, at_ns=BEGAN_NS - 1)
    assert proof((report(Reason.ROOT), before)) is None
    assert proof((before, report(Reason.ROOT)), (before, report(Reason.WIRE))) == report(Reason.WIRE)
