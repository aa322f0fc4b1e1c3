"""Real child processes: how they start and exchange messages, and how the parent learns of each kind of end."""

from __future__ import annotations

import fcntl
import os
import re
import signal
import socket
import subprocess
import sys
import time
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress
from pathlib import Path
from typing import Any

import pytest
import trio

from strands_actors.kernel.channels.link import BACKLOG_BYTES, Link
from strands_actors.kernel.clock import MonotonicClock
from strands_actors.kernel.node import AskTimeout, Node, Ref, Unreachable
from strands_actors.kernel.processes import process as process_module
from strands_actors.kernel.processes.interpreter import environment
from strands_actors.kernel.processes.process import ChildProcess, start, wait_for_end_of

from . import children
from .children import ECHO, Ask, Echo, Give, Told
from .kernel import PATIENCE_S, real_time, until


@asynccontextmanager
async def child(entry: str, **args: object) -> AsyncIterator[ChildProcess]:
    process = start(f"{children.__name__}:{entry}", args)
    try:
        yield process
    finally:
        await process.fence()
        process.socket.close()


@asynccontextmanager
async def linked() -> AsyncIterator[tuple[ChildProcess, Ref, Link, Node]]:
    """Start a child with an echo actor. Yield a reference to the actor when it answers."""
    node = Node("parent", MonotonicClock())
    async with child("echo") as process, trio.open_nursery() as nursery:
        link = process.link(node)
        await nursery.start(node.run)
        await nursery.start(link.run)
        ref = node.ref(ECHO, Echo)
        with trio.fail_after(PATIENCE_S):
            while True:
                with suppress(Unreachable):
                    await ref.ask(Ask(""), PATIENCE_S)
                    break
                await trio.sleep(0.002)
        yield process, ref, link, node
        nursery.cancel_scope.cancel()


async def read_all(fd: int) -> bytes:
    data = b""
    while True:
        await trio.lowlevel.wait_readable(fd)
        if not (piece := os.read(fd, 100)):
            return data
        data += piece


# -- start and talk


@real_time
async def test_a_child_answers_over_its_link() -> None:
    async with linked() as (process, ref, _, _):
        answer = await ref.ask(Ask("hello"), 5.0)
        assert answer == Told("hello", process.pid)
        assert process.alive
        assert process.pid != os.getpid()


@real_time
async def test_descriptors_arrive_usable() -> None:
    async with linked() as (process, ref, _, _):
        read, write = os.pipe()
        answer = await ref.ask(Give((write, write), "hello"), 5.0)
        os.close(write)
        assert answer == Told("hello", process.pid)
        assert await read_all(read) == b"hellohello"  # both copies are closed in the child, too
        os.close(read)


@real_time
async def test_descriptors_are_inherited_only_when_they_are_passed() -> None:
    read, write = os.pipe()
    fd = fcntl.fcntl(write, fcntl.F_DUPFD, 200)  # a number that is free in the child
    os.close(write)
    args = {"fds": [fd], "word": "hello", "nested": {"a": [1, 2]}}
    process = start(f"{children.__name__}:speaks", args, pass_fds=[fd])
    assert await process.wait() == 0
    assert process.socket.recv(100) == b"hello True 1 [1, 2]"  # True: the child has its own process group
    process.socket.close()
    assert os.get_inheritable(fd)
    async with child("speaks", **args) as process:
        assert await process.wait() == 1
    os.close(fd)
    os.close(read)


# -- ends


@pytest.mark.parametrize(
    ("args", "code"),
    [
        ({"how": "return"}, 0),
        ({"how": "raise"}, 1),
        ({"how": "exit", "code": 0}, 0),
        ({"how": "exit", "code": 7}, 7),
        ({"how": "exit", "code": None}, 0),
        ({"how": "exit", "code": "no fuse"}, 1),
        ({"how": "return", "deaf": True}, 0),
        ({"how": "exit", "code": 7, "deaf": True}, 7),
        ({"how": "exit in a task", "code": 7}, 7),
        ({"how": "raise in a task"}, 1),
    ],
    ids=str,
)
@real_time
async def test_a_child_ends_with_its_code_even_if_threads_still_run(
    args: dict[str, object], code: int, capfd: pytest.CaptureFixture[str]
) -> None:
    async with child("ends", **args) as process:
        with trio.fail_after(PATIENCE_S):
            assert await process.wait() == code
        assert await process.wait() == code
        assert not process.alive
    errors = capfd.readouterr().err
    assert ("RuntimeError: a fault of the child" in errors) is str(args["how"]).startswith("raise")
    assert ("no fuse" in errors) is (args.get("code") == "no fuse")


