"""The system has stopped the process of a writer. Its commands end before their lifetime."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time

import pytest
import trio

from strands_actors.kernel.health.processor import Life, _life, is_stopped, life_of
from strands_actors.supervisors.gate.messages import Acquire, Lease, Stopped
from strands_actors.supervisors.root.stopped_detector import LOOKS, StoppedDetector
from strands_actors.testing import InlineTree, open_inline_tree, run_virtual

from .writer import Writer, armed

MS = 1_000_000


def test_the_detector_needs_several_looks_in_a_row_and_reports_once() -> None:
    stopped: set[int] = set()
    stopped_detector = StoppedDetector(stopped.__contains__)
    assert stopped_detector.look([7, 8]) == []
    stopped.add(7)
    assert [stopped_detector.look([7, 8]) for _ in range(LOOKS + 2)] == [[]] * (LOOKS - 1) + [[7], [], []]


def test_a_profiler_s_short_stops_do_not_add_up() -> None:
    states = iter([True, True, False] * 10)
    stopped_detector = StoppedDetector(lambda _: next(states))
    assert all(stopped_detector.look([7]) == [] for _ in range(30))


def test_a_process_that_is_no_longer_a_writer_is_forgotten() -> None:
    stopped_detector = StoppedDetector(lambda _: True)
    for _ in range(LOOKS - 1):
        stopped_detector.look([7])
    assert stopped_detector.look([]) == []
    assert stopped_detector.look([7]) == []


def test_is_stopped_recognises_a_stopped_process() -> None:
    with subprocess.Popen([sys.executable, "-c", "import time; time.sleep(60)"]) as child:
        try:
            assert not is_stopped(child.pid)
            os.kill(child.pid, signal.SIGSTOP)
            deadline = time.monotonic() + 10
            while not is_stopped(child.pid):
                assert time.monotonic() < deadline
            os.kill(child.pid, signal.SIGCONT)
            while is_stopped(child.pid):
                assert time.monotonic() < deadline
        finally:
            child.kill()
    assert not is_stopped(child.pid), "an ended process is not stopped"


STAT = b"4711 (a name) with ) in it) %s 1 1 1 0 -1 %d " + b"0 " * 21 + b"%d " + b"0 " * 21


@pytest.mark.parametrize(
    ("stat", "life"),
    [
        (STAT % (b"S", 0x400000, 0), Life()),
        (STAT % (b"T", 0x400000, 0), Life(stopped=True)),
        (STAT % (b"R", 0x400000, 1 << signal.SIGKILL - 1), Life(dying=True)),
        (STAT % (b"R", 0x400000, 1 << signal.SIGUSR1 - 1), Life()),
        (STAT % (b"Z", 0x400004, 0), Life(dying=True)),
    ],
)
def test_a_killed_process_is_recognised_before_it_gets_a_processor_to_end_on(stat: bytes, life: Life) -> None:
    assert _life(stat) == life


def test_the_guardian_reports_a_killed_writer() -> None:
    async def run(child: subprocess.Popen[bytes]) -> None:
        async with open_inline_tree() as tree:
            reported: list[int] = []
            dying = trio.Event()

            def on_dying(pid: int) -> None:
                reported.append(pid)
                dying.set()

            tree.keeper._writers = lambda: [child.pid]
            tree.keeper._on_dying = on_dying
            await trio.sleep(0.1)
            assert reported == []
            child.kill()
            with trio.fail_after(100.0):
                await dying.wait()
            assert set(reported) == {child.pid}

    with subprocess.Popen([sys.executable, "-c", "import time; time.sleep(60)"]) as child:
        run_virtual(lambda: run(child))


def test_life_of_recognises_a_killed_process() -> None:
    child = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(60)"])
    assert life_of(child.pid) == Life()
    child.kill()
    deadline = time.monotonic() + 10
    while not life_of(child.pid).dying:
        assert time.monotonic() < deadline
    child.wait()
    assert life_of(child.pid) == Life(), "an ended process is neither stopped nor dying"


async def holding_pid(writer: Writer, pid: int, over: int = 0) -> Writer:
    answer = await writer.ref.ask(Acquire(writer.name, over, pid, again=writer.lease.id), 1.0)
    assert isinstance(answer, Lease), answer
    writer.lease = answer
    return writer


async def after_stop_of(tree: InlineTree, pid: int) -> tuple[str, str]:
    """Return mode and cause 5 ms after the gate has received the stop of a process. No lifetime has
    passed by then.
    """
    tree.gate.tell(Stopped(pid))
    await trio.sleep(0.005)
    status = await tree.status()
    return status.mode, status.cause


@pytest.mark.parametrize("latched", [True, False])
def test_saf_003_the_command_of_a_stopped_caller_is_held_at_once(latched: bool) -> None:
    async def run() -> None:
        async with open_inline_tree() as tree:
            writer = await holding_pid(await armed(tree), 77)
            await writer.send(latched=latched, a=5.0)
            assert await after_stop_of(tree, 78) == ("armed", ""), "the process of another program does not count"
            mode, cause = await after_stop_of(tree, 77)
            assert mode == "holding" and "the process of writer is stopped" in cause
            since_ns = tree.hardware.of("safe")[-1].t_ns
            await writer.send(latched=latched, a=6.0)  # the writer continues as before
            await trio.sleep(0.1)
            assert not tree.hardware.of("setpoint", since_ns)

    run_virtual(run)


def test_saf_003_a_stopped_policy_leads_to_a_hold_and_a_stopped_caller_without_a_command_does_not() -> None:
    async def run() -> None:
        async with open_inline_tree() as tree:
            caller = await holding_pid(await armed(tree), 77)
            assert await after_stop_of(tree, 77) == ("armed", ""), "the caller has sent no command"
            policy = Writer(tree, "policy")
            await holding_pid(policy, 88, over=caller.lease.id)
            await policy.send(a=5.0)
            mode, cause = await after_stop_of(tree, 88)
            assert mode == "holding" and "the process of policy is stopped" in cause

    run_virtual(run)
