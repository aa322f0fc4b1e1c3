"""Clocks: ticks keep to their grid and skip missed ones, exactly in virtual time and nearly in real time."""

from __future__ import annotations

import os
import time
from contextlib import aclosing

import pytest
import trio

from strands_actors.kernel import clock as clock_module
from strands_actors.kernel.clock import NS, Clock, MonotonicClock, VirtualClock

from .kernel import real_time, virtual_time

MS = 1_000_000


@pytest.fixture(params=["timerfd", "trio"])
def real_clock(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Clock:
    """Return the real clock, with timerfd as on Linux and without it as on other systems."""
    if request.param == "trio":
        monkeypatch.setattr(clock_module, "_timerfd", lambda period_s: None)
    return MonotonicClock()


@virtual_time
async def test_virtual_ticks_keep_to_their_grid() -> None:
    clock = VirtualClock()
    start_ns = clock.now_ns()
    seen: list[int] = []
    # The work after each tick: short, exactly one period, two and a half, and many.
    work_s = iter([0.001, 0.0, 0.01, 0.025, 0.0, 0.0, 0.1005, 0.0, 0.0])
    async with aclosing(clock.ticks(0.01)) as source:
        async for now_ns in source:
            seen.append(now_ns - start_ns)
            if (work := next(work_s, None)) is None:
                break
            await trio.sleep(work)
    assert [round(when / MS, 3) for when in seen] == [10, 20, 30, 40, 65, 70, 80, 180.5, 190, 200]


@virtual_time
async def test_virtual_ticks_do_not_drift() -> None:
    clock = VirtualClock()
    start_ns, count = clock.now_ns(), 0
    async with aclosing(clock.ticks(1 / 30)) as source:
        async for now_ns in source:
            count += 1
            assert now_ns - start_ns == pytest.approx(count * NS / 30, abs=1000)
            if count == 3000:
                break
            await trio.sleep(0.02)


@real_time
async def test_real_ticks_do_not_drift(real_clock: Clock) -> None:
    """Work after each tick is not added to the period."""
    seen: list[int] = []
    async with aclosing(real_clock.ticks(0.05)) as source:
        async for now_ns in source:
            seen.append(now_ns)
            if len(seen) == 25:
                break
            await trio.sleep(0.025)
    # 24 periods are 1.2 s. With the work added they would be 1.8 s. A busy machine may skip a few ticks.
    assert 1150 * MS <= seen[-1] - seen[0] < 1500 * MS


@real_time
async def test_missed_real_ticks_are_skipped(real_clock: Clock) -> None:
    seen: list[int] = []
    async with aclosing(real_clock.ticks(0.1)) as source:
        async for now_ns in source:
            seen.append(now_ns)
            if len(seen) == 1:
                time.sleep(0.52)  # noqa: ASYNC251  # the loop is blocked
            if len(seen) == 4:
                break
    assert seen[1] - seen[0] >= 520 * MS  # the tick that was due comes late
    assert seen[3] - seen[1] >= 50 * MS  # the missed ticks do not follow


@real_time
async def test_the_first_tick_comes_after_one_period(real_clock: Clock) -> None:
    start_ns = real_clock.now_ns()
    async with aclosing(real_clock.ticks(0.05)) as source:
        first_ns = await anext(source)
    assert 50 * MS <= first_ns - start_ns < 2000 * MS


@real_time
async def test_a_cancelled_ticker_frees_its_timer(real_clock: Clock) -> None:
    async def tick() -> None:
        async for _ in real_clock.ticks(10.0):
            pass

    before = len(os.listdir("/proc/self/fd"))
    async with trio.open_nursery() as nursery:
        for _ in range(5):
            nursery.start_soon(tick)
        await trio.testing.wait_all_tasks_blocked()
        nursery.cancel_scope.cancel()
    assert len(os.listdir("/proc/self/fd")) == before


@virtual_time
async def test_virtual_sleep_until() -> None:
    clock = VirtualClock()
    start_ns = clock.now_ns()
    await clock.sleep_until_ns(start_ns + 1500 * MS)
    assert clock.now_ns() - start_ns == pytest.approx(1500 * MS, abs=1000)
    await clock.sleep_until_ns(start_ns)
    assert clock.now_ns() - start_ns == pytest.approx(1500 * MS, abs=1000)


@real_time
async def test_real_sleep_until() -> None:
    clock = MonotonicClock()
    start_ns = clock.now_ns()
    await clock.sleep_until_ns(start_ns + 50 * MS)
    assert 50 * MS <= clock.now_ns() - start_ns < 2000 * MS
    with trio.fail_after(2):
        await clock.sleep_until_ns(start_ns)  # a time in the past returns at once


@real_time
async def test_other_processes_read_the_same_clock() -> None:
    before = time.clock_gettime_ns(time.CLOCK_MONOTONIC)
    now_ns = MonotonicClock().now_ns()
    assert before <= now_ns <= time.clock_gettime_ns(time.CLOCK_MONOTONIC)
