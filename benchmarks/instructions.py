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
    limit="",
    rounds=1,
    short=False,
)
