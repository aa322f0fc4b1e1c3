"""``move_along`` as scripts call it, on an SO-101 behind its bus."""

from __future__ import annotations

import math
import time

import pytest

from strands_actors.caller.handle.robot import RealRobot
from strands_actors.testing import Twin
from tests.answers import json_of, state, task, until, why
from tests.robot.helpers import IDS, goals, holds
from tests.trees import armed

PAN = "shoulder_pan"
HZ = 20.0


def waves(seconds: float, degrees: float = 15.0) -> list[dict[str, float]]:
    return [{PAN: degrees * math.sin(number / HZ)} for number in range(round(seconds * HZ))]


def test_move_along_follows_the_rows_and_holds_at_the_last(arm: RealRobot, twin: Twin) -> None:
    armed(arm)
    began_ns = time.monotonic_ns()
    rows = waves(3.0)
    result = json_of(arm.move_along(rows, hz=HZ))
    assert result["rows"] == len(rows) and result["commanded"] == rows[-1]
    assert result["position"][PAN] == pytest.approx(rows[-1][PAN], abs=3.0)
    written = [goals(entry) for entry in twin.log.host("setpoint", began_ns)]
    path = [at[IDS[PAN]] for at in written]
    top = path.index(max(path))
    assert 0 < top < len(path) - 1 and path[top:] == sorted(path[top:], reverse=True), "first up, then down"
    assert len({at[IDS["elbow_flex"]] for at in written}) == 1, "a joint that the path does not name stays"
    assert state(arm) == "armed" and not holds(twin.log, began_ns), "the last row of the path stays in force"


def test_saf_006_a_stop_ends_it_and_no_setpoint_follows(arm: RealRobot, twin: Twin) -> None:
    began_ns = time.monotonic_ns()

    def moves() -> bool:
        """Return whether the robot moves. On a busy machine a late setpoint may have ended the motion;
        then begin it again."""
        if not task(arm)["running"]:
            armed(arm)
            json_of(arm.move_along(waves(20.0), hz=HZ, wait=False))
        return len({entry.data for entry in twin.log.host("setpoint", began_ns)}) > 4

    until(moves, "it moves")
    assert task(arm)["instruction"] == "move_along"
    stopped_ns = time.monotonic_ns()
    json_of(arm.stop())
    time.sleep(0.3)
    assert twin.log.setpoints_after_safe(stopped_ns) == 0


def test_a_path_that_leaves_the_range_is_refused_before_anything_moves(arm: RealRobot, twin: Twin) -> None:
    armed(arm)
    began_ns = time.monotonic_ns()
    refused = why(arm.move_along([{PAN: 0.0}, {PAN: 200.0}], hz=0.04))
    assert "is past" in refused and "Stay within" in refused and refused.startswith("move_along: at ")
    assert twin.log.host("setpoint", began_ns) == []
