"""The failure detector tells frozen, spinning and starved processes apart. In virtual time."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time

import pytest

from strands_actors.kernel.health.failure_detector import LONGEST_S, FailureDetector
from strands_actors.kernel.health.processor import ProcessorUse, processor_use, suspected

MS = 1_000_000
TTL_S = 0.1
TICK_S = 0.01
TICK_MS = 10


def lost_after_ms(
    computes: float,
    waits: float,
    ready: bool,
    counted: bool = True,
    stopped: bool = False,
    stolen: tuple[float, ...] = (),
) -> int:
    """Return after how many ms a silent peer counts as lost.

    Args:
        computes: Share of the time in which the peer computes.
        waits: Share of the time in which it waits for a processor.
        ready: Whether it can run.
        counted: Whether the system counts a wait while it lasts, not only when it is over.
        stopped: Whether a signal has stopped it.
        stolen: Share of each processor's time that the hypervisor takes, counted in its steps.
    """
    now_ms = 0

    def look() -> ProcessorUse:
        waited = round(waits * now_ms * MS) if counted else 0
        taken = tuple(int(share * now_ms) // 10 * 10 * MS for share in stolen)
        return ProcessorUse(round(computes * now_ms * MS), waited, ready, stopped, taken)

    failure_detector = FailureDetector(TTL_S, TICK_S, look)
    failure_detector.note_heartbeat(1)
    while now_ms < 10_000:
        now_ms += TICK_MS
        if failure_detector.tick(now_ms * MS + 1):
            return now_ms
    return now_ms


def test_a_stopped_process_is_lost_in_time() -> None:
    assert lost_after_ms(0.0, 0.0, ready=False) == 110


def test_a_spinning_process_is_lost_in_time() -> None:
    assert lost_after_ms(1.0, 0.0, ready=True) == 110


def test_time_in_which_the_peer_waits_for_a_processor_is_not_counted() -> None:
    assert lost_after_ms(0.0, 0.5, ready=False) == pytest.approx(160, abs=20)
    assert lost_after_ms(0.5, 0.5, ready=True) == pytest.approx(160, abs=20)


@pytest.mark.parametrize("counted", [True, False])
def test_a_starved_process_gets_more_time_but_not_unlimited_time(counted: bool) -> None:
    after_ms = lost_after_ms(0.0, 1.0, ready=True, counted=counted)
    assert LONGEST_S * 1e3 < after_ms <= LONGEST_S * 1e3 + TICK_MS


def test_time_that_the_hypervisor_takes_from_a_processor_is_not_counted() -> None:
    """A thread that sleeps on that processor does not wake, but does not wait for a processor either."""
    assert lost_after_ms(0.0, 0.0, ready=False, stolen=(0.0, 0.0)) == 110
    assert lost_after_ms(0.0, 0.0, ready=False, stolen=(0.0, 0.5)) == pytest.approx(160, abs=20)
    assert lost_after_ms(0.0, 0.0, ready=False, stolen=(0.25, 0.25)) == pytest.approx(120, abs=10), (
        "the largest share counts, not the sum"
    )


def test_a_paused_virtual_machine_gets_no_unlimited_time() -> None:
    assert LONGEST_S * 1e3 < lost_after_ms(0.0, 0.0, ready=False, stolen=(1.0,)) <= LONGEST_S * 1e3 + TICK_MS


def test_a_stopped_process_is_lost_in_time_on_a_paused_virtual_machine() -> None:
    assert lost_after_ms(0.0, 0.5, ready=False, stopped=True, stolen=(1.0,)) == 110


@pytest.mark.parametrize(
    ("before", "after", "says"),
    [
        (ProcessorUse(0, 0, False), ProcessorUse(0, 0, False), "it computed for 0 and stood in line for 0"),
        (ProcessorUse(0, 0, True), ProcessorUse(50 * MS, 0, False), "it computed for 50 and stood in line for 0"),
        (
            ProcessorUse(0, 0, True),
            ProcessorUse(10 * MS, 40 * MS, False),
            "it computed for 10 and stood in line for 40",
        ),
        (
            ProcessorUse(0, 0, False, False, (70 * MS, 0)),
            ProcessorUse(0, 0, False, False, (90 * MS, 10 * MS)),
            "it computed for 0 and stood in line for 0; this virtual machine lost a processor for 20",
        ),
        (
            ProcessorUse(0, 0, False, False, (0,)),
            ProcessorUse(0, 0, False, True, (20 * MS,)),
            "it computed for 0 and stood in line for 0: it is stopped",
        ),
    ],
)
def test_the_description_of_a_silence_tells_what_the_process_did(
    before: ProcessorUse, after: ProcessorUse, says: str
) -> None:
    now_ms = 0
    failure_detector = FailureDetector(TTL_S, TICK_S, lambda: before if now_ms < 100 else after)
    failure_detector.note_heartbeat(1)
    for now_ms in range(10, 120, 10):
        failure_detector.tick(now_ms * MS + 1)
    assert failure_detector.describe_silence(now_ms * MS + 1) == f"silent for 110 ms; in the last 50 {says}"


def test_without_processor_data_only_the_silence_is_described() -> None:
    failure_detector = FailureDetector(TTL_S, TICK_S)
    failure_detector.note_heartbeat(1)
    for ms in range(10, 120, 10):
        failure_detector.tick(ms * MS + 1)
    assert failure_detector.describe_silence(110 * MS + 1) == "silent for 110 ms"


def test_without_processor_data_only_the_silence_counts() -> None:
    failure_detector = FailureDetector(TTL_S, TICK_S)
    failure_detector.note_heartbeat(1)
    assert [failure_detector.tick(ms * MS) for ms in range(10, 120, 10)] == [False] * 10 + [True]


def test_a_pause_of_this_process_does_not_count_for_the_peer() -> None:
    failure_detector = FailureDetector(TTL_S, TICK_S)
    failure_detector.note_heartbeat(1)
    assert [failure_detector.tick((1000 + 10 * n) * MS) for n in range(10)] == [False] * 9 + [True]


def test_a_late_tick_counts_for_no_more_than_its_period() -> None:
    """The ticks of this process are as late as those of the peer. Only as many ticks as its time to live
    has make it silent.
    """
    failure_detector = FailureDetector(TTL_S, TICK_S)
    failure_detector.note_heartbeat(1)
    assert [failure_detector.tick(17 * n * MS) for n in range(1, 11)] == [False] * 9 + [True]


def test_a_pause_of_the_machine_before_the_first_look_is_not_a_silence() -> None:
    """Observed on a robot with legs: the machine paused for 25 ms. Then the peer, which had waited for a
    processor meanwhile, computed for 17 of 25 ms before its heartbeat. The first look came too late to
    see that wait.
    """
    ms_computed = 0

    def look() -> ProcessorUse:
        return ProcessorUse(ms_computed * MS, 0, True)

    failure_detector = FailureDetector(0.02, 0.002, look)
    failure_detector.note_heartbeat(1)
    assert not failure_detector.tick(25 * MS)
    lost_at = []
    for ms in range(27, 61, 2):
        ms_computed = ms - 25
        lost_at += [ms] if failure_detector.tick(ms * MS) else []
    assert lost_at[0] == 43, "in ticks of this process the peer was silent for 22 ms, and it spins"


def test_a_heartbeat_restarts_the_time() -> None:
    looks: list[int] = []

    def look() -> ProcessorUse:
        looks.append(1)
        return ProcessorUse(0, 0, False)

    failure_detector = FailureDetector(TTL_S, TICK_S, look)
    assert not failure_detector.tick(10_000 * MS)  # no heartbeat has arrived yet, so no peer can be lost
    for ms in range(10, 2000, 10):
        if ms % 40 == 0:
            failure_detector.note_heartbeat(ms * MS)
        assert not failure_detector.tick(ms * MS)
    assert not looks, "a peer with heartbeats is not examined"


# # -- real processes


def test_a_sleeping_a_stopped_and_a_spinning_process() -> None:
    with subprocess.Popen([sys.executable, "-c", "import time; time.sleep(60)"]) as sleeper:
        before = settled(sleeper.pid, ready=False)
        time.sleep(0.2)
        after = settled(sleeper.pid, ready=False)
        sleeper.send_signal(signal.SIGSTOP)
        stopped = settled(sleeper.pid, ready=False, stopped=True)
        sleeper.kill()
    assert stopped.stopped and not after.stopped
    assert after.computed_ns - before.computed_ns < 100 * MS
    assert stopped.waited_ns - before.waited_ns < 100 * MS
    with subprocess.Popen([sys.executable, "-c", "while True: pass"]) as spinner:
        before = settled(spinner.pid, ready=True)
        began_ns = time.monotonic_ns()
        time.sleep(0.2)
        after = settled(spinner.pid, ready=True)
        passed_ns = time.monotonic_ns() - began_ns
        spinner.kill()
    assert after.computed_ns + after.waited_ns - before.computed_ns - before.waited_ns > passed_ns // 3


def settled(pid: int, ready: bool, stopped: bool = False) -> ProcessorUse:
    until_s = time.monotonic() + 10.0
    while (now := processor_use(pid)) is None or (now.ready, now.stopped) != (ready, stopped):
        assert time.monotonic() < until_s, now
        time.sleep(0.005)
    return now


def test_the_processor_use_of_one_thread() -> None:
    use = processor_use(os.getpid(), threading.get_native_id())
    assert use is not None
    assert use.ready


def test_a_suspected_process_is_reported_with_the_stolen_time_of_each_processor() -> None:
    """proc(5) gives it as the eighth number behind a processor's name, in hundredths of a second."""
    with open("/proc/stat") as stat:
        rows = [line.split() for line in stat if line.startswith("cpu") and line[3].isdigit()]
    seen = suspected(os.getpid())
    assert seen is not None and len(seen.stolen_ns) == len(rows) >= 1
    tick_ns = 10**9 // os.sysconf("SC_CLK_TCK")
    assert all(0 <= now - int(row[8]) * tick_ns < 10**9 for now, row in zip(seen.stolen_ns, rows, strict=True))


def test_a_process_that_has_ended_has_no_processor_use() -> None:
    with subprocess.Popen([sys.executable, "-c", ""]) as ended:
        ended.wait()
        assert processor_use(ended.pid) is None and suspected(ended.pid) is None
