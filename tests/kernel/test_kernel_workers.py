"""The kernel's worker threads get real-time priority where that is permitted, and no other kernel threads
do.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import pytest
import trio

from strands_actors.kernel.health import kernel_workers
from strands_actors.kernel.health.kernel_workers import LOOK_S, keep_them_early
from strands_actors.kernel.health.processor import _awaits_worker
from strands_actors.kernel.health.realtime import (
    KERNEL_PRIORITY,
    ROOT_PRIORITY,
    STANDBY_PRIORITY,
    TWIN_PRIORITY,
    WIRE_PRIORITY,
)

from .kernel import virtual_time

Raised = list[tuple[int, int, int]]


@pytest.fixture
def raised(monkeypatch: pytest.MonkeyPatch) -> Raised:
    calls: Raised = []
    monkeypatch.setattr(kernel_workers, "runs_first", lambda: True)
    monkeypatch.setattr(
        os, "sched_setscheduler", lambda pid, policy, param: calls.append((pid, policy, param.sched_priority))
    )
    return calls


@pytest.fixture
def kernel(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Callable[[dict[int, str]], None]:
    """Return a function that sets the kernel's threads, by number and name."""
    proc = tmp_path / "proc"
    monkeypatch.setattr(kernel_workers, "_PROC", proc)

    def set_threads(names: dict[int, str]) -> None:
        children = proc / "2/task/2/children"
        children.parent.mkdir(parents=True, exist_ok=True)
        children.write_text("".join(f"{number} " for number in names))
        for number, name in names.items():
            (proc / str(number)).mkdir(exist_ok=True)
            (proc / str(number) / "comm").write_text(f"{name}\n")

    return set_threads


@virtual_time
async def test_unbound_workers_get_priority_and_new_ones_are_found(
    raised: Raised, kernel: Callable[[dict[int, str]], None]
) -> None:
    kernel(
        {11: "ksoftirqd/0", 12: "kworker/u8:0-events_unbound", 13: "kworker/0:1-mm_percpu_wq", 14: "kworker/u9:2"}
    )
    with trio.move_on_after(2.5 * LOOK_S):
        async with trio.open_nursery() as nursery:
            nursery.start_soon(keep_them_early)
            await trio.sleep(LOOK_S / 2)
            assert sorted(raised) == [(pid, os.SCHED_FIFO, KERNEL_PRIORITY) for pid in (12, 14)]
            kernel({12: "kworker/u8:0", 15: "kworker/u8:3"})
    assert raised[2:] == [(15, os.SCHED_FIFO, KERNEL_PRIORITY)]


def test_kernel_workers_rank_below_processes_that_keep_a_robot_safe_and_above_twins() -> None:
    assert TWIN_PRIORITY < KERNEL_PRIORITY < WIRE_PRIORITY < ROOT_PRIORITY < STANDBY_PRIORITY


@virtual_time
async def test_a_process_without_the_permission_tries_once(
    monkeypatch: pytest.MonkeyPatch, raised: Raised, kernel: Callable[[dict[int, str]], None]
) -> None:
    def refuse(pid: int, policy: int, param: os.sched_param) -> None:
        raised.append((pid, policy, param.sched_priority))
        raise PermissionError

    monkeypatch.setattr(os, "sched_setscheduler", refuse)
    kernel({12: "kworker/u8:0", 14: "kworker/u8:1"})
    with trio.fail_after(LOOK_S / 2):
        await keep_them_early()
    assert len(raised) == 1


@virtual_time
async def test_without_visible_workers_or_without_real_time_priority_nothing_is_changed(
    monkeypatch: pytest.MonkeyPatch, raised: Raised, kernel: Callable[[dict[int, str]], None]
) -> None:
    with trio.move_on_after(LOOK_S / 10):
        await keep_them_early()  # the file does not exist
    kernel({12: "kworker/u8:0"})
    monkeypatch.setattr(kernel_workers, "runs_first", lambda: False)
    with trio.fail_after(LOOK_S / 2):
        await keep_them_early()
    assert raised == []


@pytest.mark.parametrize(
    ("function", "worker"), [("__flush_work", True), ("flush_work", True), ("usb_control_msg", False)]
)
def test_a_wait_for_a_kernel_worker_counts_as_waiting_and_a_wait_for_a_device_does_not(
    function: str, worker: bool, tmp_path: Path
) -> None:
    (tmp_path / "wchan").write_text(function)
    assert _awaits_worker(str(tmp_path)) is worker
