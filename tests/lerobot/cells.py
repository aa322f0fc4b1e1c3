"""Kill cells of ``driver="lerobot"`` with LeRobot's own class, by hand, in one of the environments:

    python -m tests.lerobot.cells so101 | koch

Each cell: a script moves the arm, one or two processes are killed or frozen, and the twin's log says
when the torque was taken (or the arm held), and what came after it.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from strands_actors.testing import Twin, twin

MOTORS = ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll", "gripper")
CELLS = (
    ("caller", signal.SIGKILL),
    ("caller", signal.SIGSTOP),
    ("wire", signal.SIGKILL),
    ("wire", signal.SIGSTOP),
    ("root", signal.SIGKILL),
    ("root wire", signal.SIGKILL),
)
LOOK_S = 3.0
SCRIPT = """
import json, math, sys, time
from strands_actors import Robot
name, port, folder = sys.argv[1:]
arm = Robot(name, mode="real", driver="lerobot", port=port, tool_name="black", calibration_dir=folder)
problem = arm.connect_eagerly()
assert problem is None, problem
pids = {one["role"]: one["pid"] for one in arm.tree()["processes"]}
for step in range(100_000):
    arm.send_action({"shoulder_pan": 10.0 * math.sin(step / 30)})
    if step == 30:
        print(json.dumps(pids), flush=True)
    time.sleep(1 / 30)
"""


def main() -> None:
    twin.PATIENCE_S = 120.0
    home = Path(tempfile.mkdtemp(prefix="cells-"))
    os.environ |= {"HF_HOME": str(home), "HF_HUB_OFFLINE": "1"}
    motors = {
        motor: {"id": at, "drive_mode": 0, "homing_offset": 0, "range_min": 0, "range_max": 4095}
        for at, motor in enumerate(MOTORS, start=1)
    }
    (home / "black.json").write_text(json.dumps(motors))
    with Twin(sys.argv[1], home) as robot:
        for victims, how in CELLS:
            _cell(robot, home, victims, how)


def _cell(robot: Twin, home: Path, victims: str, how: signal.Signals) -> None:
    os.environ["STRANDS_ACTORS_RUN"] = tempfile.mkdtemp(prefix="sa-")
    os.truncate(robot.log.path, 0)
    process = subprocess.Popen(
        [sys.executable, "-c", SCRIPT, robot.robot, robot.port, str(home)], stdout=subprocess.PIPE, text=True
    )
    assert process.stdout is not None
    line = process.stdout.readline()
    if not line:  # it did not connect: no trial
        return _cell(robot, home, victims, how)
    pids = {**json.loads(line), "caller": process.pid}
    broken_ns = time.monotonic_ns()
    for victim in victims.split():
        os.kill(pids[victim], how)
    time.sleep(LOOK_S)
    safe = robot.log.first_safe(broken_ns)
    shown = "nothing"
    if safe is not None:
        after = robot.log.setpoints_after_safe(broken_ns)
        states = {one.safe_state for one in robot.log.host("safe", broken_ns) if one.safe_state}
        shown = (
            f"{', '.join(sorted(states))} after {(safe.t_ns - broken_ns) / 1e6:.0f} ms, {after} setpoints after it"
        )
    print(f"{victims} {how.name}: {shown}. {robot.log.story(broken_ns)}", flush=True)
    process.kill()
    process.wait()
    time.sleep(LOOK_S)
    return None


if __name__ == "__main__":
    main()
