"""How many instructions does a message cost?"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys

from benchmarks.house import HOUSE, Figures, Question, Side

FEW, MANY = 500, 2500
"""The difference has what the start and the first calls cost in neither."""
COLLECTED = re.compile(r"Collected : (\d+)")


def _side(name: str, *works: str) -> Side:
    def side(short: bool) -> Figures:
        return {
            f"{work}_instructions": (_count(name, work, MANY) - _count(name, work, FEW)) / (MANY - FEW)
            for work in works
        }

    return side


def _count(name: str, work: str, times: int) -> int:
    """Under callgrind, the same for the same code whatever the machine does meanwhile."""
    valgrind = shutil.which("valgrind")
    if valgrind is None:
        raise RuntimeError("valgrind is not installed (Debian: apt install valgrind)")
    command = [sys.executable, "-m", "benchmarks.sides.instructions", name, work, str(times)]
    done = subprocess.run(
        [valgrind, "--tool=callgrind", "--callgrind-out-file=/dev/null", *command],
        cwd=HOUSE.parent,
        env=os.environ | {"PYTHONHASHSEED": "0", "PYTHONPATH": str(HOUSE.parent)},
        capture_output=True,
        text=True,
        timeout=300,
    )
    found = COLLECTED.search(done.stderr)
    if done.returncode or found is None:
        raise RuntimeError(f"{name} {work} ended with {done.returncode}:\n{done.stderr[-2000:]}")
    return int(found[1])


QUESTION = Question(
    name="instructions",
    title="How many instructions does a message cost, in one process?",
    sides={
        "ours": _side("ours", "tell", "ask", "setpoint", "state"),
        "trio": _side("trio", "tell", "ask"),
        "asyncio": _side("asyncio", "tell"),
        "a deque and a call": _side("bare", "tell"),
    },
    goals=(),
    limit="""Callgrind counts the instructions of the process for 2500 of each less those for 500, so that
neither the machine nor the start is in it: the same code gives the same figures. One setpoint of a G1, from the
frame that came to the frame that leaves, is 430 000, or 50 µs with warm caches and 200 with those of a process
that has slept for 2 ms (timed by the thread's own clock): at 500 Hz caches are what is paid for.""",
    rounds=1,
    short=False,
)
