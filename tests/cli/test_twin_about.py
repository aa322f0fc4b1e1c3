"""Test ``twin NAME --about``: the list of what a twin models."""

from __future__ import annotations

import pytest

from strands_actors.surfaces.cli import run


def about(robot: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> str:
    monkeypatch.setenv("COLUMNS", "160")
    assert run(["twin", robot, "--about"]) == 0
    return capsys.readouterr().out


@pytest.mark.parametrize(
    ("robot", "rows"),
    [
        ("xarm7", ("12 SET_STATE", "25 MOVE_HOME", "every other", "0x08")),
        ("g1", ("1002", "7105", "error 3203, not implemented")),
        ("so101", ("returns registers", "silence")),
        ("so101_leader", ("returns registers", "silence")),
        ("spot", ("arm_command.arm_joint_move_command", "status 3, unsupported")),
    ],
)
def test_it_prints_the_messages_and_the_answer_to_all_others(
    robot: str, rows: tuple[str, ...], capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    printed = about(robot, capsys, monkeypatch)
    for row in rows:
        assert row in printed


def test_an_unknown_robot_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["twin", "so999", "--about"]) == 2
    assert "so999" in capsys.readouterr().err
