"""Who told a robot what is written down, and what is written never fills a disk."""

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


def test_commands_are_written_down_with_who_what_and_how(arm: RealRobot) -> None:
    file = audit_file("so101")
    json_of(arm.send_action({"shoulder_pan": 5.0}))
    arm.send_action({"shoulder_pan": 5000.0})
    json_of(arm.start_task("wave", policy_provider="sine", duration=0.3))
    task_ended(arm)
    broadcast("stop")
    (outcome,) = estop(by="the button", within_s=5.0)
    assert outcome.outcome == "safe"
    json_of(arm.resume())

    def told() -> list[tuple[str, str]]:
        return [(line["what"], line["how"]) for line in lines(file)]

    stopped, resumed = ("stop (estop, locks)", "ordered"), ("resume", "ordered")
    until(lambda: stopped in (found := told()) and resumed in found[found.index(stopped) :], "all of it")
    found = told()
    for expected in (
        ("acquire", "granted"),
        ("setpoint", "accepted"),
        ("start_task strands_actors.policies.registry:Sine", "started"),
        ("release", "released"),
        ("resume", "ordered"),
    ):
        assert expected in found, found
    assert any(what == "setpoint" and how.startswith("refused: ") for what, how in found)
    button, *_ = [line for line in lines(file) if line["what"] == "stop (estop, locks)"]
    assert button["who"] == "the button" and button["time"].endswith("Z")
    assert [line for line in lines(file) if line["what"] == "acquire" and "policy process" in line.get("over", "")]
    assert file.stat().st_mode & 0o777 == 0o600


def keep(notes: Audit) -> None:
    trio.run(notes.settle)


def test_files_are_put_aside_and_the_oldest_goes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
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


def test_a_flood_is_counted(tmp_path: Path) -> None:
    notes = Audit(tmp_path / "so101.jsonl")
    for number in range(20_000):
        notes.note("somebody", f"command {number}", "refused")
    keep(notes)
    written = lines(tmp_path / "so101.jsonl")
    assert BURST <= len(written) < 2 * BURST
    left_out = sum(line.get("left_out", 0) for line in written) + notes._left_out
    assert len(written) + left_out == 20_000


def test_a_disk_that_takes_nothing_is_no_harm_and_the_lines_come_later(tmp_path: Path) -> None:
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


def test_a_link_in_its_place_is_not_followed(tmp_path: Path) -> None:
    (tmp_path / "other").write_text("")
    (tmp_path / "so101.jsonl").symlink_to(tmp_path / "other")
    notes = Audit(tmp_path / "so101.jsonl")
    notes.note("somebody", "stop", "ordered")
    keep(notes)
    assert notes.problem and (tmp_path / "other").read_text() == ""
