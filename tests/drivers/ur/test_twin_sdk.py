"""Test the unmodified ur-rtde against the twin, in separate processes.

It keeps the interpreter's lock when it closes, and its threads go on looking for a controller that is gone.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Iterator
from typing import Any

import pytest

from strands_actors.testing import Twin
from tests.answers import PATIENCE_S, until

pytestmark = pytest.mark.needs("ur-rtde")

PRELUDE = """
import json, os, sys, time
from rtde_control import RTDEControlInterface as Control
from rtde_receive import RTDEReceiveInterface as Receive

host = sys.argv[1]
UPPER = Control.FLAG_UPPER_RANGE_REGISTERS

def until(look):
    deadline = time.monotonic() + 15
    while not look():
        assert time.monotonic() < deadline, "patience is over"
        time.sleep(0.002)

def end(**told):
    print(json.dumps(told), flush=True)
    os._exit(0)
"""


@pytest.fixture(scope="module")
def twin(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Twin]:
    with Twin("ur5e", tmp_path_factory.mktemp("twin")) as process:
        yield process


def run(twin: Twin, program: str) -> dict[str, Any]:
    """Return the result that the program prints at its end."""
    ran = subprocess.run(
        [sys.executable, "-c", PRELUDE + program, twin.port.partition(":")[0]],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        timeout=3 * PATIENCE_S,
        env={**os.environ},
    )
    lines = [line for line in ran.stdout.splitlines() if line.startswith("{")]
    assert ran.returncode == 0 and lines, ran.stdout
    reported: dict[str, Any] = json.loads(lines[-1])
    return reported


def test_receive_reads_every_known_output(twin: Twin) -> None:
    reported = run(
        twin,
        """
receive = Receive(host)
until(lambda: receive.getTimestamp() > 0)
first = receive.getTimestamp()
until(lambda: receive.getTimestamp() > first)
end(q=receive.getActualQ(), mode=receive.getRobotMode(), safety=receive.getSafetyMode(),
    pose=receive.getActualTCPPose(), runtime=receive.getRuntimeState(), temperature=receive.getJointTemperatures())
""",
    )
    assert reported["mode"] == 7
    assert reported["safety"] == 1
    assert reported["runtime"] == 1
    assert len(reported["q"]) == len(reported["pose"]) == 6
    assert reported["temperature"] == [30.0] * 6


@pytest.mark.parametrize("flags", ["Control.FLAG_UPLOAD_SCRIPT", "Control.FLAG_UPLOAD_SCRIPT | UPPER"])
def test_control_servoes_stops_and_moves(twin: Twin, flags: str) -> None:
    """Test both register ranges."""
    reported = run(
        twin,
        f"""
receive = Receive(host, 125.0)
until(lambda: receive.getTimestamp() > 0)
control = Control(host, 125.0, {flags})
q = receive.getActualQ()
for at in range(50):
    assert control.servoJ([q[0] + 0.004 * at, *q[1:]], 0.5, 0.5, 0.008, 0.1, 300)
    time.sleep(0.008)
stopped = control.servoStop(10.0)
servoed_to = receive.getActualQ()[0] - q[0]
moved = control.moveJ(q, 1.0, 2.0)
until(lambda: control.isSteady())
time.sleep(0.05)
back = receive.getActualQ()[0] - q[0]
torques = control.getJointTorques()
control.stopScript()
until(lambda: receive.getRuntimeState() == 1)
refused = control.servoJ(q, 0.5, 0.5, 0.008, 0.1, 300)
reuploaded = control.reuploadScript()
until(lambda: receive.getRuntimeState() == 2)
control.stopScript()
end(stopped=stopped, servoed_to=servoed_to, moved=moved, back=back, torques=len(torques), refused=refused,
    reuploaded=reuploaded)
""",
    )
    assert reported["stopped"] and reported["moved"] and reported["reuploaded"]
    assert reported["refused"] is False
    assert reported["servoed_to"] > 0.1
    assert abs(reported["back"]) < 0.01
    assert reported["torques"] == 6


def test_saf_013_the_watchdog_it_arms_stops_the_program(twin: Twin) -> None:
    reported = run(
        twin,
        """
receive = Receive(host, 125.0)
control = Control(host, 125.0, Control.FLAG_UPLOAD_SCRIPT | UPPER)
until(lambda: receive.getRuntimeState() == 2)
assert control.setWatchdog(10.0)
for _ in range(20):
    control.kickWatchdog()
    time.sleep(0.02)
