"""Frozen, spinning, or starved: told apart in virtual time."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time

import pytest

from strands_actors.runtime.processor import Standing, standing
from strands_actors.runtime.silence import LONGEST_S, OWN_TICKS, Silence

MS = 1_000_000
TTL_S = 0.1
TICK_MS = 10


def lost_after_ms(computes: float, waits: float, ready: bool, tick_ms: int = TICK_MS, counted: bool = True) -> int:
    """When a peer that has fallen silent counts as lost, from the share of its time it computes and stands in
    line. ``counted``: the system counts waits as they go, not only once they are over."""
    now_ms = 0

    def look() -> Standing:
        waited = round(waits * now_ms * MS) if counted else 0
        return Standing(round(computes * now_ms * MS), waited, ready)

    silence = Silence(TTL_S, look)
    silence.heard(1)
    while now_ms < 10_000:
        now_ms += tick_ms
        if silence.tick(now_ms * MS + 1):
            return now_ms
    return now_ms


def test_a_stopped_process_is_lost_in_time() -> None:
    assert lost_after_ms(0.0, 0.0, ready=False) == 110


def test_a_spinning_process_is_lost_in_time() -> None:
    assert lost_after_ms(1.0, 0.0, ready=True) == 110


def test_what_it_stood_in_line_for_is_not_counted() -> None:
    assert lost_after_ms(0.0, 0.5, ready=False) == pytest.approx(160, abs=20)
    assert lost_after_ms(0.5, 0.5, ready=True) == pytest.approx(160, abs=20)


@pytest.mark.parametrize("counted", [True, False])
def test_a_starved_process_has_longer_and_not_for_ever(counted: bool) -> None:
    after_ms = lost_after_ms(0.0, 1.0, ready=True, counted=counted)
    assert LONGEST_S * 1e3 < after_ms <= LONGEST_S * 1e3 + TICK_MS


@pytest.mark.parametrize(
    ("computes", "waits", "says"),
    [
        (0.0, 0.0, "silent for 110 ms; in the last 50 it computed for 0 and stood in line for 0"),
        (1.0, 0.0, "silent for 110 ms; in the last 50 it computed for 50 and stood in line for 0"),
        (0.2, 0.8, "silent for 110 ms; in the last 50 it computed for 10 and stood in line for 40"),
    ],
)
def test_what_a_silent_process_did_is_told(computes: float, waits: float, says: str) -> None:
    now_ms = 0
    silence = Silence(TTL_S, lambda: Standing(round(computes * now_ms * MS), round(waits * now_ms * MS), False))
    silence.heard(1)
    for now_ms in range(10, 120, 10):
        silence.tick(now_ms * MS + 1)
    assert silence.told(now_ms * MS + 1) == says
    alone = Silence(TTL_S)
    alone.heard(1)
    assert alone.told(110 * MS + 1) == "silent for 110 ms"


def test_where_nobody_can_tell_silence_is_silence() -> None:
    silence = Silence(TTL_S)
    silence.heard(1)
    assert [silence.tick(ms * MS) for ms in range(10, 120, 10)] == [False] * 10 + [True]


def test_a_pause_of_our_own_is_not_the_peers() -> None:
    silence = Silence(TTL_S)
    silence.heard(1)
    assert [silence.tick((1000 + 10 * n) * MS) for n in range(OWN_TICKS)] == [False] * (OWN_TICKS - 1) + [True]


def test_a_word_begins_anew() -> None:
    looks: list[int] = []

    def look() -> Standing:
        looks.append(1)
        return Standing(0, 0, False)

    silence = Silence(TTL_S, look)
    assert not silence.tick(10_000 * MS)  # nobody has been heard yet: nobody can be lost
    for ms in range(10, 2000, 10):
        if ms % 40 == 0:
            silence.heard(ms * MS)
        assert not silence.tick(ms * MS)
    assert not looks, "a peer that answers is not looked at"


# -- the real thing


def test_a_sleeping_a_stopped_and_a_spinning_process() -> None:
    with subprocess.Popen([sys.executable, "-c", "import time; time.sleep(60)"]) as sleeper:
        before = settled(sleeper.pid, ready=False)
        time.sleep(0.2)
        after = settled(sleeper.pid, ready=False)
        sleeper.send_signal(signal.SIGSTOP)
        stopped = settled(sleeper.pid, ready=False)
        sleeper.kill()
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


def settled(pid: int, ready: bool) -> Standing:
    until_s = time.monotonic() + 10.0
    while (now := standing(pid)) is None or now.ready is not ready:
        assert time.monotonic() < until_s, now
        time.sleep(0.005)
    return now


def test_of_one_thread() -> None:
    here = standing(os.getpid(), threading.get_native_id())
    assert here is not None
    assert here.ready


def test_nobody_stands_where_there_is_no_process() -> None:
    with subprocess.Popen([sys.executable, "-c", ""]) as ended:
        ended.wait()
        assert standing(ended.pid) is None
