"""The processes that keep a robot safe import all modules before a motor is energised, because an import may wait
for the disk."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

HOOK = """
import os, sys, time
_PATH = os.environ["IMPORTS_LOG"]

def _note(event, arguments):
    if event == "import":
        log = os.open(_PATH, os.O_WRONLY | os.O_APPEND | os.O_CREAT)
        os.write(log, f"{os.getpid()} {time.monotonic_ns()} {arguments[0]}\\n".encode())
        os.close(log)

sys.addaudithook(_note)
os.register_at_fork(after_in_child=lambda: _note("import", ["its-parent"]))
"""

SCRIPT = """
import json, time
from strands_actors import Robot

arm = Robot("so101", mode="real", transport="twin")
assert arm.connect_eagerly() is None
armed_ns = time.monotonic_ns()
pids = {process["role"]: process["pid"] for process in arm.tree()["processes"]}
assert arm.send_action({"shoulder_pan": 5.0})["status"] == "success"
assert arm.stop()["status"] == "success"
assert arm.resume()["status"] == "success"
arm.cleanup()
print(json.dumps({"armed_ns": armed_ns, "pids": pids}))
"""


def test_root_wire_and_standby_import_nothing_once_a_robot_is_armed(tmp_path: Path) -> None:
    (tmp_path / "sitecustomize.py").write_text(HOOK)
    log = tmp_path / "imports"
    paths = os.pathsep.join([str(tmp_path), *(path for path in sys.path if path)])
    environment = {
        **os.environ,
        "PYTHONPATH": paths,
        "IMPORTS_LOG": str(log),
        "STRANDS_ACTORS_RUN": str(tmp_path / "run"),
    }
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT], capture_output=True, text=True, env=environment, timeout=100
    )
    assert done.returncode == 0, done.stderr
    result = json.loads(done.stdout)
    seen = [line.split() for line in log.read_text().splitlines()]
    roles = {result["pids"][role]: role for role in ("root", "wire", "standby")}
    assert set(roles) <= {int(pid) for pid, _, _ in seen}, "the import hook must run in each process"
    assert [
        (roles[int(pid)], name)
        for pid, at_ns, name in seen
        if int(pid) in roles and int(at_ns) > result["armed_ns"]
    ] == []
