"""Whether the thread that commands still answers, from what it computes and when it calls."""

from __future__ import annotations

import subprocess
import sys
import threading
import time

import pytest

from strands_actors.caller.session.liveness import Liveness
from strands_actors.kernel.health.processor import Standing


def spin(for_s: float) -> None:
    until_s = time.thread_time() + for_s
    while time.thread_time() < until_s:
        pass


def test_a_thread_that_waits_answers_now() -> None:
    liveness = Liveness()
    liveness.look()
    time.sleep(0.1)
    alive, answered_ago_s = liveness.look()
    assert alive
    assert 0.0 <= answered_ago_s < 0.05


def test_a_thread_that_only_computes_does_not() -> None:
    liveness = Liveness()
    liveness.look()
    spin(0.1)
    assert liveness.look() == (True, -1.0)


def test_a_thread_that_called_and_then_computes_answered_when_it_called() -> None:
    liveness = Liveness()
    liveness.look()
    liveness.enter()
    liveness.leave()
    called_s = time.monotonic()
    spin(0.1)
    alive, answered_ago_s = liveness.look()
    assert alive
    assert 0.1 <= answered_ago_s <= time.monotonic() - called_s + 0.01
    spin(0.1)
    assert liveness.look() == (True, -1.0)


def test_a_thread_inside_a_verb_answers() -> None:
    """It waits for us; what the interpreter does for it meanwhile is not its own."""
    liveness = Liveness()
    liveness.look()
    liveness.enter()
    spin(0.1)
    assert liveness.look() == (True, 0.0)


def test_a_thread_that_could_not_compute_because_we_stood_in_line_with_the_lock_did_not_sleep(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """On a machine whose processors are taken: the thread that spins waits for the interpreter's
    lock, which looks like sleep, and we, who have it, wait for a processor."""
    began_ns = time.monotonic_ns()
    own = threading.get_native_id()

    def told(pid: int, thread: int | None = None) -> Standing:
        passed_ns = time.monotonic_ns() - began_ns
        waited_ns = passed_ns * 8 // 10 if thread == own else 0
        return Standing(passed_ns // 10, waited_ns, True)

    monkeypatch.setattr("strands_actors.caller.session.liveness.standing", told)
    liveness = Liveness()
    liveness.look()
    time.sleep(0.05)
    assert liveness.look() == (True, -1.0)


FORKED = """
import os, sys, time
from strands_actors.caller.session.liveness import Liveness
if os.fork() == 0:
    liveness = Liveness()
    liveness.look()
    until_s = time.thread_time() + 0.1
    while time.thread_time() < until_s:
        pass
    os.write(1, repr(liveness.look()).encode())
    os._exit(0)
os.wait()
"""


def test_a_forked_process_that_only_computes_does_not_answer_either() -> None:
    """The number of its main thread is its own, not that of the process it was forked from."""
    done = subprocess.run([sys.executable, "-c", FORKED], capture_output=True, text=True, check=True)
    assert done.stdout == "(True, -1.0)"
