"""The command ``ros2``, as a process and with wrong arguments."""

from __future__ import annotations

import signal
from pathlib import Path

import pytest

from strands_actors.surfaces.cli import run
from tests.answers import until
from tests.cli.command import Command
from tests.ports import free_port

from .peer import Program, router


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        (["--namespace", "lab"], "no namespace of ROS"),
        (["--router", "localhost:7447"], "no endpoint of a router"),
        (["--domain", "233"], "233"),
    ],
)
def test_a_wrong_argument_is_refused(arguments: list[str], reason: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["ros2", *arguments]) == 2
    assert reason in capsys.readouterr().err


def test_the_command_waits_for_the_router_and_ends_with_ctrl_c(run_dir: Path) -> None:
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    with Command(run_dir).start("ros2", "--router", endpoint, "--domain", "7") as process:
        assert process.stdout is not None
        assert "waiting for a zenoh router" in process.stdout.readline()
        with router(endpoint), Program(endpoint) as program:
            assert "ROS domain 7" in process.stdout.readline()
            until(lambda: program.nodes() == set(), "the graph is empty without robots")
            process.send_signal(signal.SIGINT)
            assert process.wait(30) == 130
