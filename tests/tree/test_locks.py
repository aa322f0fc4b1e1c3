"""SAF-018: the lock of an e-stop is a file for the robot's name and its port. An unreadable lock file
counts as a lock.
"""

from __future__ import annotations

import errno
import os
import threading
import time
from collections.abc import Callable
from pathlib import Path

import pytest
import trio
import trio.lowlevel
import trio.testing

from strands_actors.contract.driver import Reason
from strands_actors.kernel.clock import MonotonicClock
from strands_actors.supervisors.gate.messages import Resume, Stop, StopReport
from strands_actors.supervisors.root.lock_keeper import LockKeeper
from strands_actors.supervisors.root.locks import UNREADABLE, Locks, locked_robots
from strands_actors.supervisors.root.messages import Fence
from strands_actors.testing import FakeHardware, InlineTree, open_inline_tree

ESTOP = Stop(Reason.ESTOP, "the button", lock=True)


def by(locks: Locks) -> str:
    lock = locks.find()
    return "" if lock is None else lock.by


def test_saf_018_a_lock_applies_to_its_name_on_any_port_and_to_its_port_under_any_name(tmp_path: Path) -> None:
    one = Locks(tmp_path / "locks", "so101", "/dev/ttyACM0")
    assert one.find() is None
    since = one.put("the button")
    lock = one.find()
    assert lock == ("the button", since)
    assert since.endswith("+00:00")
    assert by(Locks(tmp_path / "locks", "so101", "/dev/ttyACM1")) == "the button"
    assert by(Locks(tmp_path / "locks", "so101")) == "the button", "the lock applies to its twin"
    assert by(Locks(tmp_path / "locks", "arm", "/dev/ttyACM0")) == "the button"
    assert by(Locks(tmp_path / "locks", "arm", "/dev/ttyACM1")) == ""
    assert by(Locks(tmp_path / "locks", "arm")) == ""
    assert by(Locks(tmp_path / "locks", "so101-2")) == ""
    assert locked_robots(tmp_path / "locks") == ["so101"]
    Locks(tmp_path / "locks", "arm", "/dev/ttyACM0").lift()
    assert one.find() is None
    assert os.listdir(tmp_path / "locks") == []


def test_saf_018_a_port_is_identified_by_its_device_and_not_by_its_path(tmp_path: Path) -> None:
    (tmp_path / "by-id").symlink_to("/dev/null")
    Locks(tmp_path / "locks", "so101", "/dev/null").put("the button")
    assert by(Locks(tmp_path / "locks", "arm", str(tmp_path / "by-id"))) == "the button"


def test_saf_018_an_address_is_the_same_from_any_directory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    first, second = tmp_path / "first", tmp_path / "second"
    first.mkdir()
    second.mkdir()
    (first / "port").symlink_to("/dev/null")
    monkeypatch.chdir(first)
    Locks(tmp_path / "locks", "left", "192.0.2.10").put("the button")
    Locks(tmp_path / "locks", "so101", "port").put("the button")
    monkeypatch.chdir(second)
    assert by(Locks(tmp_path / "locks", "right", "192.0.2.10")) == "the button"
    assert by(Locks(tmp_path / "locks", "right", "192.0.2.11")) == ""
    assert by(Locks(tmp_path / "locks", "arm", "/dev/null")) == "the button", (
        "a relative path is resolved to its device"
    )


def test_saf_018_a_lock_of_a_twin_applies_to_its_name_only(tmp_path: Path) -> None:
    Locks(tmp_path, "so101").put("the button")
    assert by(Locks(tmp_path, "so101", "/dev/ttyACM0")) == "the button"
    assert by(Locks(tmp_path, "koch")) == ""


