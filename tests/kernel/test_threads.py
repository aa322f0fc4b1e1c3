"""A call in a thread: its result, its exception, and a cancelled wait for it."""

from __future__ import annotations

import threading
import time

import pytest
import trio

from strands_actors.kernel.threads import call_in_thread

from .kernel import real_time, until


@real_time
async def test_a_call_returns_its_result_and_raises_its_exception() -> None:
    def add(first: int, second: int) -> tuple[int, int]:
        return first + second, threading.get_ident()

    value, thread = await call_in_thread(add, 1, 2)
    assert value == 3
    assert thread != threading.get_ident()
    with pytest.raises(ZeroDivisionError):
        await call_in_thread(divmod, 1, 0)


@real_time
async def test_the_loop_continues_during_a_call() -> None:
    over = threading.Event()
    async with trio.open_nursery() as nursery:
        nursery.start_soon(call_in_thread, over.wait, 20.0)
        await trio.sleep(0.01)
        over.set()


@real_time
async def test_many_calls_run_at_the_same_time() -> None:
    meeting = threading.Barrier(60)  # more than trio's own limiter lets in
    async with trio.open_nursery() as nursery:
        for _ in range(60):
            nursery.start_soon(call_in_thread, meeting.wait, 20.0)


@real_time
async def test_a_cancelled_wait_ends_at_once_and_the_call_is_ignored() -> None:
    over, ended = threading.Event(), threading.Event()

    def call() -> int:
        over.wait(20.0)
        ended.set()
        return 1

    began_s = time.monotonic()
    with trio.move_on_after(0.05) as scope:
        await call_in_thread(call)
    assert scope.cancelled_caught
    assert time.monotonic() - began_s < 10.0
    over.set()
    await until(ended.is_set)
    assert await call_in_thread(len, "next") == 4


@real_time
async def test_a_cancelled_task_starts_no_call() -> None:
    begun = threading.Event()
    with trio.CancelScope() as scope:
        scope.cancel()
        await call_in_thread(begun.set)
    assert scope.cancelled_caught
    await trio.sleep(0.02)
    assert not begun.is_set()


def test_a_call_that_outlives_its_loop_does_no_harm(capfd: pytest.CaptureFixture[str]) -> None:
    over, ended = threading.Event(), threading.Event()

    def call() -> None:
        over.wait(20.0)
        ended.set()

    async def run() -> None:
        with trio.move_on_after(0.01):
            await call_in_thread(call)

    trio.run(run)
    over.set()
    assert ended.wait(20.0)
    time.sleep(0.02)
    assert capfd.readouterr().err == ""
