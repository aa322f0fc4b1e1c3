"""A refusal on the command line names an option or a command, not a method of the handle."""

from __future__ import annotations

import pytest

from strands_actors.kernel.messages import Refused
from strands_actors.kernel.refusals import Code
from strands_actors.supervisors.gate import refusals as of_gate
from strands_actors.supervisors.mesh import refusals as of_mesh
from strands_actors.surfaces.cli.remedies import OF_RESUME, of_motion, with_remedy

from .command import Command, RobotProcess

STOPPED = of_gate.not_armed(Code.DISARMED, "disarmed", "stop by a person", "stop")
CASES: list[tuple[Refused, str]] = [
    (of_mesh.holding("the setpoint expired"), "the robot holds (the setpoint expired). Give --resume, which"),
    (of_mesh.not_writable("disarmed", ""), "the robot is disarmed. Give --resume, which energises the robot first"),
    (STOPPED, "the robot is disarmed (stop by a person). Give --resume"),
    (of_gate.not_armed(Code.FAULTED, "disarmed", "overload", "fault"), "Clear the fault, then give --resume"),
    (of_mesh.locked_out("a person"), "e-stopped by a person. `strands-actors resume so101` lifts the lockout"),
    (of_gate.lease_taken("another"), "another holds the lease. Let the program that has it call release()"),
    (of_gate.not_read_yet(), "the robot has not been read yet. Wait for the first observation"),
]


@pytest.mark.parametrize(("refusal", "text"), CASES)
def test_a_motion_that_is_refused_names_the_option(refusal: Refused, text: str) -> None:
    shown = with_remedy(refusal, of_motion("so101", resumed=False))
    assert text in shown.text and shown.code == refusal.code


def test_a_motion_with_resume_is_not_told_to_give_it() -> None:
    assert with_remedy(STOPPED, of_motion("so101", resumed=True)).remedy == "give the command again"


def test_a_resume_that_is_refused_names_no_method() -> None:
    refusals = (of_gate.stopped_since_resume(), of_gate.busy_for_resume("stopping"), of_gate.stop_unconfirmed(()))
    for refusal in refusals:
        assert "resume()" in refusal.remedy and "()" not in with_remedy(refusal, OF_RESUME).remedy


def test_a_send_to_a_stopped_or_locked_robot_names_what_to_give(cli: Command, robot: RobotProcess) -> None:
    assert robot.call("stop")["status"] == robot.call("release")["status"] == "success"
    done = cli.run("send", "so101", "shoulder_pan=5")
    assert (done.returncode, done.stdout, done.stderr.count("\n")) == (1, "", 1), done.stderr
    assert done.stderr.endswith(". Give --resume, which energises the robot first\n"), done.stderr
    assert cli.run("estop", "so101").returncode == 0
    done = cli.run("send", "so101", "shoulder_pan=5")
    assert done.stderr.endswith(". `strands-actors resume so101` lifts the lockout\n"), done.stderr
    done = cli.run("send", "so101", "shoulder_pan=5", "--for", "0.2", "--resume")
    assert done.returncode == 0, done.stderr
