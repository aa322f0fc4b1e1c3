"""A ticker pauses while another source ticks for it, and starts again when that source stops."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

import pytest
import trio

from strands_actors.kernel.clock import NS, MonotonicClock, VirtualClock
from strands_actors.kernel.ticker import Ticker

from .kernel import real_time, virtual_time

PERIOD_S = 0.01


@asynccontextmanager
async def running(ticker: Ticker) -> AsyncIterator[list[float]]:
    """Run a ticker. Yield its tick times in milliseconds from now."""
    began_ns, seen = VirtualClock().now_ns(), []
    async with trio.open_nursery() as nursery:
        nursery.start_soon(ticker.run, lambda now_ns: seen.append(round((now_ns - began_ns) * 1e3 / NS, 3)))
        yield seen
        nursery.cancel_scope.cancel()


async def bring(ticker: Ticker, times: int, every_s: float) -> None:
    for _ in range(times):
        await trio.sleep(every_s)
        ticker.brought()


@virtual_time
async def test_the_ticker_ticks_by_itself_without_another_source() -> None:
    async with running(Ticker(VirtualClock(), PERIOD_S)) as seen:
        await trio.sleep(0.035)
    assert seen == [10, 20, 30]


@virtual_time
async def test_the_ticker_pauses_during_external_ticks_and_continues_after_them() -> None:
    ticker = Ticker(VirtualClock(), PERIOD_S)
    async with running(ticker) as seen:
        await trio.sleep(0.015)
        await bring(ticker, 100, 0.008)
        assert seen == [10, 20]  # the first external tick came at 23
        await trio.sleep(0.036)
    assert seen == [10, 20, 830, 840, 850]  # the last external tick came at 815


@virtual_time
@pytest.mark.parametrize("late_s", [0.0149, 0.0151, 0.03])
async def test_an_irregular_source_delays_a_tick_by_no_more_than_the_limit(late_s: float) -> None:
    ticker = Ticker(VirtualClock(), PERIOD_S)
    async with running(ticker) as seen:
        for _ in range(20):
            await bring(ticker, 5, PERIOD_S)
            await trio.sleep(late_s - PERIOD_S)  # the sixth tick is late
    silent = late_s > 0.015
    assert (len(seen) > 15) is silent, seen


@real_time
async def test_in_real_time_the_ticker_pauses_and_continues() -> None:
    ticker = Ticker(MonotonicClock(), 0.05)
    ticks: list[int] = []
    async with trio.open_nursery() as nursery:
        nursery.start_soon(ticker.run, ticks.append)
        began_s = trio.current_time()
        while trio.current_time() - began_s < 1.0:
            ticker.brought()
            await trio.sleep(0.005)
        brought = len(ticks)
        await trio.sleep(0.5)
        nursery.cancel_scope.cancel()
    assert brought <= 3  # one tick on a machine that pauses
    assert 5 <= len(ticks) - brought <= 10
