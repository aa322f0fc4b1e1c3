"""A process that asks to run before others, and children of it that do not."""

from __future__ import annotations

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