@real_time
async def test_a_failing_child_prints_its_traceback_without_source_lines(capfd: pytest.CaptureFixture[str]) -> None:
    async with child("ends", how="raise in a task") as process:
        with trio.fail_after(PATIENCE_S):
            assert await process.wait() == 1
    errors = capfd.readouterr().err
    assert re.search(r'File ".*/children.py", line \d+, in _fails\n +RuntimeError: a fault of the child', errors)
    assert "ExceptionGroup: Exceptions from Trio nursery" in errors
    assert "start_soon(" not in errors and 'raise RuntimeError("' not in errors
    assert "KeyError" not in errors  # because it is raised ``from None``


@real_time
async def test_the_standard_output_of_a_child_is_not_redirected(capfd: pytest.CaptureFixture[str]) -> None:
    async with child("prints") as process:
        with trio.fail_after(PATIENCE_S):
            assert await process.wait() == -signal.SIGKILL
    assert capfd.readouterr() == ("", "by Python\nby C\n")


@pytest.mark.parametrize("entry", [f"{children.__name__}:none", "there.is.none:main"])
@real_time
async def test_an_entry_that_does_not_exist_ends_with_code_one(
    entry: str, capfd: pytest.CaptureFixture[str]
) -> None:
    process = start(entry, {})
    assert await process.wait() == 1
    process.socket.close()
    assert "Error: " in capfd.readouterr().err


@pytest.mark.parametrize("sig", [signal.SIGKILL, signal.SIGTERM, signal.SIGINT])
@real_time
async def test_a_signal_ends_the_child_and_the_parent_learns_it_at_once(sig: signal.Signals) -> None:
    async with linked() as (process, _, link, _):
        killed_at = trio.current_time()
        process.kill(sig)
        assert await process.wait() == -sig
        seen_s = trio.current_time() - killed_at
        assert seen_s < 0.5
        assert not process.alive
        process.kill()  # harmless
        await until(lambda: link.closed)


@real_time
async def test_every_waiting_task_gets_the_end() -> None:
    async with linked() as (process, _, _, _):
        codes: list[int] = []

        async def wait() -> None:
            codes.append(await process.wait())

        async with trio.open_nursery() as nursery:
            for _ in range(3):
                nursery.start_soon(wait)
            nursery.start_soon(wait_for_end_of, process.pid)
            await trio.testing.wait_all_tasks_blocked()
            process.kill()
        assert codes == [-9, -9, -9]
        await wait_for_end_of(process.pid)  # returns at once, because the process has ended


@real_time
async def test_a_fence_ends_even_a_frozen_child_and_waits_for_it() -> None:
    async with linked() as (process, _, _, _):
        process.kill(signal.SIGSTOP)
        with trio.CancelScope() as scope:
            scope.cancel()
            await process.fence()  # even if the fencing task is cancelled
        assert not process.alive
        assert await process.wait() == -signal.SIGKILL


@real_time
async def test_a_child_that_is_dropped_before_its_end_leaves_no_zombie() -> None:
    async with linked() as (process, _, _, _):
        await process.drop(within_s=0.0)
        await until(lambda: not os.path.exists(f"/proc/{process.pid}"))


