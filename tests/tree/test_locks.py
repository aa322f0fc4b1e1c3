"""SAF-018: the lock of an e-stop is a file, by name and by port, and what cannot be read locks."""

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


def test_saf_018_a_lock_binds_its_name_on_any_port_and_its_port_under_any_name(tmp_path: Path) -> None:
    one = Locks(tmp_path / "locks", "so101", "/dev/ttyACM0")
    assert one.find() is None
    since = one.put("the button")
    lock = one.find()
    assert lock == ("the button", since)
    assert since.endswith("+00:00")
    assert by(Locks(tmp_path / "locks", "so101", "/dev/ttyACM1")) == "the button"
    assert by(Locks(tmp_path / "locks", "so101")) == "the button", "its twin"
    assert by(Locks(tmp_path / "locks", "arm", "/dev/ttyACM0")) == "the button"
    assert by(Locks(tmp_path / "locks", "arm", "/dev/ttyACM1")) == ""
    assert by(Locks(tmp_path / "locks", "arm")) == ""
    assert by(Locks(tmp_path / "locks", "so101-2")) == ""
    assert locked_robots(tmp_path / "locks") == ["so101"]
    Locks(tmp_path / "locks", "arm", "/dev/ttyACM0").lift()
    assert one.find() is None
    assert os.listdir(tmp_path / "locks") == []


def test_saf_018_a_port_is_the_device_and_not_the_path_to_it(tmp_path: Path) -> None:
    (tmp_path / "by-id").symlink_to("/dev/null")
    Locks(tmp_path / "locks", "so101", "/dev/null").put("the button")
    assert by(Locks(tmp_path / "locks", "arm", str(tmp_path / "by-id"))) == "the button"


def test_saf_018_an_address_is_the_same_from_any_directory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    one, other = tmp_path / "one", tmp_path / "other"
    one.mkdir()
    other.mkdir()
    (one / "port").symlink_to("/dev/null")
    monkeypatch.chdir(one)
    Locks(tmp_path / "locks", "left", "192.0.2.10").put("the button")
    Locks(tmp_path / "locks", "so101", "port").put("the button")
    monkeypatch.chdir(other)
    assert by(Locks(tmp_path / "locks", "right", "192.0.2.10")) == "the button"
    assert by(Locks(tmp_path / "locks", "right", "192.0.2.11")) == ""
    assert by(Locks(tmp_path / "locks", "arm", "/dev/null")) == "the button", "a path is a path all the same"


def test_saf_018_a_lock_of_a_twin_is_its_names_alone(tmp_path: Path) -> None:
    Locks(tmp_path, "so101").put("the button")
    assert by(Locks(tmp_path, "so101", "/dev/ttyACM0")) == "the button"
    assert by(Locks(tmp_path, "koch")) == ""


@pytest.mark.parametrize("content", [b"", b"{}", b"\xff\xfe", b'{"robot": 1}', b"[" * 5000])
def test_saf_018_a_lock_that_cannot_be_read_locks(tmp_path: Path, content: bytes) -> None:
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


def test_saf_018_a_directory_that_cannot_be_read_locks(tmp_path: Path) -> None:
    (tmp_path / "locks").write_text("no directory")
    assert by(Locks(tmp_path / "locks", "so101")).startswith(UNREADABLE)


@pytest.mark.parametrize("before", [False, True])
def test_saf_018_a_disk_that_fills_leaves_the_lock_of_before_whole(
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
    assert len(os.listdir(tmp_path)) == before, "no draft is left"


# -- in a tree


async def estop(tree: InlineTree) -> StopReport:
    report = await tree.gate.ask(ESTOP, 10.0)
    assert isinstance(report, StopReport)
    return report


async def armed(tree: InlineTree) -> None:
    await tree.gate.ask(Resume("the test"), 5.0)
    await tree.until("armed")


def test_saf_018_a_tree_begins_as_locked_as_the_last_one_ended(tmp_path: Path) -> None:
    """By whom, and since when; a resume lifts it for the next, too."""
    locks = Locks(tmp_path, "so101", "/dev/ttyACM0")

    async def main() -> None:
        async with open_inline_tree(clock=MonotonicClock(), locks=locks) as tree:
            await armed(tree)
            assert (await estop(tree)).note == ""
            assert by(locks) == "the button", "before it is reported"
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
    """What an fsync waits for."""
    go_on = threading.Event()
    sync = os.fsync

    def fsync(fd: int) -> None:
        assert go_on.wait(20.0)
        sync(fd)

    monkeypatch.setattr(os, "fsync", fsync)
    return go_on.set


def test_saf_018_the_safe_frame_waits_for_no_disk_and_the_report_does(
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
                await trio.sleep(0.1)  # what must not happen has no event to wait for
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


def test_saf_018_a_fence_keeps_its_lock_too(tmp_path: Path) -> None:
    locks = Locks(tmp_path, "so101")

    async def main() -> None:
        async with open_inline_tree(clock=MonotonicClock(), locks=locks) as tree:
            await armed(tree)
            report = await tree.guardian.ask(Fence(Reason.ESTOP, "the button", lock=True), 10.0)
            assert isinstance(report, StopReport)
            assert report.confirmed
            assert by(locks) == "the button"

    trio.run(main)


def test_saf_018_the_newest_wish_wins(tmp_path: Path) -> None:
    """Locked, resumed and locked again before the first is on the disk."""
    locks = Locks(tmp_path, "so101")

    async def main() -> None:
        keeper = LockKeeper(locks)
        async with trio.open_nursery() as nursery:
            nursery.start_soon(keeper.run)
            for wish in ("one", "", "two", "", "one"):
                keeper.want(wish)
                await trio.lowlevel.checkpoint()
            kept = await keeper.kept("one")
            assert by(locks) == "one"
            assert kept.problem == ""
            keeper.want("")
            await keeper.settle()
            assert by(locks) == ""
            nursery.cancel_scope.cancel()

    trio.run(main)


class Lifts(Locks):
    """Slowly."""

    def __init__(self, directory: Path) -> None:
        super().__init__(directory, "so101")
        self.begun, self.go_on = threading.Event(), threading.Event()

    def lift(self) -> None:
        self.begun.set()
        assert self.go_on.wait(20.0)
        super().lift()


def test_saf_018_a_lock_that_is_just_being_lifted_is_not_kept(tmp_path: Path) -> None:
    """Resumed, and locked again by the same while the file goes."""
    locks = Lifts(tmp_path)
    locks.put("one")

    async def main() -> None:
        keeper = LockKeeper(locks)
        async with trio.open_nursery() as nursery:
            nursery.start_soon(keeper.run)
            keeper.want("")
            await trio.to_thread.run_sync(locks.begun.wait)
            keeper.want("one")
            kept: list[str] = []

            async def wait() -> None:
                await keeper.kept("one")
                kept.append(by(locks))

            nursery.start_soon(wait)
            await trio.sleep(0.05)  # what must not happen has no event to wait for
            assert not kept
            locks.go_on.set()
            await keeper.settle()
            assert by(locks) == "one"
            await trio.testing.wait_all_tasks_blocked()
            assert kept == ["one"]
            nursery.cancel_scope.cancel()

    trio.run(main)


@pytest.mark.parametrize("fails", [(), ("A",), ("B",), ("A", "B")])
def test_saf_018_who_presses_first_is_not_told_that_a_lock_is_kept_before_one_is(
    tmp_path: Path, fails: tuple[str, ...]
) -> None:
    """Another presses while the lock of the first is being written."""

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
            keeper.want(by)
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