@pytest.mark.parametrize("content", [b"", b"{}", b"\xff\xfe", b'{"robot": 1}', b"[" * 5000])
def test_saf_018_an_unreadable_lock_file_locks(tmp_path: Path, content: bytes) -> None:
    locks = Locks(tmp_path, "so101", "/dev/ttyACM0")
    locks.put("the button")
    (file,) = tmp_path.iterdir()
    file.write_bytes(content)
    for bound in (locks, Locks(tmp_path, "so101"), Locks(tmp_path, "arm", "/dev/ttyACM0")):
        assert by(bound).startswith(UNREADABLE)
        assert str(file) in by(bound)
    assert by(Locks(tmp_path, "arm")) == ""
    locks.lift()
    assert locks.find() is None


def test_saf_018_an_unreadable_directory_locks(tmp_path: Path) -> None:
    (tmp_path / "locks").write_text("no directory")
    assert by(Locks(tmp_path / "locks", "so101")).startswith(UNREADABLE)


@pytest.mark.parametrize("before", [False, True])
def test_saf_018_a_full_disk_leaves_the_earlier_lock_unchanged(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, before: bool
) -> None:
    locks = Locks(tmp_path, "so101")
    if before:
        locks.put("the first")

    def full(fd: int) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OSError, match="No space left"):
        locks.put("the second")
    assert by(locks) == ("the first" if before else "")
    assert len(os.listdir(tmp_path)) == before, "no temporary file is left"


# -- in a tree


async def estop(tree: InlineTree) -> StopReport:
    report = await tree.gate.ask(ESTOP, 10.0)
    assert isinstance(report, StopReport)
    return report


async def armed(tree: InlineTree) -> None:
    await tree.gate.ask(Resume("the test"), 5.0)
    await tree.until("armed")


def test_saf_018_a_tree_starts_with_the_lock_of_the_last_one(tmp_path: Path) -> None:
    """It has the same person and time. A resume lifts it for the next tree, too."""
    locks = Locks(tmp_path, "so101", "/dev/ttyACM0")

    async def main() -> None:
        async with open_inline_tree(clock=MonotonicClock(), locks=locks) as tree:
            await armed(tree)
            assert (await estop(tree)).note == ""
            assert by(locks) == "the button", "the lock is on the disk before the report"
            since = (await tree.status()).locked_since
        hardware = FakeHardware()
        async with open_inline_tree(hardware, MonotonicClock(), locks=locks) as tree:
            status = await tree.status()
            assert (status.mode, status.locked_by) == ("disarmed", "the button")
            assert status.locked_since == since != ""
            assert not hardware.of("enable")
            await armed(tree)
            with trio.fail_after(5):
                while locks.find() is not None:  # noqa: ASYNC110
                    await trio.sleep(0.01)
            assert (await tree.status()).locked_since == ""
        async with open_inline_tree(clock=MonotonicClock(), locks=locks) as tree:
            assert (await tree.status()).locked_by == ""

    trio.run(main)


def slow_disk(monkeypatch: pytest.MonkeyPatch) -> Callable[[], None]:
    """Make each fsync wait. Return the function that lets it continue."""
    go_on = threading.Event()
    sync = os.fsync

    def fsync(fd: int) -> None:
        assert go_on.wait(20.0)
        sync(fd)

    monkeypatch.setattr(os, "fsync", fsync)
    return go_on.set


