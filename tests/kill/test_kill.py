"""SAF-003, SAF-006, SAF-008, SAF-015: any one process ends or stops answering, and the wire goes safe.

Real processes, real wires. The bounds here leave room for a busy machine; the published ones are held by
``python -m strands_actors.testing.kill --repeats 20``.
"""

from __future__ import annotations

import pytest
import trio

from strands_actors.testing import kill

SLACK_MS = 400.0
ROBOTS = ("so101", "robotiq_2f85")
"""One of each wire."""
SHORT = {"koch": ("SIGKILL", "SIGSTOP"), "unitree_g1": ("SIGKILL", "SIGSTOP", "spin")}
"""The hardest faults only: a robot that shares all but the protocol with one above, and one at 500 Hz."""
CELLS = [
    (robot, victim, fault)
    for robot in (*ROBOTS, *SHORT)
    for victim in kill.victims_of(kill.driver_of(robot))
    for fault in SHORT.get(robot, kill.FAULTS)
]


@pytest.mark.parametrize(("robot", "victim", "fault"), CELLS)
def test_saf_003_one_process_breaks_and_the_wire_is_safe(robot: str, victim: str, fault: str) -> None:
    outcome = trio.run(kill.run_cell, victim, fault, robot)
    assert outcome.all_motors, f"no {outcome.rung} frame for all motors"
    assert outcome.setpoints_after == 0
    assert outcome.safe_ms <= outcome.bound_ms + SLACK_MS
    # SAF-015: nothing of ours keeps a caller that ends.
    assert outcome.gone_ms <= 100.0 + SLACK_MS