fed = receive.getRuntimeState()
began = time.monotonic()
until(lambda: receive.getRuntimeState() == 1)
end(fed=fed, stopped_after=time.monotonic() - began)
""",
    )
    assert reported["fed"] == 2
    assert 0.05 < reported["stopped_after"] < 2.0
    until(lambda: [entry for entry in twin.log.entries() if entry.kind == "watchdog"], "the log says so")


def test_protective_stop_and_the_dashboard(twin: Twin) -> None:
    reported = run(
        twin,
        """
from dashboard_client import DashboardClient
receive = Receive(host, 125.0)
control = Control(host, 125.0, Control.FLAG_UPLOAD_SCRIPT | UPPER)
until(lambda: receive.getRuntimeState() == 2)
control.triggerProtectiveStop()
until(lambda: receive.isProtectiveStopped())
safety, mode = receive.getSafetyMode(), receive.getRobotMode()
servo = lambda: control.servoJ(receive.getActualQ(), 0.5, 0.5, 0.008, 0.1, 300)
until(lambda: not servo())  # it hears of the stop on a connection of its own
moved = servo()
dashboard = DashboardClient(host)
dashboard.connect()
shown = dashboard.safetymode()
dashboard.unlockProtectiveStop()
until(lambda: receive.getSafetyMode() == 1)
end(safety=safety, mode=mode, moved=moved, shown=shown, running=dashboard.running(),
    remote=dashboard.isInRemoteControl(), model=dashboard.getRobotModel(), version=dashboard.polyscopeVersion())
""",
    )
    assert (reported["safety"], reported["mode"]) == (3, 7)
    assert reported["moved"] is False
    assert reported["shown"] == "Safetymode: PROTECTIVE_STOP"
    assert reported["running"] is False
    assert reported["remote"] is True
    assert reported["model"] == "UR5"
    assert reported["version"].startswith("5.")


def test_inputs_and_outputs(twin: Twin) -> None:
    reported = run(
        twin,
        """
from rtde_io import RTDEIOInterface
receive = Receive(host, 125.0)
io = RTDEIOInterface(host)
assert io.setStandardDigitalOut(1, True)
assert io.setSpeedSlider(0.5)
until(lambda: receive.getSpeedScalingCombined() == 0.5)
until(lambda: receive.getActualDigitalOutputBits() == 2)
assert io.setSpeedSlider(1.0)
assert io.setStandardDigitalOut(1, False)
until(lambda: receive.getActualDigitalOutputBits() == 0)
until(lambda: receive.getSpeedScalingCombined() == 1.0)
end(done=True)
""",
    )
    assert reported == {"done": True}


def test_two_twins_side_by_side(twin: Twin, tmp_path: Any) -> None:
    with Twin("ur10e", tmp_path) as other:
        assert other.port != twin.port
        assert run(other, "receive = Receive(host)\nuntil(lambda: receive.getTimestamp() > 0)\nend(ok=True)") == {
            "ok": True
        }


def test_poses_kinematics_and_missing_functions(twin: Twin) -> None:
    reported = run(
        twin,
        """
receive = Receive(host, 125.0)
control = Control(host)
until(lambda: receive.getRuntimeState() == 2)
start, joints = receive.getActualTCPPose(), receive.getActualQ()
lower = [*start[:2], start[2] - 0.05, *start[3:]]
moved = control.moveL(lower, 0.5, 2.0)
fell = start[2] - receive.getActualTCPPose()[2]
forward = control.getForwardKinematics()
inverse = control.getInverseKinematics(start, joints)
back = control.moveJ([[*joints, 1.0, 2.0, 0.0], [*joints, 1.0, 2.0, 0.0]])
limits = [control.isJointsWithinSafetyLimits([9.0] * 6), control.isPoseWithinSafetyLimits(start)]
control.setTcp([0, 0, 0.1, 0, 0, 0])
offset = control.getTCPOffset()
control.setTcp([0] * 6)
forced = control.zeroFtSensor() and control.ftRtdeInputEnable(True)
until(lambda: receive.getRuntimeState() == 1)
again = control.reuploadScript()
until(lambda: receive.getRuntimeState() == 2)
while receive.getSafetyMode() != 3:
    stopped = control.triggerProtectiveStop()  # a script that has just begun may not hear it
    time.sleep(0.5)
