"""A process that asks for real-time priority, and its children, which do not get it."""

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
def test_a_process_gets_real_time_priority_where_permitted_and_reports_it(cores: str) -> None:
    pin = "import os; os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})\n" if cores == "one" else ""
    done = subprocess.run([sys.executable, "-c", pin + ASK], capture_output=True, text=True, check=True)
    before, during, after = done.stdout.splitlines()
    assert before == after
    assert before.startswith("ordinary: ")
    if cores == "one":
        assert during == "ordinary: SCHED_FIFO needs a second core"
    else:
        assert during == "SCHED_FIFO 3" or during == before  # not every user has the permission


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


def test_a_process_that_computes_without_a_pause_loses_its_priority() -> None:
    done = subprocess.run([sys.executable, "-c", SPIN], capture_output=True, text=True, check=True)
    permitted, _, result = done.stdout.strip().partition(" ")
    if permitted == "True":  # not every user has the permission
        assert result == "ordinary: it computed for 0.5 s without a pause"
        assert "does not run first any more" in done.stderr
    else:
        assert result.startswith("ordinary: SCHED_FIFO")


MEMORY = """
from strands_actors.kernel.health.realtime import may_lock_memory, memory, run_first

def locked_kb():
    (line,) = [line for line in open("/proc/self/status") if line.startswith("VmLck")]
    return int(line.split()[1])

print(may_lock_memory(), locked_kb())
run_first(3)
print(memory() == "locked", locked_kb())
"""


def test_memory_is_locked_where_permitted_and_the_check_alone_locks_nothing() -> None:
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
def test_a_child_keeps_the_users_scheduling_policy_but_not_real_time_priority(
    policy: str, priority: int, kept: bool
) -> None:
    """A process without the right to leave SCHED_IDLE, as under ``chrt -i``, could otherwise start no robot."""
    code = KEPT.format(policy=policy, priority=priority)
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    if not kept and "PermissionError" in done.stderr:
        return  # not every user may set a real-time priority
    assert done.returncode == 0, done.stderr
    assert int(done.stdout) == (getattr(os, policy) if kept else os.SCHED_OTHER)
