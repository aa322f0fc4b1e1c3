"""A process that asks to run before others, and children of it that do not."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

ASK = """
import os
from strands_actors.kernel.health.realtime import run_first, run_like_others, scheduling
print(scheduling())
run_first(3)
print(scheduling())
run_like_others()
print(scheduling())
"""


@pytest.mark.parametrize("cores", ["all", "one"])
def test_it_runs_first_where_that_is_permitted_and_says_so(cores: str) -> None:
    pin = "import os; os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})\n" if cores == "one" else ""
    done = subprocess.run([sys.executable, "-c", pin + ASK], capture_output=True, text=True, check=True)
    before, asked, after = done.stdout.splitlines()
    assert before == after
    assert before.startswith("ordinary: ")
    if cores == "one":
        assert asked == "ordinary: SCHED_FIFO needs a second core"
    else:
        assert asked == "SCHED_FIFO 3" or asked == before  # not everybody may


SPIN = """
import time
from strands_actors.kernel.health.realtime import SPELL_S, run_first, runs_first, scheduling
run_first(3)
asked = runs_first()
until_s = time.monotonic() + 60.0
while asked and runs_first() and time.monotonic() < until_s:
    pass
print(asked, scheduling())
"""


def test_who_computes_without_a_pause_gives_way() -> None:
    done = subprocess.run([sys.executable, "-c", SPIN], capture_output=True, text=True, check=True)
    asked, _, told = done.stdout.strip().partition(" ")
    if asked == "True":  # not everybody may
        assert told == "ordinary: it computed for 0.5 s without a pause"
        assert "does not run first any more" in done.stderr
    else:
        assert told.startswith("ordinary: SCHED_FIFO")


MEMORY = """
from strands_actors.kernel.health.realtime import may_lock_memory, memory, run_first

def locked_kb():
    (line,) = [line for line in open("/proc/self/status") if line.startswith("VmLck")]
    return int(line.split()[1])

print(may_lock_memory(), locked_kb())
run_first(3)
print(memory() == "locked", locked_kb())
"""


def test_it_stays_in_memory_where_that_is_permitted_and_who_only_asks_does_not() -> None:
    done = subprocess.run([sys.executable, "-c", MEMORY], capture_output=True, text=True, check=True)
    (may, before_kb), (locked, after_kb) = (line.split() for line in done.stdout.splitlines())
    assert locked == may
    assert int(before_kb) < 1000
    assert (int(after_kb) > 10_000) == (locked == "True")


KEPT = """
import os
from strands_actors.kernel.processes.process import start
from tests.kernel import children
os.sched_setscheduler(0, os.{policy}, os.sched_param({priority}))
print(start("tests.kernel.children:tell_scheduling", {{}}).socket.recv(8).decode())
"""


@pytest.mark.parametrize(("policy", "priority", "kept"), [("SCHED_IDLE", 0, True), ("SCHED_FIFO", 1, False)])
def test_a_child_is_run_as_its_user_wants_but_never_first(policy: str, priority: int, kept: bool) -> None:
    """Who may not leave SCHED_IDLE, under ``chrt -i``, could start no robot at all."""
    code = KEPT.format(policy=policy, priority=priority)
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    if not kept and "PermissionError" in done.stderr:
        return  # not everybody may run first
    assert done.returncode == 0, done.stderr
    assert int(done.stdout) == (getattr(os, policy) if kept else os.SCHED_OTHER)
