"""Test the shell completion of commands and robot names."""

from __future__ import annotations

import pytest

from tests.cli.command import Command, RobotProcess


def completed(cli: Command, line: str) -> list[str]:
    """Return the completions that bash gets for the last word."""
    words = line.split(" ")
    cli.environment |= {
        "_STRANDS_ACTORS_COMPLETE": "complete_bash",
        "COMP_WORDS": line,
        "COMP_CWORD": str(len(words) - 1),
    }
    try:
        return cli.run().stdout.split()
    finally:
        for name in ("_STRANDS_ACTORS_COMPLETE", "COMP_WORDS", "COMP_CWORD"):
            del cli.environment[name]


def test_commands_and_kinds_of_robot(cli: Command) -> None:
    assert completed(cli, "strands-actors do") == ["doctor", "down"]
    assert {"stop"} <= set(completed(cli, "strands-actors st"))
    assert completed(cli, "strands-actors twin so1") == ["so100", "so101"]


@pytest.mark.long
def test_robots_that_run(cli: Command, robot: RobotProcess) -> None:
    assert completed(cli, "strands-actors stop ") == ["so101"]
