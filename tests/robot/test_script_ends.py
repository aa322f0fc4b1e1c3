"""A script ends with its own exit code, for each kind of end and with busy threads. It must not be
aborted by a thread of zenoh that enters Python during the interpreter's shutdown.
"""

from __future__ import annotations

import itertools
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from strands_actors.testing import Twin
from tests.spinning import spinning

BEGIN = """
import os, signal, sys, threading, time
from strands_actors import Robot

arm = Robot("so101", mode="real", port=sys.argv[1])
arm.send_action({"shoulder_pan": 1.0})
"""
FOREVER = """
def again(call):
    while True:
        call()

for call in (lambda: arm.send_action({"shoulder_pan": 1.0}), arm.get_observation):
    threading.Thread(target=again, args=(call,), daemon=True).start()
time.sleep(0.3)
"""
FORKED = """
child = os.fork()
if child == 0:
    raise SystemExit(0)
assert os.waitpid(child, 0)[1] == 0
"""
ENDS = {
    "nothing": ("", 0),
    "daemon threads": (FOREVER, 0),
    "an exception after cleanup": ("arm.cleanup()\nraise ValueError('x')", 1),
    "Ctrl-C": ("os.kill(os.getpid(), signal.SIGINT)\ntime.sleep(30.0)", -signal.SIGINT),
    "cleanup": ("arm.cleanup()", 0),
    "an exit code": ("sys.exit(3)", 3),
    "an exception": ("raise ValueError('x')", 1),
    "daemon threads and an exception": (FOREVER + "raise ValueError('x')", 1),
    "daemon threads and cleanup": (FOREVER + "arm.cleanup()", 0),
    "a forked child": (FORKED, 0),
}
"""For each case: the last lines of the script, and the exit code that Python gives."""
SCRIPTS, LOOPS = 500, 16


def ran(end: str, port: str, folder: Path) -> tuple[int, str]:
    script = folder / "script.py"
    script.write_text(BEGIN + end)
    command = [sys.executable, str(script), port]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120.0)
    return done.returncode, done.stderr


@pytest.mark.quick_cases(4)
@pytest.mark.parametrize("name", ENDS)
def test_a_script_ends_with_its_own_exit_code(name: str, twin: Twin, tmp_path: Path) -> None:
    end, code = ENDS[name]
    returned, errors = ran(end, twin.port, tmp_path)
    assert returned == code, errors
    assert "FATAL" not in errors and "Traceback" not in errors.partition("ValueError: x")[2], errors


@pytest.mark.long
def test_none_of_many_scripts_is_aborted_on_a_busy_machine(twin: Twin, tmp_path: Path) -> None:
    names = itertools.cycle(ENDS)
    with spinning(LOOPS):
        for number, name in enumerate(itertools.islice(names, SCRIPTS)):
            returned, errors = ran(ENDS[name][0], twin.port, tmp_path)
            assert returned == ENDS[name][1], f"script {number}, {name}: {errors}"
            assert "FATAL" not in errors, f"script {number}, {name}: {errors}"
