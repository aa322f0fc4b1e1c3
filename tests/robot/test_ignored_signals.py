"""A script that ignores the signals of its children's ends, like one under a shell's `trap "" CHLD`
(SAF-003). Its tree must still detect the end of a process. The tests read the simulated robot's wire log.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time

import pytest

from strands_actors.testing import Twin
from tests.answers import until

from .helpers import limps

SCRIPT = """
import signal, sys
signal.signal(signal.SIGCHLD, signal.SIG_IGN)
from strands_actors import Robot

arm = Robot("so101", mode="real", port=sys.argv[1])
assert arm.connect_eagerly() is None
answer = arm.send_action({"shoulder_pan": 20.0})
assert answer["status"] == "success", answer
pids = {process["role"]: process["pid"] for process in arm.tree()["processes"]}
print(pids[sys.argv[2]], flush=True)
sys.stdin.readline()
answer = arm.resume()
assert answer["status"] == "success", answer
print("resumed", flush=True)
sys.stdin.readline()
"""


@pytest.mark.parametrize("victim", ["wire", "standby"])
def test_saf_003_the_end_of_a_process_is_detected_although_the_script_ignores_it(twin: Twin, victim: str) -> None:
    with subprocess.Popen(
        [sys.executable, "-c", SCRIPT, twin.port, victim],
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
    ) as script:  # fmt: skip
        try:
            assert script.stdin is not None and script.stdout is not None
            pid = int(script.stdout.readline())
            killed_ns = time.monotonic_ns()
            os.kill(pid, signal.SIGKILL)
            if victim == "wire":
                assert until(lambda: limps(twin.log, killed_ns), "the root has released the arm")
            print("go on", file=script.stdin, flush=True)
            assert script.stdout.readline() == "resumed\n", "a new process replaces the killed one"
            ended_ns = time.monotonic_ns()
            print("end", file=script.stdin, flush=True)
            assert script.wait(30) == 0
            assert until(lambda: limps(twin.log, ended_ns), "the arm is released at the end")
        finally:
            script.kill()
