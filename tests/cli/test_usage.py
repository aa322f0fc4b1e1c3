"""What is asked wrongly is answered by one line and exit code 2."""

from __future__ import annotations

from pathlib import Path

import pytest

from .command import Command


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (["twin", "so999", "--port-file", "port"], "so999"),
        (["twin", "so101", "--port-file", "port", "--fault", "sulk"], "sulk"),
        (["twin", "so101"], "--port-file"),
        (["stop", "nobody"], "nobody"),
        (["estop", "--all"], "no robot"),
        (["resume"], "--all"),
        (["stop", "one", "--all"], "--all"),
        (["demo", "--seconds", "1"], "--seconds"),
        (["demo", "--out", "no/such/folder/demo.png"], "no/such/folder"),
        (["dance"], "dance"),
    ],
)
def test_one_line_and_exit_code_2(cli: Command, tmp_path: Path, arguments: list[str], named: str) -> None:
    done = cli.run(*arguments, cwd=tmp_path)
    assert done.returncode == 2
    assert done.stdout == ""
    assert done.stderr.startswith("strands-actors: ")
    assert done.stderr.count("\n") == 1
    assert named in done.stderr


def test_help_names_every_command(cli: Command) -> None:
    for arguments in (["--help"], []):
        done = cli.run(*arguments)
        assert done.returncode == 0
        for command in ("demo", "list", "tree", "stop", "estop", "resume", "twin"):
            assert f"\n  {command} " in done.stdout


def test_list_tells_who_drives_which_robot(cli: Command) -> None:
    rows = {row["robot"]: row for row in cli.json("list")["robots"]}
    assert rows["so101"] == {"robot": "so101", "driver": "FeetechDriver", "coverage": ["lerobot", "strands"]}
    assert rows["ability_hand"] == {"robot": "ability_hand", "driver": None, "coverage": []}
    drawn = cli.run("list").stdout
    assert all(robot in drawn for robot in rows)