@real_time
async def test_a_child_is_awaited_without_pidfd_open_too(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """macOS has no ``pidfd_open``."""
    monkeypatch.delattr(os, "pidfd_open")
    async with linked() as (process, _, _, _):
        process.kill()
        assert await process.wait() == -9


@real_time
async def test_a_child_ends_when_its_parent_ends() -> None:
    async with child("family") as parent:
        grandchild = int(parent.socket.recv(100))
        assert os.getpgid(grandchild) == grandchild
        parent.kill()
        with trio.fail_after(PATIENCE_S):
            await wait_for_end_of(grandchild)


@real_time
async def test_an_interrupt_of_the_terminal_reaches_only_the_parent() -> None:
    async with child("family") as parent:
        grandchild = int(parent.socket.recv(100))
        fd = os.pidfd_open(grandchild)
        try:
            os.killpg(parent.pid, signal.SIGINT)
            with trio.fail_after(PATIENCE_S):
                await trio.lowlevel.wait_readable(parent.socket)
            assert parent.socket.recv(100) == b"interrupted"
            assert parent.alive
            with trio.move_on_after(0.2) as scope:
                await trio.lowlevel.wait_readable(fd)
            assert scope.cancelled_caught  # the grandchild still runs
        finally:
            os.close(fd)


# # -- a frozen peer


@real_time
async def test_a_frozen_child_costs_neither_time_nor_memory() -> None:
    async with linked() as (process, ref, link, _):
        process.kill(signal.SIGSTOP)
        text = "x" * 1000
        slowest_s, sent = 0.0, 3000
        for _ in range(sent):
            before = time.monotonic()
            ref.tell(Ask(text))
            slowest_s = max(slowest_s, time.monotonic() - before)
        assert slowest_s < 0.5
        assert 0 < link.dropped < sent
        assert link._backlog_bytes <= BACKLOG_BYTES
        with pytest.raises(AskTimeout):
            await ref.ask(Ask("anybody?"), 0.05)
        dropped = link.dropped
        process.kill(signal.SIGCONT)
        answer = None
        with trio.fail_after(PATIENCE_S):
            while answer is None:  # the backlog is sent first, and more messages are dropped until then
                with suppress(AskTimeout):
                    answer = await ref.ask(Ask("hello"), 0.5)
        assert answer == Told("hello", process.pid)
        assert dropped <= link.dropped <= dropped + 20


@real_time
async def test_saf_003_the_end_is_reported_before_the_child_is_reaped_in_another_thread(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """To reap a process may take the kernel long. A root with real-time priority makes the robot safe
    without waiting for it.
    """
    monkeypatch.setattr(process_module, "runs_first", lambda: True)
    async with child("echo") as process:
        process.kill()
        assert await process.wait() == -signal.SIGKILL
        assert state_of(process.pid) == "Z"
        assert not process.alive
        process.kill()  # harmless
        await until(lambda: state_of(process.pid) == "")


def state_of(pid: int) -> str:
    """Return the process's state letter in /proc, or "" if the process does not exist."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(") ")[2][:1]
    except (FileNotFoundError, ProcessLookupError):
        return ""


def test_a_child_imports_nothing_from_the_current_directory(tmp_path: Path) -> None:
    """Otherwise any user with write access there could run code in the processes of a robot."""
    (tmp_path / "msgspec.py").write_text("open('ran', 'w')\nraise SystemExit(3)\n")
    (tmp_path / "elsewhere").mkdir()
    script = tmp_path / "elsewhere" / "script.py"
    script.write_text(
        "from strands_actors.kernel.processes.process import start\n"
        "import trio\n"
        "child = start('tests.kernel.test_process:do_nothing', {})\n"
        "print(trio.run(child.wait))\n"
    )
    done = subprocess.run(
        [sys.executable, str(script)], cwd=tmp_path, env=environment(), capture_output=True, text=True, check=True
    )
    assert done.stdout == "0\n", done.stderr
    assert not (tmp_path / "ran").exists()


def do_nothing(args: dict[str, Any], sock: socket.socket) -> None:
    """Do nothing, as the entry of a child."""


def test_a_child_is_forgotten_at_the_end_of_the_interpreter(monkeypatch: pytest.MonkeyPatch) -> None:
    """The modules of the standard library may then be gone."""

    class Ended(ChildProcess):
        alive = False

        async def wait(self) -> int:
            return 0

    pidfd = os.pidfd_open(os.getpid())
    ours, theirs = socket.socketpair()
    with ours, theirs:
        child = Ended(os.getpid(), ours, pidfd)
        monkeypatch.setattr(process_module, "os", None)
        child.__del__()
        with pytest.raises(OSError):
            fcntl.fcntl(pidfd, fcntl.F_GETFD)
        child._pidfd = None
