"""The audit file contains each command with its sender, and its size is limited."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
import trio

from strands_actors.caller.handle.robot import RealRobot
from strands_actors.caller.processes.run_directory import audit_file
from strands_actors.supervisors.root import audit
from strands_actors.supervisors.root.audit import BURST, KEPT, Audit
from strands_actors.surfaces.mesh import broadcast, estop
from tests.answers import json_of, task_ended, until


def lines(path: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in path.read_text().splitlines()] if path.exists() else []


def test_commands_are_written_with_sender_command_and_result(arm: RealRobot) -> None:
    file = audit_file("so101")
    json_of(arm.send_action({"shoulder_pan": 5.0}))
    arm.send_action({"shoulder_pan": 5000.0})
    json_of(arm.start_task("wave", policy_provider="sine", duration=0.3))
    task_ended(arm)
    broadcast("stop")
    (outcome,) = estop(by="the button", within_s=5.0)
    assert outcome.outcome == "safe"
    json_of(arm.resume())

    def entries() -> list[tuple[str, str]]:
        return [(line["what"], line["how"]) for line in lines(file)]

    stopped, resumed = ("stop (estop, locks)", "ordered"), ("resume", "ordered")
    until(
        lambda: stopped in (rows := entries()) and resumed in rows[rows.index(stopped) :],
        "all commands are written",
    )
    rows = entries()
    for expected in (
        ("acquire", "granted"),
        ("setpoint", "accepted"),
        ("start_task strands_actors.policies.registry:Sine", "started"),
        ("release", "released"),
        ("resume", "ordered"),
    ):
        assert expected in rows, rows
    assert any(what == "setpoint" and how.startswith("refused: ") for what, how in rows)
    button, *_ = [line for line in lines(file) if line["what"] == "stop (estop, locks)"]
    assert button["who"] == "the button" and button["time"].endswith("Z")
    assert [line for line in lines(file) if line["what"] == "acquire" and "policy process" in line.get("over", "")]
    assert file.stat().st_mode & 0o777 == 0o600


def keep(notes: Audit) -> None:
    trio.run(notes.settle)


def test_full_files_are_rotated_and_the_oldest_is_deleted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(audit, "MAX_BYTES", 1000)
    file = tmp_path / "so101.jsonl"
    for number in range(60):
        notes = Audit(file)
        notes.note("somebody", f"command {number}", "refused" * 1000)
        keep(notes)
    kept = sorted(tmp_path.iterdir())
    assert [path.name for path in kept] == [file.name, *(f"{file.name}.{number}" for number in range(1, KEPT + 1))]
    assert all(path.stat().st_size <= 1000 for path in kept)
    assert lines(file)[-1]["what"] == "command 59"


def test_entries_beyond_the_limit_are_counted(tmp_path: Path) -> None:
    notes = Audit(tmp_path / "so101.jsonl")
    for number in range(20_000):
        notes.note("somebody", f"command {number}", "refused")
    keep(notes)
    written = lines(tmp_path / "so101.jsonl")
    assert BURST <= len(written) < 2 * BURST
    left_out = sum(line.get("left_out", 0) for line in written) + notes._dropped
    assert len(written) + left_out == 20_000


def test_an_unwritable_disk_does_no_harm_and_the_lines_are_written_later(tmp_path: Path) -> None:
    place = tmp_path / "audit"
    place.write_text("no directory")
    notes = Audit(place / "so101.jsonl")
    notes.note("somebody", "stop", "ordered")
    keep(notes)
    assert notes.problem
    place.unlink()
    keep(notes)
    assert not notes.problem
    assert [line["what"] for line in lines(place / "so101.jsonl")] == ["stop"]


def test_a_symbolic_link_as_the_file_is_not_followed(tmp_path: Path) -> None:
    (tmp_path / "other").write_text("")
    (tmp_path / "so101.jsonl").symlink_to(tmp_path / "other")
    notes = Audit(tmp_path / "so101.jsonl")
    notes.note("somebody", "stop", "ordered")
    keep(notes)
    assert notes.problem and (tmp_path / "other").read_text() == ""
