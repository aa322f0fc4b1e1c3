"""Test a stop channel in a separate process. Any fault of the SDK there leaves the root with an answer in time."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
from collections.abc import Awaitable, Callable
from pathlib import Path
from types import SimpleNamespace
from typing import ClassVar

import pytest
import trio

from strands_actors.contract import MotorReport, OwnProcess, SafeState, WireDown
from strands_actors.contract.stop_orders import Answer, Frames, StopChild
from strands_actors.kernel.clock import MonotonicClock
from strands_actors.kernel.health.realtime import may_run_first
from tests.answers import alive
from tests.contract.vendor import VendorConfig
from tests.kill.exhausted import GROUPED, Lacks, can_get_signals, leave_groups, take

AXES = ("a", "b")
PATIENCE_S = 20.0
ACKNOWLEDGE_S = 5.0


class Channel(OwnProcess[VendorConfig]):
    CHANNEL: ClassVar[str] = "tests.contract.vendor:VendorStopChannel"
    START_S: ClassVar[float] = PATIENCE_S  # for a busy machine
    ANSWER_S: ClassVar[float] = 1.0

    def failed(self, reason: str) -> tuple[MotorReport, ...]:
        return tuple(MotorReport(axis, at, False, False, False, reason) for at, axis in enumerate(self.config.axes))


class Patient(Channel):
    """A channel that does not count a child as frozen when it is late on a busy machine."""

    ACKNOWLEDGED_S: ClassVar[float] = PATIENCE_S


class Folder:
    """The files that order the SDK of ``vendor.py``, and its notes."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def tell(self, what: str) -> None:
        (self.path / what).touch()

    def notes(self, what: str) -> list[int]:
        """Return the pids of the processes that have noted it."""
        try:
            lines = (self.path / "notes").read_text().splitlines()
        except FileNotFoundError:
            return []
        return [int(pid) for pid, _, noted in (line.partition(" ") for line in lines) if noted == what]

    async def until(self, what: str, times: int = 1) -> None:
        with trio.fail_after(PATIENCE_S):
            while len(self.notes(what)) < times:  # noqa: ASYNC110  # another process writes them
                await trio.sleep(0.01)


async def gone(pid: int) -> None:
    with trio.fail_after(PATIENCE_S):
        while alive(pid):  # noqa: ASYNC110  # a process of a process
            await trio.sleep(0.01)


def with_channel(
    tmp_path: Path,
    test: Callable[[Channel, Folder], Awaitable[None]],
    descriptors: tuple[int, ...] = (),
    kind: type[Channel] = Channel,
) -> None:
    async def main() -> None:
        channel = kind(VendorConfig(str(tmp_path), AXES), descriptors, MonotonicClock())
        try:
            await test(channel, Folder(tmp_path))
        finally:
            channel.close()

    trio.run(main)


def test_the_sdks_report_is_the_answer_and_the_sdk_is_not_loaded_in_the_root(tmp_path: Path) -> None:
    reading, writing = os.pipe()

    async def test(channel: Channel, folder: Folder) -> None:
        reports = await channel.make_safe("land")
        assert [(report.axis, report.safe) for report in reports] == [("a", True), ("b", True)]
        assert os.read(reading, 100) == b"land", "the child received the descriptor"
        assert os.getpid() not in folder.notes("land")
        await channel.make_safe("off")
        assert len(folder.notes("began")) == 1, "one child answers all requests"

    with_channel(tmp_path, test, (writing,))
    os.close(reading)


def test_saf_003_it_runs_before_other_programs_where_that_is_granted(tmp_path: Path) -> None:
    """This process makes the robot safe when the wire process cannot. It must also run on a busy machine."""

    async def test(channel: Channel, folder: Folder) -> None:
        await channel.make_safe("stop")
        (pid,) = folder.notes("began")
        assert (os.sched_getscheduler(pid) == os.SCHED_FIFO) == (
            may_run_first() and len(os.sched_getaffinity(0)) > 1
        )

    with_channel(tmp_path, test)