from dashboard_client import DashboardClient
dashboard = DashboardClient(host)
dashboard.connect()
dashboard.loadURP("hold.urp")
loaded, mode = dashboard.getLoadedProgram(), dashboard.robotmode()
dashboard.popup("look")
dashboard.closePopup()
dashboard.addToLog("said")
dashboard.unlockProtectiveStop()
until(lambda: receive.getSafetyMode() == 1)
end(moved=moved, fell=fell, forward=forward, lower=lower, inverse=inverse, joints=joints, back=back, limits=limits,
    offset=offset, forced=forced, again=again, stopped=stopped, loaded=loaded)
""",
    )
    assert reported["moved"] and reported["back"] and reported["again"] and reported["stopped"]
    assert abs(reported["fell"] - 0.05) < 0.003
    assert max(abs(a - b) for a, b in zip(reported["forward"][:3], reported["lower"][:3], strict=True)) < 0.003
    assert max(abs(a - b) for a, b in zip(reported["inverse"], reported["joints"], strict=True)) < 1e-3
    assert reported["limits"] == [False, True]
    assert reported["offset"][2] == 0.1
    assert reported["forced"] is False
    assert "hold.urp" in reported["loaded"]
    until(
        lambda: [e for e in twin.log.entries() if e.kind == "error" and b"ft_rtde_input_enable" in e.data],
        "its log says why",
    )


def test_a_getter_among_its_real_time_calls_returns_the_answer_before(twin: Twin) -> None:
    """ur-rtde sends a real-time command and reads the registers at once, before the next sample can arrive. So this
    is the client's doing, with every controller. A second call after a sample returns the answer to the first."""
    reported = run(
        twin,
        """
receive = Receive(host, 500.0)
control = Control(host)
until(lambda: receive.getRuntimeState() == 2)
def answers(getter):
    control.setTcp([0.1, 0.2, 0.3, 0, 0, 0])
    for _ in range(20):  # On a busy machine a sample may arrive between sending and reading.
        offset = control.getTCPOffset()  # A call that waits for its answer: the registers have this offset.
        first = getter()
        if first in (offset, offset[0]):
            break
    time.sleep(0.1)
    second = getter()
    control.setTcp([0] * 6)
    return offset, first, second
step, flange = answers(control.getStepTime), answers(control.getActualToolFlangePose)
torques = answers(control.getJointTorques)
pose = receive.getActualTCPPose()
control.stopScript()
end(step=step, flange=flange, torques=torques, pose=pose)
""",
    )
    offset = [0.1, 0.2, 0.3, 0.0, 0.0, 0.0]
    assert reported["step"] == [offset, offset[0], 0.002]
    for name in ("flange", "torques"):
        before, first, second = reported[name]
        assert before == first == offset and second != offset, name
    assert max(abs(a - b) for a, b in zip(reported["flange"][2][:3], reported["pose"][:3], strict=True)) < 1e-3


def test_force_mode_moves_the_tool_and_nothing_is_touched(twin: Twin) -> None:
    reported = run(
        twin,
        """
receive = Receive(host, 125.0)
control = Control(host)
until(lambda: receive.getRuntimeState() == 2)
start, joints = receive.getActualTCPPose(), receive.getActualQ()
for at in range(100):
    assert control.forceMode([0] * 6, [0, 0, 1, 0, 0, 0], [0, 0, -10, 0, 0, 0], 2, [0.1, 0.1, 0.1, 0.2, 0.2, 0.2])
    time.sleep(0.008)
stopped = control.forceModeStop()
fell = start[2] - receive.getActualTCPPose()[2]
control.toolContact([0, 0, -1, 0, 0, 0])
time.sleep(0.1)
contact, detects = control.toolContact([0, 0, -1, 0, 0, 0]), control.startContactDetection()
seen = control.readContactDetection()
back, runs = control.moveJ(joints, 1.0, 2.0), receive.getRuntimeState()
try:
    mass = control.getMassMatrix([], True)
except RuntimeError:
    mass = None
until(lambda: receive.getRuntimeState() == 1)
end(stopped=stopped, fell=fell, contact=contact, detects=detects, seen=seen, back=back, runs=runs, mass=mass)
""",
    )
    assert reported["stopped"] and reported["back"] and reported["detects"] and reported["runs"] == 2
    assert 0.02 < reported["fell"] < 0.12
    assert (reported["contact"], reported["seen"], reported["mass"]) == (0, False, None)
    until(
        lambda: [e for e in twin.log.entries() if e.kind == "error" and b"get_mass_matrix" in e.data],
        "its log says why",
    )
