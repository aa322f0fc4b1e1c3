"""A script ends with its own exit code, even if its threads or those of zenoh are about to enter Python.
Without ``zenoh_exit`` nearly every such run was aborted (exit code 134).
"""

from __future__ import annotations

import subprocess
import sys

import pytest

FLOOD = """
import threading, time
from strands_actors.caller.session.portal import portal

mesh = portal().node.mesh
key = mesh._threads.reply_to
mesh._alive.add(key)

def flood():  # each query calls zenoh in this thread, and its answer arrives in one of zenoh's
    while True:
        mesh._put_question(key, b"x" * 100)

for _ in range(4):
    threading.Thread(target=flood, daemon=True).start()
time.sleep(0.1)
{end}
"""


@pytest.mark.parametrize(("end", "code"), [("", 0), ("raise SystemExit(3)", 3), ("raise ValueError", 1)])
def test_daemon_threads_in_zenoh_do_not_abort_the_end_of_a_script(end: str, code: int) -> None:
    for _ in range(3):
        done = subprocess.run([sys.executable, "-c", FLOOD.format(end=end)], capture_output=True, text=True)
        assert done.returncode == code, done.stderr
        assert "FATAL" not in done.stderr