@pytest.mark.parametrize("trouble", ["hang", "spin", "crash"])
def test_saf_003_an_sdk_that_does_not_answer_is_killed_and_another_one_stops_the_robot(
    tmp_path: Path, trouble: str
) -> None:
    async def test(channel: Channel, folder: Folder) -> None:
        folder.tell(trouble)
        reports = await channel.make_safe("stop")
        assert all(report.safe for report in reports)
        first, second = folder.notes("began")
        assert folder.notes("stop") == [second]
        assert not alive(first)

    with_channel(tmp_path, test)


@pytest.mark.long
def test_saf_005_an_sdk_that_always_hangs_is_reported_and_leaves_no_process(tmp_path: Path) -> None:
    async def test(channel: Channel, folder: Folder) -> None:
        folder.tell("hang-always")
        reports = await channel.make_safe("stop")
        assert [report.safe for report in reports] == [False, False]
        assert "did not answer within 1 s" in reports[0].detail
        assert len(folder.notes("hangs")) == 2
        for pid in folder.notes("began"):
            await gone(pid)
        (folder.path / "hang-always").unlink()
        assert all(report.safe for report in await channel.make_safe("stop")), "the next attempt starts a new child"

    with_channel(tmp_path, test)


def test_saf_010_the_answer_to_a_cancelled_order_answers_no_later_order(tmp_path: Path) -> None:
    async def test(channel: Channel, folder: Folder) -> None:
        folder.tell("slow")
        await cancelled(channel, folder, "slow")
        reports = await channel.make_safe("land")
        assert [report.detail for report in reports] == ["land", "land"]
        (only,) = folder.notes("began")
        assert folder.notes("land") == [only], "the same child lives and got the second order"
        assert not folder.notes("stop"), "the newer order cancelled the order without a waiter"

    with_channel(tmp_path, test)


def test_saf_010_an_sdk_that_hangs_in_a_cancelled_order_is_killed_by_the_next_order(tmp_path: Path) -> None:
    async def test(channel: Channel, folder: Folder) -> None:
        folder.tell("hang")
        await cancelled(channel, folder, "hangs")
        assert all(report.safe for report in await channel.make_safe("land"))
        first, second = folder.notes("began")
        assert folder.notes("land") == [second]
        assert not alive(first)

    with_channel(tmp_path, test)


async def cancelled(channel: Channel, folder: Folder, noted: str) -> None:
    """Send a stop, and cancel the call as soon as the child has noted ``noted``."""
    async with trio.open_nursery() as nursery:
        nursery.start_soon(channel.make_safe, "stop")
        await folder.until(noted)
        nursery.cancel_scope.cancel()


Served = Callable[[Channel, Folder, list[int]], Awaitable[None]]


def with_two_ready(tmp_path: Path, test: Served, kind: type[Channel] = Channel) -> None:
    """Run ``test`` with the pids of the two ready children. The channel asks the first of them first."""

    async def served(channel: Channel, folder: Folder) -> None:
        async with trio.open_nursery() as nursery:
            await nursery.start(channel.serve)
            assert channel.lacks == "" and set(channel.processes) == set(folder.notes("began"))
            await test(channel, folder, list(channel.processes))
            nursery.cancel_scope.cancel()

    with_channel(tmp_path, served, kind=kind)


async def until(condition: Callable[[], bool]) -> None:
    with trio.fail_after(PATIENCE_S):
        while not condition():  # noqa: ASYNC110  # other processes' doing
            await trio.sleep(0.005)


def test_saf_016_two_are_ready_before_the_link_counts_as_up_and_one_alone_carries_out_an_order(
    tmp_path: Path,
) -> None:
    async def test(channel: Channel, folder: Folder, ready: list[int]) -> None:
        assert len(ready) == 2
        for safe_state in ("hold", "stop"):
            assert all(report.safe for report in await channel.make_safe(safe_state))
            assert folder.notes(safe_state) == ready[:1]
        assert list(channel.processes) == ready, "both children still live"

    with_two_ready(tmp_path, test, Patient)


