"""Test the vendor's unmodified rby1-sdk against the twin, in a separate process, because it may hang and
does not end by itself."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from strands_actors.drivers.rby1.twin.parts import JointMove
from tests.answers import PATIENCE_S
from tests.drivers.common.twin_process import TwinProcess

from .rig import moves

pytestmark = pytest.mark.needs("rby1-sdk")

PRELUDE = """
import json, os, sys, time
import numpy as np
import rby1_sdk as rb

robot = rb.create_robot(sys.argv[1], "a")
assert robot.connect(3)

def right_arm(position, minimum_s=0.1, hold_s=1.0):
    header = rb.CommandHeaderBuilder().set_control_hold_time(hold_s)
    joints = rb.JointPositionCommandBuilder().set_command_header(header)
    joints = joints.set_minimum_time(minimum_s).set_position(position)
    body = rb.BodyComponentBasedCommandBuilder().set_right_arm_command(joints)
    return rb.RobotCommandBuilder().set_command(rb.ComponentBasedCommandBuilder().set_body_command(body))

def energise():
    assert robot.power_on(".*") and robot.is_power_on(".*")
    assert robot.servo_on(".*") and robot.is_servo_on(".*")
    assert robot.enable_control_manager() and robot.wait_for_control_ready(1000)

def end(**told):
    print(json.dumps(told), flush=True)
    os._exit(0)
"""


@pytest.fixture
def twin(tmp_path: Path) -> Iterator[TwinProcess]:
    with TwinProcess(tmp_path, "rby1", "rby1") as process:
        yield process


def run(twin: TwinProcess, program: str) -> dict[str, Any]:
    """Return the result that the program prints at its end."""
    ran = subprocess.run(
        [sys.executable, "-c", PRELUDE + program, twin.port, str(twin.process.pid)],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        timeout=3 * PATIENCE_S,
    )
    lines = [line for line in ran.stdout.splitlines() if line.startswith("{")]
    assert ran.returncode == 0 and lines, ran.stdout
    reported: dict[str, Any] = json.loads(lines[-1])
    return reported


def commands(twin: TwinProcess) -> list[dict[str, JointMove]]:
    """Return the commands in the twin's log, decoded by the wire's codec."""
    rows = map(json.loads, twin.log_path.read_text().splitlines())
    return [moves(bytes.fromhex(row["hex"])) for row in rows if row["kind"] == "setpoint"]


def test_the_sdk_connects_and_reads_the_robots_identity(twin: TwinProcess) -> None:
    reported = run(
        twin,
        """
info, state = robot.get_robot_info(), robot.get_state()
limits = robot.get_dynamics()
link = limits.make_state(["base", "ee_left"], [joint.name for joint in info.joint_infos])
end(model=info.robot_model_name, joints=[joint.name for joint in info.joint_infos],
    torso=list(info.torso_joint_idx), head=list(info.head_joint_idx), powers=[p.name for p in info.power_infos],
    position=list(state.position), emo=[int(emo.state.value) for emo in state.emo_states],
    battery=state.battery_state.level_percent, on=robot.is_power_on("48v"), servo=robot.is_servo_on(".*"),
    upper=list(limits.get_limit_q_upper(link)), lower=list(limits.get_limit_q_lower(link)),
    speed=list(limits.get_limit_qdot_upper(link)))
""",
    )
    assert (reported["model"], len(reported["joints"]), reported["torso"], reported["head"]) == (
        "A",
        24,
        [2, 3, 4, 5, 6, 7],
        [22, 23],
    )
    assert reported["powers"] == ["5v", "12v", "24v", "48v"]
    assert (reported["emo"], reported["on"], reported["servo"]) == ([0], False, False)
    assert reported["battery"] == pytest.approx(80.0, abs=0.5)
    assert reported["position"][:6] == pytest.approx([0, 0, 0, 0.4, -0.8, 0.4], abs=0.01)
    torso_0 = reported["joints"].index("torso_0")
    assert (reported["lower"][torso_0], reported["upper"][torso_0]) == pytest.approx((-0.261799, 0.261799))
    assert reported["speed"][torso_0] == pytest.approx(2.094395)


def test_it_powers_enables_and_moves_by_one_command(twin: TwinProcess) -> None:
    reported = run(
        twin,
        """
