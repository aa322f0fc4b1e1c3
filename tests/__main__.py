"""``python -m tests``: style, types, tests (three at a time: most of them wait for processes); stops
at the first that fails. Arguments go to pytest.

``python -m tests lerobot``: what needs LeRobot itself (``tests/lerobot``), and nothing else.

``python -m tests long``: the tests that this leaves out (``tests/long.py``).

A test that fails beside another is run once more, alone, and named: two robots on a machine that
pauses may be late where one is not. Who fails alone fails.

``python -m tests soak``: half an hour of three robots (``tests/soak``), which ``long`` runs, too.

``python -m tests mutate``: break the safety code in many small ways (``tests/mutate``).

``python -m tests newton``, ``python -m tests peers``: suites of their own, of what is gigabytes, takes
minutes to compile, or has to be made an environment first.
"""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys

# The tests start thousands of processes: where it is set, each compiles all its modules anew, which
# is half of what a robot's start takes.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)

if sys.argv[1:2] == ["lerobot"]:
    from tests.lerobot.environments import main

    sys.exit(main(sys.argv[2:]))

if sys.argv[1:2] == ["mutate"]:
    from tests.mutate.run import main

    sys.exit(main(sys.argv[2:]))

LONG = sys.argv[1:2] == ["long"]
ARGUMENTS = ("-m", "long", *sys.argv[2:]) if LONG else ("-m", "not long", *sys.argv[1:])
STEPS = (
    ("ruff", "check", "."),
    ("ruff", "format", "--check", "."),
    ("mypy",),
    ("pytest", "-n", "3", "--dist", "worksteal", "--durations=20", *ARGUMENTS),
)
ALONE = ("pytest", "--last-failed", "--last-failed-no-failures", "none", *ARGUMENTS)
SUITES = {"newton": ("tests/newton/suite.py",), "peers": ("tests/peers/suite.py",), "soak": ("tests/soak",)}
"""Not in the ordinary run: no file of theirs is called ``test_``, or its test is long."""
COMPILE = (sys.executable, "-m", "pytest", "--collect-only", "-q")
"""In a fresh clone each of the three workers would compile all tests: one process does, beside mypy. What is
wrong with them they find, too, and say so."""
SOME_FAILED = 1
"""Pytest's exit code; others say that it could not run."""


def run(step: tuple[str, ...]) -> int:
    print("$", *step, flush=True)
    return subprocess.run([sys.executable, "-m", *step]).returncode


if sys.argv[1:2] and sys.argv[1] in SUITES:
    sys.exit(run(("pytest", *SUITES[sys.argv[1]], *sys.argv[2:])))
for step in STEPS:
    with contextlib.ExitStack() as beside:
        if step[0] == "mypy":
            beside.enter_context(subprocess.Popen(COMPILE, stdout=subprocess.DEVNULL, stderr=subprocess.STDOUT))
        code = run(step)
    if code == SOME_FAILED and step[0] == "pytest":
        code = run(ALONE)
    if code:
        sys.exit(code)
