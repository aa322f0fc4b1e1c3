"""Liveness decides whether the commanding thread still responds, from its processor time and its calls."""

from __future__ import annotations

import subprocess
import sys
import threading
import time

import pytest

from strands_actors.caller.session.liveness import Liveness
from strands_actors.kernel.health.processor import ProcessorUse


def spin(for_s: float) -> None:
    until_s = time.thread_time() + for_s
    while time.thread_time() < until_s:
        pass


def test_a_thread_that_waits_responds_now() -> None:
    liveness = Liveness()
    liveness.look()
    time.sleep(0.1)
    alive, answered_ago_s = liveness.look()
    assert alive
    assert 0.0 <= answered_ago_s < 0.05


def test_a_thread_that_only_computes_does_not_respond() -> None:
    liveness = Liveness()
    liveness.look()
    spin(0.1)
    assert liveness.look() == (True, -1.0)


def test_a_thread_that_computes_since_its_call_responded_at_the_time_of_the_call() -> None:
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


def test_a_thread_inside_a_verb_responds() -> None:
    """It waits for the library. Processor time of the thread does not count meanwhile."""
    liveness = Liveness()
    liveness.look()
    liveness.enter()
    spin(0.1)
    assert liveness.look() == (True, 0.0)


def test_a_thread_without_the_interpreters_lock_does_not_count_as_sleeping(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """On a busy machine, a spinning thread waits for the interpreter's lock, which looks like sleep. The
    measuring thread has the lock and waits for a processor.
    """
    began_ns = time.monotonic_ns()
    own = threading.get_native_id()

    def reported(pid: int, thread: int | None = None) -> ProcessorUse:
        passed_ns = time.monotonic_ns() - began_ns
        waited_ns = passed_ns * 8 // 10 if thread == own else 0
        return ProcessorUse(passed_ns // 10, waited_ns, True)

    monkeypatch.setattr("strands_actors.caller.session.liveness.processor_use", reported)
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


def test_a_forked_process_that_only_computes_does_not_respond() -> None:
    """The main thread of a forked process has another number than in its parent."""
    done = subprocess.run([sys.executable, "-c", FORKED], capture_output=True, text=True, check=True)
    assert done.stdout == "(True, -1.0)"
