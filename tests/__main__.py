"""Run the checks of the project: ``python -m tests [SUITE] [arguments of pytest]``.

Without a suite it checks style and types and runs the tests, and stops at the first step that fails.
Three tests run at the same time, because most tests wait for processes. Tests that fail are run once
more, one at a time, and pytest prints their names: on a machine that pauses, two robots may be late
where one is not. A test that fails again fails the run.

``coverage``: run the tests of the ordinary run, and print how much of each file they ran, in all processes. A run
without further arguments also records the figure (``tests/covered.py``).

``console``: the console in Chromium (``tests/web/chromium``). It needs Chromium, and ends if there is none.

``lerobot``: only the tests that need LeRobot itself (``tests/lerobot``).

``long``: the tests that the ordinary run leaves out (``tests/long.py``).

``soak``: three robots for half an hour (``tests/soak``). ``long`` includes it.

``mutate``: break the safety code in many small ways (``tests/mutate``).

``strangers``: run vendors' clients and their example programs against the simulated robots (``tests/strangers``).

``release``: build the wheel and the source distribution of a commit, and check them (``tests/release.py``).

``newton``, ``peers``, ``rerun``: separate suites, because they need gigabytes of packages, minutes to compile, or
an environment that is built first.
"""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys

from tests import covered

# The tests start thousands of processes. With this variable each would compile all its modules again,
# which is half of the time that a robot takes to start.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)

if sys.argv[1:2] == ["lerobot"]:
    from tests.lerobot.environments import main

    sys.exit(main(sys.argv[2:]))

if sys.argv[1:2] == ["mutate"]:
    from tests.mutate.run import main

    sys.exit(main(sys.argv[2:]))

if sys.argv[1:2] == ["release"]:
    from tests.release import main

    sys.exit(main(sys.argv[2:]))

if sys.argv[1:2] == ["strangers"]:
    from tests.strangers.main import main

    sys.exit(main(sys.argv[2:]))

LONG = sys.argv[1:2] == ["long"]
COVERAGE = sys.argv[1:2] == ["coverage"]
ARGUMENTS = ("-m", "long" if LONG else "not long", *sys.argv[2 if LONG or COVERAGE else 1 :])
PARALLEL = ("pytest", "-n", "3", "--dist", "worksteal")
STEPS = (
    ("ruff", "check", "."),
    ("ruff", "format", "--check", "."),
    ("mypy",),
    (*PARALLEL, "--durations=20", *ARGUMENTS),
)
MEASURED = (
    ("coverage", "erase"),
    ("coverage", "run", "-m", *PARALLEL, f"--junitxml={covered.TESTS}", *ARGUMENTS),
    ("coverage", "combine", "--quiet"),
    ("coverage", "report"),
    ("coverage", "json", "--quiet", "-o", str(covered.MEASURED)),
)
"""Tests of milliseconds may fail here, because a process is slower and saves its data when it ends."""
ALONE = ("pytest", "--last-failed", "--last-failed-no-failures", "none", *ARGUMENTS)
SUITES = {
    "console": ("tests/web/chromium/suite.py",),
    "newton": ("tests/newton/suite.py",),
    "peers": ("tests/peers/suite.py",),
    "rerun": ("tests/view/rerun_suite.py",),
    "soak": ("tests/soak",),
}
"""These are not in the ordinary run: their files do not begin with ``test_``, or their test is long."""
COMPILE = (sys.executable, "-m", "pytest", "--collect-only", "-q")
"""Compile all tests while mypy runs. Otherwise, in a fresh clone, each of the three workers would compile
them. Its errors are not shown, because the workers report them, too.
"""
SOME_FAILED = 1
"""Exit code of pytest when tests failed. Other codes mean that it could not run."""


def run(step: tuple[str, ...]) -> int:
    print("$", *step, flush=True)
    return subprocess.run([sys.executable, "-m", *step]).returncode


if sys.argv[1:2] and sys.argv[1] in SUITES:
    sys.exit(run(("pytest", *SUITES[sys.argv[1]], *sys.argv[2:])))
if COVERAGE:
    if sys.version_info >= (3, 12):
        os.environ["COVERAGE_CORE"] = "sysmon"
    codes = [run(step) for step in MEASURED]
    if sys.argv[2:]:
        print("not recorded, because only a run of all tests counts")
    elif set(codes) <= {0, SOME_FAILED} and not any(codes[2:]):
        covered.record()
    sys.exit(max(codes))
for step in STEPS:
    with contextlib.ExitStack() as beside:
        if step[0] == "mypy":
            beside.enter_context(subprocess.Popen(COMPILE, stdout=subprocess.DEVNULL, stderr=subprocess.STDOUT))
        code = run(step)
    if code == SOME_FAILED and step[0] == "pytest":
        code = run(ALONE)
    if code:
        sys.exit(code)
