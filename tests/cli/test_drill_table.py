"""The reasons in a drill's table are readable on a terminal of 80 columns."""

from __future__ import annotations

import pytest

from strands_actors.surfaces.cli.drill import _print
from strands_actors.surfaces.drill.certificate import StepResult
from strands_actors.surfaces.drill.run import Outcome

WHY = "wrist_roll (id 5) did not confirm: no answer within 40 ms. Check its cable, then drill again; elbow_flex did"


def test_every_reason_is_complete_at_80_columns(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    results = [
        StepResult("root freeze", False, "controlled_stop", 1234.5, 2345.6, 3000.0, 12, WHY),
        StepResult("link loss", True, "limp", 27.7, 35.4, 3000.0, 0, "the root's stop channel made it safe"),
    ]
    _print("so101", Outcome(results, None, None), as_json=False)
    lines = capsys.readouterr().out.splitlines()
    assert max(len(line.rstrip()) for line in lines) <= 80
    text = " ".join(" ".join(lines).split())
    assert "…" not in text
    assert f"root freeze FAILED: {WHY}" in text
    assert "link loss: the root's stop channel made it safe" in text
    assert "controlled_stop 1234.5 ms 3000.0 ms 2345.6 ms 12 FAILED" in text