energise()
here = robot.get_state().position[8:15].copy()
feedback = robot.send_command(right_arm(here + 0.1, 0.3, 0.1), 1).get()
end(moved=list(robot.get_state().position[8:15] - here), finish=feedback.finish_code.name,
    manager=robot.get_control_manager_state().state.name)
""",
    )
    assert reported["finish"] == "Ok" and reported["manager"] == "Enabled"
    assert reported["moved"] == pytest.approx([0.1] * 7, abs=0.02)
    (command,) = commands(twin)
    assert list(command) == ["right_arm"]
    assert (command["right_arm"].minimum_s, command["right_arm"].hold_s) == (0.3, 0.1)


def test_its_streams_of_states_and_commands(twin: TwinProcess) -> None:
    reported = run(
        twin,
        """
energise()
seen = []
robot.start_state_update(lambda state: seen.append(state.position[8]), 100)
here = robot.get_state().position[8:15].copy()
stream = robot.create_command_stream(1)
for step in range(30):
    feedback = stream.send_command(right_arm(here + 0.005 * step, 0.02, 0.5))
    time.sleep(0.02)
running = feedback.status.name
for step in range(200):
    stream.send_command(right_arm(here + 0.145, 0.02, 0.5))
time.sleep(0.2)
before = robot.get_control_manager_state().control_state.name
cancelled = robot.cancel_control()
after = robot.get_control_manager_state().control_state.name
stream.cancel()
robot.stop_state_update()
end(samples=len(seen), moved=seen[-1] - here[0], running=running, before=before, cancelled=cancelled, after=after)
""",
    )
    assert reported["samples"] > 20, "at least 20 of about a hundred samples arrive"
    assert reported["moved"] == pytest.approx(0.145, abs=0.02)
    assert (reported["running"], reported["before"], reported["after"]) == ("Running", "Executing", "Idle")
    assert reported["cancelled"] is True
    assert len(commands(twin)) == 230


def test_faults_and_the_button_are_seen_and_a_fault_is_reset(twin: TwinProcess) -> None:
    twin.command("manager MAJOR_FAULT")
    reported = run(
        twin,
        """
faulty = robot.get_control_manager_state().state.name
assert robot.power_on(".*") and robot.servo_on(".*")
refused = robot.enable_control_manager()
reset = robot.reset_fault_control_manager()
end(faulty=faulty, refused=refused, reset=reset, enabled=robot.enable_control_manager())
""",
    )
    assert reported == {"faulty": "MajorFault", "refused": False, "reset": True, "enabled": True}
    twin.command("emergency-stop pressed")
    reported = run(twin, 'end(on=robot.power_on("48v"), emo=[e.state.name for e in robot.get_state().emo_states])')
    assert reported == {"on": False, "emo": ["Pressed"]}


def test_a_command_without_the_control_manager_is_refused(twin: TwinProcess) -> None:
    reported = run(
        twin,
        "end(finish=robot.send_command(right_arm(robot.get_state().position[8:15]), 1).get().finish_code.name)",
    )
    assert reported == {"finish": "ControlManagerIdle"}


def test_its_calls_hang_as_long_as_the_robot_is_frozen(twin: TwinProcess) -> None:
    """The reason why the wire does not use it: its calls have no deadline, ours have."""
    reported = run(
        twin,
        """
import signal, threading
energise()
done = []
os.kill(int(sys.argv[2]), signal.SIGSTOP)
ask = threading.Thread(target=lambda: done.append(robot.get_state()), daemon=True)
ask.start()
ask.join(2.0)
hangs = ask.is_alive()
os.kill(int(sys.argv[2]), signal.SIGCONT)
ask.join(10.0)
end(hangs=hangs, answered=bool(done))
""",
    )
    assert reported == {"hangs": True, "answered": True}