@pytest.mark.quick_cases(2)
@pytest.mark.parametrize("fault", ["freeze", "block", "kill"])
def test_saf_016_the_second_one_acts_at_once_when_the_first_is_dead_frozen_or_hangs(
    tmp_path: Path, fault: str
) -> None:
    async def test(channel: Channel, folder: Folder, ready: list[int]) -> None:
        first, second = ready
        if fault == "block":
            folder.tell(f"block {first}")
            await folder.until("blocks")
        else:
            os.kill(first, signal.SIGKILL if fault == "kill" else signal.SIGSTOP)
        assert all(report.safe for report in await channel.make_safe("stop"))
        assert folder.notes("stop") == [second], "the second child was ready, so no import delayed the stop"
        assert set(folder.notes("began")) == set(ready), "no further child was started"
        await gone(first)  # a frozen process that is continued writes nothing

    with_two_ready(tmp_path, test)


def test_saf_016_an_order_that_was_cancelled_and_not_acknowledged_is_given_to_the_second_one(
    tmp_path: Path,
) -> None:
    """A guardian sends one order before the fence and another after it."""

    async def test(channel: Channel, folder: Folder, ready: list[int]) -> None:
        first, second = ready
        folder.tell(f"block {first}")
        await folder.until("blocks")
        with trio.CancelScope() as before_the_fence:
            before_the_fence.cancel()  # the order leaves before the first wait
            await channel.make_safe("hold")
        assert all(report.safe for report in await channel.make_safe("stop"))
        assert folder.notes("stop") == [second]
        # If the first child does not answer a check, the second one may get "hold", too, but before "stop".
        assert folder.notes("hold") in ([], [second])
        assert (folder.path / "notes").read_text().endswith(f"{second} stop\n")

    with_two_ready(tmp_path, test)


def test_saf_016_a_child_that_answered_the_last_check_is_not_silent() -> None:
    """The answer of a child waits in the socket until the next check. A stop comes before that check, and is
    answered after it."""

    class Late(MonotonicClock):
        ahead_ns = 0

        def now_ns(self) -> int:
            return super().now_ns() + self.ahead_ns

    async def main() -> None:
        ours, theirs = socket.socketpair()
        clock = Late()
        with ours, theirs:
            answers = Frames(theirs)
            child = StopChild(SimpleNamespace(pid=os.getpid(), socket=ours), "test:Channel", clock)  # type: ignore[arg-type]
            look = child.send(None)
            answers.send(Answer(look))
            clock.ahead_ns = round(10 * ACKNOWLEDGE_S * 1e9)
            order = child.send(SafeState.LAND)

            async def acknowledge() -> None:
                await trio.sleep(0.01)
                answers.send(Answer(order))

            async with trio.open_nursery() as nursery:
                nursery.start_soon(acknowledge)
                assert await child.acknowledges(order, ACKNOWLEDGE_S)

    trio.run(main)


def test_saf_016_when_the_first_is_dead_and_the_second_frozen_another_one_acts(tmp_path: Path) -> None:
    """The channel waits for the last child only if that child runs. Here it would wait for ever."""

    class Endless(Channel):
        ANSWER_S: ClassVar[float] = 3600.0

    async def test(channel: Channel, folder: Folder, ready: list[int]) -> None:
        first, second = ready
        os.kill(second, signal.SIGSTOP)
        os.kill(first, signal.SIGKILL)
        with trio.fail_after(PATIENCE_S):
            assert all(report.safe for report in await channel.make_safe("stop"))
        (acted,) = folder.notes("stop")
        assert acted not in ready

    with_two_ready(tmp_path, test, Endless)


@pytest.mark.quick_cases(1)
@pytest.mark.parametrize("fault", ["block", "freeze", "kill"])
def test_saf_016_a_lost_idle_child_is_replaced(tmp_path: Path, fault: str) -> None:
    async def test(channel: Channel, folder: Folder, ready: list[int]) -> None:
        for pid in ready:
            if fault == "block":
                folder.tell(f"block {pid}")
            else:
                os.kill(pid, signal.SIGKILL if fault == "kill" else signal.SIGSTOP)
        await until(lambda: bool(channel.lacks))
        assert "no process of VendorStopChannel is ready to stop the robot" in channel.lacks
        await until(lambda: len(channel.processes) == 2)
        assert channel.lacks == "" and not set(channel.processes) & set(ready)
        for pid in ready:
            await gone(pid)
        assert all(report.safe for report in await channel.make_safe("stop"))

    with_two_ready(tmp_path, test)


