"""Words that a user may type to stop a robot without looking the command up."""

from __future__ import annotations

import pytest

from strands_actors.surfaces.cli import run
from strands_actors.surfaces.cli.stop_forms import spelled

COMMANDS = ("stop", "estop", "send", "list", "mesh", "resume")


@pytest.mark.parametrize(
    ("typed", "meant"),
    [
        ("STOP so101", "stop so101"),
        ("halt so101 --json", "stop so101 --json"),
        ("--stop so101", "stop so101"),
        ("so101 stop", "stop so101"),
        ("so101 E-STOP", "estop so101"),
        ("send so101 stop", "stop so101"),
        ("e-stop", "estop"),
        ("Emergency-Stop --all", "estop --all"),
        ("stop all", "stop --all"),
        ("stop-all", "stop --all"),
        ("stop so101", "stop so101"),
        ("stop", "stop"),
    ],
)
def test_saf_006_a_typed_stop_is_understood(typed: str, meant: str) -> None:
    assert spelled(typed.split(), COMMANDS) == meant.split()


@pytest.mark.parametrize(
    "typed", ["", "list stop", "send stop x=1", "send so101 pan=1 stop", "nonstop so101", "mesh stop"]
)
def test_other_commands_are_not_a_stop(typed: str) -> None:
    assert spelled(typed.split(), COMMANDS) == typed.split()


def test_saf_006_the_command_reads_it(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["nobody", "STOP"]) == 2
    assert "no robot 'nobody' is on the mesh" in capsys.readouterr().err