def test_saf_018_the_safe_frame_does_not_wait_for_the_disk_and_the_report_does(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    hardware = FakeHardware()
    reports: list[StopReport] = []

    async def main() -> None:
        async with open_inline_tree(hardware, MonotonicClock(), locks=Locks(tmp_path, "so101")) as tree:
            await armed(tree)
            began_ns = time.monotonic_ns()
            go_on = slow_disk(monkeypatch)

            async def press() -> None:
                reports.append(await estop(tree))

            async with trio.open_nursery() as nursery:
                nursery.start_soon(press)
                status = await tree.until("disarmed")
                assert hardware.of("safe", began_ns)
                assert status.locked_by == "the button"
                await trio.sleep(0.1)  # fixed time, because nothing must happen
                assert not reports
                go_on()
            assert reports[0].confirmed
            assert reports[0].note == ""

    trio.run(main)


def test_saf_018_a_disk_that_hangs_is_reported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    async def main() -> None:
        async with open_inline_tree(clock=MonotonicClock(), locks=Locks(tmp_path, "so101")) as tree:
            await armed(tree)
            go_on = slow_disk(monkeypatch)
            report = await estop(tree)
            go_on()
            assert report.confirmed
            assert "not on the disk" in report.note

    trio.run(main)


def test_saf_018_a_fence_writes_its_lock_too(tmp_path: Path) -> None:
    locks = Locks(tmp_path, "so101")

    async def main() -> None:
        async with open_inline_tree(clock=MonotonicClock(), locks=locks) as tree:
            await armed(tree)
            report = await tree.guardian.ask(Fence(Reason.ESTOP, "the button", lock=True), 10.0)
            assert isinstance(report, StopReport)
            assert report.confirmed
            assert by(locks) == "the button"

    trio.run(main)


def test_saf_018_the_newest_request_wins(tmp_path: Path) -> None:
    """Locked, resumed and locked again before the first lock is on the disk."""
    locks = Locks(tmp_path, "so101")

    async def main() -> None:
        keeper = LockKeeper(locks)
        async with trio.open_nursery() as nursery:
            nursery.start_soon(keeper.run)
            for request in ("one", "", "two", "", "one"):
                keeper.request(request)
                await trio.lowlevel.checkpoint()
            kept = await keeper.kept("one")
            assert by(locks) == "one"
            assert kept.problem == ""
            keeper.request("")
            await keeper.settle()
            assert by(locks) == ""
            nursery.cancel_scope.cancel()

    trio.run(main)


class Lifts(Locks):
    """Lift locks slowly."""

    def __init__(self, directory: Path) -> None:
        super().__init__(directory, "so101")
        self.begun, self.go_on = threading.Event(), threading.Event()

    def lift(self) -> None:
        self.begun.set()
        assert self.go_on.wait(20.0)
        super().lift()


def test_saf_018_a_lock_whose_file_is_being_deleted_is_not_kept(tmp_path: Path) -> None:
    """A resume deletes the file, and the same person locks again meanwhile."""
    locks = Lifts(tmp_path)
    locks.put("one")

    async def main() -> None:
        keeper = LockKeeper(locks)
        async with trio.open_nursery() as nursery:
            nursery.start_soon(keeper.run)
            keeper.request("")
            await trio.to_thread.run_sync(locks.begun.wait)
            keeper.request("one")
            kept: list[str] = []

            async def wait() -> None:
                await keeper.kept("one")
                kept.append(by(locks))

            nursery.start_soon(wait)
            await trio.sleep(0.05)  # fixed time, because nothing must happen
            assert not kept
            locks.go_on.set()
            await keeper.settle()
            assert by(locks) == "one"
            await trio.testing.wait_all_tasks_blocked()
            assert kept == ["one"]
            nursery.cancel_scope.cancel()

    trio.run(main)


@pytest.mark.parametrize("fails", [(), ("A",), ("B",), ("A", "B")])
def test_saf_018_the_first_press_is_not_answered_with_a_kept_lock_before_one_is_kept(
    tmp_path: Path, fails: tuple[str, ...]
) -> None:
    """Another person presses while the first lock is being written."""

    class Slow(Locks):
        def put(self, by: str) -> str:
            time.sleep(0.05)
            if by in fails:
                raise OSError(28, "No space left on device")
            return super().put(by)

    async def run() -> None:
        locks = Slow(tmp_path, "so101")
        keeper = LockKeeper(locks)

        async def press(by: str) -> None:
            keeper.request(by)
            kept = await keeper.kept(by)
            assert bool(kept.problem) == ("B" in fails)
            assert kept.problem or locks.find() is not None

        async with trio.open_nursery() as running:
            running.start_soon(keeper.run)
            async with trio.open_nursery() as nursery:
                nursery.start_soon(press, "A")
                await trio.sleep(0.01)
                nursery.start_soon(press, "B")
            running.cancel_scope.cancel()

    trio.run(run)