ENDS = (Lacks.TABLE, Lacks.FILES)
"""Without these a child cannot connect. It ends because it knows so, and not because it is late."""
OTHERS = (Lacks.MEMORY, Lacks.THREADS, Lacks.DISK, Lacks.CPU, *GROUPED)


@pytest.mark.quick_cases(len(ENDS))
@pytest.mark.parametrize("lacks", [*ENDS, Lacks.LEAK, *OTHERS])
def test_saf_024_a_child_that_lacks_a_resource_acts_itself_or_ends_and_the_other_one_acts(
    tmp_path: Path, lacks: Lacks, capfd: pytest.CaptureFixture[str]
) -> None:
    async def test(channel: Channel, folder: Folder, ready: list[int]) -> None:
        folder.tell("connect")
        first, second = ready
        take(lacks, first)
        reports = await channel.make_safe("land")
        assert all(report.safe for report in reports), reports
        (acted,) = folder.notes("land")
        assert acted in ready, "no further child was needed"
        if lacks in ENDS:
            assert acted == second
            assert f"process {first} ended in a stop: no file can be opened" in capfd.readouterr().err
        if lacks is Lacks.LEAK:
            assert acted == first, "it connects with its reserve"
        if acted == second:
            await gone(first)

    try:
        with can_get_signals():
            with_two_ready(tmp_path, test, Channel if lacks in OTHERS else Patient)
    finally:
        leave_groups()


def test_saf_016_while_both_children_are_replaced_an_order_waits_for_the_next_one(tmp_path: Path) -> None:
    async def test(channel: Channel, folder: Folder, ready: list[int]) -> None:
        for pid in ready:
            os.kill(pid, signal.SIGKILL)
        await until(lambda: not channel.processes)
        assert all(report.safe for report in await channel.make_safe("stop"))
        (acted,) = folder.notes("stop")
        assert acted not in ready

    with_two_ready(tmp_path, test)


def test_a_robot_that_the_child_cannot_reach_is_reported(tmp_path: Path) -> None:
    async def test(channel: Channel, folder: Folder) -> None:
        folder.tell("unreachable")
        with pytest.raises(WireDown, match="no route to the robot"):
            await channel.serve()
        reports = await channel.make_safe("stop")
        assert not reports[0].safe and reports[0].detail == "no route to the robot"

    with_channel(tmp_path, test)


@pytest.mark.long
def test_saf_005_an_sdk_that_hangs_while_loading_leaves_no_process(tmp_path: Path) -> None:
    class Impatient(Channel):
        START_S: ClassVar[float] = 3.0

    async def main() -> None:
        folder = Folder(tmp_path)
        folder.tell("hang-at-start")
        channel = Impatient(VendorConfig(str(tmp_path), AXES), (), MonotonicClock())
        reports = await channel.make_safe("stop")
        assert "did not answer within 3 s" in reports[0].detail
        for pid in folder.notes("began"):
            await gone(pid)
        channel.close()

    trio.run(main)


def test_a_closed_channel_ends_its_child(tmp_path: Path) -> None:
    async def test(channel: Channel, folder: Folder) -> None:
        await channel.make_safe("stop")
        (pid,) = folder.notes("began")
        channel.close()
        await gone(pid)

    with_channel(tmp_path, test)


ROOT = """
import sys, trio
from strands_actors.kernel.clock import MonotonicClock
from tests.contract.test_stop_process import Channel
from tests.contract.vendor import VendorConfig
Channel.ANSWER_S = 3600.0
trio.run(Channel(VendorConfig(sys.argv[1], ("a",)), (), MonotonicClock()).make_safe, "stop")
"""


@pytest.mark.parametrize("trouble", ["hang", "spin"])
def test_saf_003_a_hanging_sdk_ends_with_its_root(tmp_path: Path, trouble: str) -> None:
    folder = Folder(tmp_path)
    folder.tell(trouble)
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(path for path in sys.path if path)}
    root = subprocess.Popen([sys.executable, "-c", ROOT, str(tmp_path)], env=environment)
    try:
        trio.run(folder.until, "hangs" if trouble == "hang" else "spins")
    finally:
        root.kill()
        root.wait()
    trio.run(gone, *folder.notes("began"))
